//! `georef.json`: any bytes give a result or one clear line.
#![no_main]

#[path = "../../crates/pgsag-scene/tests/parsers/mod.rs"]
mod parsers;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let parser = parsers::PARSERS.iter().find(|parser| parser.file == "georef.json").expect("a parser of that name");
    let _ = (parser.parse)(parser.file, bytes);
});
