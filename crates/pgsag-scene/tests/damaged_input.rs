//! Damaged files: every parser answers with a result or with one clear line, whatever the bytes are.

use std::panic::catch_unwind;
use std::path::PathBuf;

use pgsag_scene::numbers::SplitMix64;

mod parsers;

use parsers::{PARSERS, Parser};

/// Damaged inputs per parser.
const INPUTS: usize = 2000;

/// Numbers that have broken parsers before.
const EXTREMES: [u64; 10] = [
    0,
    1,
    u64::MAX,
    1 << 31,
    u32::MAX as u64,
    1 << 63,
    0x7FF8_0000_0000_0000,
    0x7FF0_0000_0000_0000,
    0xFFEF_FFFF_FFFF_FFFF,
    0x7FC0_0000_7F80_0000,
];
const WORDS: [&str; 10] = ["nan", "inf", "-1", "1e999", "99999999999999999999", "", "0", "\n", "é", "1e-320"];

fn place(stream: &mut SplitMix64, bytes: &[u8]) -> usize {
    stream.below(bytes.len())
}

/// One act of damage.
fn damage(stream: &mut SplitMix64, bytes: &mut Vec<u8>) {
    if bytes.is_empty() {
        return bytes.push(stream.next_u64() as u8);
    }
    let at = place(stream, bytes);
    match stream.below(8) {
        0 | 1 => bytes[at] ^= 1 << stream.below(8),
        2 => bytes.truncate(at),
        3 => {
            let extreme = EXTREMES[stream.below(EXTREMES.len())].to_le_bytes();
            let len = [1, 2, 4, 8][stream.below(4)].min(bytes.len() - at);
            bytes[at..at + len].copy_from_slice(&extreme[..len]);
        }
        4 => {
            let is_gap = |byte: &u8| byte.is_ascii_whitespace() || b",:[]{}\"".contains(byte);
            let len = bytes[at..].iter().position(is_gap).unwrap_or(0);
            let word = WORDS[stream.below(WORDS.len())];
            bytes.splice(at..at + len, word.bytes());
        }
        5 => {
            let end = (at + stream.below(40)).min(bytes.len());
            let copy = bytes[at..end].to_vec();
            bytes.splice(at..at, copy);
        }
        6 => {
            let end = (at + stream.below(40)).min(bytes.len());
            bytes.drain(at..end);
        }
        _ => bytes[at] = stream.next_u64() as u8,
    }
}

/// Parses; says what is wrong with the answer, if anything.
fn answer(parser: &Parser, bytes: &[u8]) -> Result<bool, String> {
    let parsed = catch_unwind(|| (parser.parse)(parser.file, bytes)).map_err(|_| "panicked".to_owned())?;
    let Err(error) = parsed else { return Ok(true) };
    let text = error.to_string();
    let known = PARSERS.iter().any(|other| other.file == error.file()) && text.contains(error.file());
    let clear = known && !text.chars().any(char::is_control) && text.contains(';') && text.len() < 1500;
    if clear { Ok(false) } else { Err(format!("answered {text:?}")) }
}

#[test]
fn sound_files_are_read() {
    for parser in &PARSERS {
        let result = (parser.parse)(parser.file, &(parser.sound)());
        assert!(result.is_ok(), "{}: {}", parser.file, result.unwrap_err());
    }
}

#[test]
fn damaged_files_get_one_clear_line() {
    for (number, parser) in PARSERS.iter().enumerate() {
        let mut stream = SplitMix64::new(1000 + number as u64);
        let sound = (parser.sound)();
        let mut refused = 0;
        for input in 0..INPUTS {
            let mut bytes = if input == 0 { Vec::new() } else { sound.clone() };
            let acts = if input == 0 { 0 } else { 1 + stream.below(4) };
            (0..acts).for_each(|_| damage(&mut stream, &mut bytes));
            match answer(parser, &bytes) {
                Ok(read) => refused += usize::from(!read),
                Err(what) => panic!("{}, input {input}: {what}\n{:?}", parser.file, String::from_utf8_lossy(&bytes)),
            }
        }
        assert!(refused > INPUTS / 20, "{}: only {refused} damaged files were noticed", parser.file);
    }
    assert!(peak_memory_bytes().is_none_or(|peak| peak < 1 << 30));
}

#[test]
fn every_truncation_gets_one_clear_line() {
    for parser in &PARSERS {
        let sound = (parser.sound)();
        for len in 0..sound.len() {
            let answered = answer(parser, &sound[..len]);
            assert!(answered.is_ok(), "{}, {len} bytes: {}", parser.file, answered.unwrap_err());
        }
    }
}

/// The largest memory that this process has held, where the system tells.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_ascii_whitespace().next()?.parse::<u64>().ok().map(|kib| kib * 1024)
}

/// Files that a fuzzer once found, or that it starts from: `fuzz/corpus/<file>/*`.
fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus")
}

#[test]
fn the_corpus_of_the_fuzzer_gets_one_clear_line() {
    for parser in &PARSERS {
        let mut files = 0;
        for entry in std::fs::read_dir(corpus().join(parser.file)).unwrap() {
            let path = entry.unwrap().path();
            let answered = answer(parser, &std::fs::read(&path).unwrap());
            assert!(answered.is_ok(), "{}: {}", path.display(), answered.unwrap_err());
            files += 1;
        }
        assert!(files > 0, "{} has no corpus", parser.file);
    }
}

#[test]
#[ignore = "writes fuzz/corpus anew"]
fn write_the_corpus() {
    for parser in &PARSERS {
        let folder = corpus().join(parser.file);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("sound"), (parser.sound)()).unwrap();
    }
}
