//! A Rust file as tidy sees it: code without comments and literals, comments, string literals, lines of test code.
//!
//! This is a lexer, not a parser: it knows strings, raw strings, characters, lifetimes and nested comments, which is
//! enough to read paths and attributes without being fooled by prose.

use std::collections::BTreeSet;
use std::path::Path;

use crate::Result;

/// One file, taken apart. Lines count from 1.
#[derive(Clone, Debug, Default)]
pub(crate) struct Source {
    /// Below the repository's root, with `/`.
    pub(crate) path: String,
    /// As it stands.
    pub(crate) text: String,
    /// The same number of lines; comments and the inside of literals are blanked.
    pub(crate) code: String,
    /// Every comment with its line.
    pub(crate) comments: Vec<(usize, String)>,
    /// Every string literal with its line.
    pub(crate) literals: Vec<(usize, String)>,
    /// Whether the whole file is test code.
    pub(crate) is_test: bool,
    test_lines: BTreeSet<usize>,
}

impl Source {
    pub(crate) fn new(path: &str, text: &str) -> Self {
        let mut lexer = Lexer { letters: text.chars().collect(), at: 0, line: 1, source: Self::default() };
        lexer.run();
        let mut source = lexer.source;
        source.path = path.to_owned();
        source.text = text.to_owned();
        source.is_test = is_test_path(path);
        source.test_lines = test_lines(&source.code);
        source
    }

    /// Whether a line is compiled for tests only.
    pub(crate) fn is_test_line(&self, line: usize) -> bool {
        self.is_test || self.test_lines.contains(&line)
    }

    /// Lines of code with their numbers, test code left out.
    pub(crate) fn product_lines(&self) -> impl Iterator<Item = (usize, &str)> {
        self.code
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line))
            .filter(|(line, _)| !self.is_test_line(*line))
    }

    /// Every `a::b::c` of the code, `use` trees spelled out, with its line. Words that stand alone are left out.
    pub(crate) fn paths(&self) -> Vec<(usize, Vec<String>)> {
        let mut reader = PathReader { tokens: tokens(&self.code), at: 0, found: Vec::new() };
        reader.run();
        reader.found
    }

    /// Modules of this file that are declared for tests only and live in files of their own.
    fn test_modules(&self) -> Vec<String> {
        let mut names = Vec::new();
        let lines: Vec<&str> = self.code.lines().collect();
        for pair in lines.windows(2) {
            let declared = pair[1].trim().trim_start_matches("pub(crate) ").strip_prefix("mod ");
            if let Some(name) = declared.and_then(|rest| rest.strip_suffix(';'))
                && pair[0].trim() == "#[cfg(test)]"
            {
                names.push(name.to_owned());
            }
        }
        names
    }
}

/// Every Rust file of the repository.
pub(crate) fn read_all(root: &Path) -> Result<Vec<Source>> {
    let mut sources = Vec::new();
    for path in files_below(root, "")? {
        if path.ends_with(".rs") {
            let text = std::fs::read_to_string(root.join(&path)).map_err(|cause| format!("{path}: {cause}"))?;
            sources.push(Source::new(&path, &text));
        }
    }
    mark_test_modules(&mut sources);
    Ok(sources)
}

/// Every file below `folder`, sorted; hidden folders, build outputs and run folders are left out.
pub(crate) fn files_below(root: &Path, folder: &str) -> Result<Vec<String>> {
    let fault = |cause: std::io::Error| format!("{folder}: {cause}");
    let mut found = Vec::new();
    for entry in std::fs::read_dir(root.join(folder)).map_err(fault)? {
        let entry = entry.map_err(fault)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = if folder.is_empty() { name.clone() } else { format!("{folder}/{name}") };
        let is_folder = entry.file_type().map_err(fault)?.is_dir();
        if is_folder && (name.starts_with('.') || name == "target" || name.ends_with(".run")) {
            continue;
        }
        if is_folder {
            found.extend(files_below(root, &path)?);
        } else {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// A file whose `mod` line says `#[cfg(test)]` is test code, and so is all below it.
fn mark_test_modules(sources: &mut [Source]) {
    let mut prefixes = Vec::new();
    for source in &*sources {
        let folder = child_folder(&source.path);
        prefixes.extend(source.test_modules().iter().map(|name| format!("{folder}/{name}")));
    }
    for source in sources {
        let stem = source.path.trim_end_matches(".rs");
        source.is_test |= prefixes.iter().any(|prefix| stem == prefix || stem.starts_with(&format!("{prefix}/")));
    }
}

/// Where the child modules of a file live.
fn child_folder(path: &str) -> String {
    let stem = path.trim_end_matches(".rs");
    let (folder, name) = stem.rsplit_once('/').unwrap_or(("", stem));
    if matches!(name, "lib" | "main" | "mod") { folder.to_owned() } else { stem.to_owned() }
}

fn is_test_path(path: &str) -> bool {
    path.split('/').any(|part| matches!(part, "tests" | "tests.rs" | "benches" | "examples" | "fuzz"))
}

/// Lines of items behind `#[cfg(test)]` that have a body here.
fn test_lines(code: &str) -> BTreeSet<usize> {
    let mut lines = BTreeSet::new();
    let line_of = |at: usize| code[..at].matches('\n').count() + 1;
    for (start, mark) in code.match_indices("#[cfg(test)]") {
        let body = start + mark.len();
        let mut depth = 0_usize;
        for (offset, letter) in code[body..].char_indices() {
            match letter {
                ';' if depth == 0 => break,
                '{' => depth += 1,
                '}' => depth = depth.saturating_sub(1),
                _ => {}
            }
            if letter == '}' && depth == 0 {
                lines.extend(line_of(start)..=line_of(body + offset));
                break;
            }
        }
    }
    lines
}

struct Lexer {
    letters: Vec<char>,
    at: usize,
    line: usize,
    source: Source,
}

impl Lexer {
    fn peek(&self, ahead: usize) -> char {
        self.letters.get(self.at + ahead).copied().unwrap_or('\0')
    }

    /// Takes one letter; `shown` in code, or blanked. Line ends are always shown.
    fn step(&mut self, shown: bool) -> char {
        let letter = self.peek(0);
        self.at += 1;
        self.line += usize::from(letter == '\n');
        self.source.code.push(if shown || letter == '\n' { letter } else { ' ' });
        letter
    }

    fn run(&mut self) {
        while self.at < self.letters.len() {
            match (self.peek(0), self.peek(1)) {
                ('/', '/') => self.line_comment(),
                ('/', '*') => self.block_comment(),
                ('"', _) => self.string(),
                ('r', '"' | '#') if self.starts_raw_string() => self.raw_string(),
                ('\'', _) => self.character(),
                (letter, _) if letter.is_alphanumeric() || letter == '_' => self.word(),
                _ => {
                    self.step(true);
                }
            }
        }
    }

    fn line_comment(&mut self) {
        let (line, mut text) = (self.line, String::new());
        while self.at < self.letters.len() && self.peek(0) != '\n' {
            text.push(self.step(false));
        }
        self.source.comments.push((line, text));
    }

    fn block_comment(&mut self) {
        let (line, mut text, mut depth) = (self.line, String::new(), 0_usize);
        while self.at < self.letters.len() {
            match (self.peek(0), self.peek(1)) {
                ('/', '*') => depth += 1,
                ('*', '/') => depth -= 1,
                _ => {
                    text.push(self.step(false));
                    continue;
                }
            }
            self.step(false);
            self.step(false);
            if depth == 0 {
                break;
            }
        }
        self.source.comments.push((line, text));
    }

    fn string(&mut self) {
        let (line, mut text) = (self.line, String::new());
        self.step(true);
        while self.at < self.letters.len() && self.peek(0) != '"' {
            if self.peek(0) == '\\' {
                text.push(self.step(false));
            }
            text.push(self.step(false));
        }
        self.step(true);
        self.source.literals.push((line, text));
    }

    fn starts_raw_string(&self) -> bool {
        let hashes = self.letters[self.at + 1..].iter().take_while(|letter| **letter == '#').count();
        self.peek(1 + hashes) == '"'
    }

    fn raw_string(&mut self) {
        self.step(true);
        let mut hashes = 0;
        while self.peek(0) == '#' {
            hashes += 1;
            self.step(true);
        }
        let (line, mut text) = (self.line, String::new());
        self.step(true);
        while self.at < self.letters.len() {
            if self.peek(0) == '"' && (1..=hashes).all(|ahead| self.peek(ahead) == '#') {
                break;
            }
            text.push(self.step(false));
        }
        for _ in 0..=hashes {
            self.step(true);
        }
        self.source.literals.push((line, text));
    }

    /// A character literal, or the mark of a lifetime.
    fn character(&mut self) {
        self.step(true);
        let escaped = self.peek(0) == '\\';
        if !escaped && self.peek(1) != '\'' {
            return;
        }
        if escaped {
            self.step(false);
        }
        self.step(false);
        while self.at < self.letters.len() && self.peek(0) != '\'' {
            self.step(false);
        }
        self.step(true);
    }

    /// A word, so that the `r` or `b` at its end is not taken for a literal's prefix; `b"` and `br"` are prefixes.
    fn word(&mut self) {
        let starts_prefix = matches!(self.peek(0), 'b' | 'c') && matches!(self.peek(1), '"' | 'r' | '\'');
        if starts_prefix {
            self.step(true);
            if self.peek(0) != 'r' || self.starts_raw_string() {
                return;
            }
        }
        while self.peek(0).is_alphanumeric() || self.peek(0) == '_' {
            self.step(true);
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Word(String),
    Colons,
    Mark(char),
}

fn tokens(code: &str) -> Vec<(usize, Token)> {
    let mut found = Vec::new();
    for (index, line) in code.lines().enumerate() {
        let letters: Vec<char> = line.chars().collect();
        let mut at = 0;
        while at < letters.len() {
            let start = at;
            while at < letters.len() && (letters[at].is_alphanumeric() || letters[at] == '_') {
                at += 1;
            }
            if at > start {
                found.push((index + 1, Token::Word(letters[start..at].iter().collect())));
            } else if letters[at] == ':' && letters.get(at + 1) == Some(&':') {
                found.push((index + 1, Token::Colons));
                at += 2;
            } else {
                if !letters[at].is_whitespace() {
                    found.push((index + 1, Token::Mark(letters[at])));
                }
                at += 1;
            }
        }
    }
    found
}

struct PathReader {
    tokens: Vec<(usize, Token)>,
    at: usize,
    found: Vec<(usize, Vec<String>)>,
}

impl PathReader {
    fn run(&mut self) {
        while self.at < self.tokens.len() {
            let is_use = self.tokens[self.at].1 == Token::Word("use".into());
            if is_use {
                self.at += 1;
            }
            match self.tokens.get(self.at) {
                Some((_, Token::Word(_))) => self.path(&[], is_use),
                _ => self.at += 1,
            }
        }
    }

    /// A path from its first word on; groups in braces are followed only where they can stand.
    fn path(&mut self, prefix: &[String], is_use: bool) {
        let mut parts = prefix.to_vec();
        let mut line = 0;
        while let Some((here, Token::Word(word))) = self.tokens.get(self.at).cloned() {
            line = here;
            parts.push(word);
            self.at += 1;
            if self.tokens.get(self.at).map(|token| &token.1) != Some(&Token::Colons) {
                break;
            }
            self.at += 1;
            if is_use && self.tokens.get(self.at).map(|token| &token.1) == Some(&Token::Mark('{')) {
                self.at += 1;
                self.group(&parts);
                return;
            }
        }
        let is_glob = self.tokens.get(self.at).map(|token| &token.1) == Some(&Token::Mark('*'));
        self.at += usize::from(is_use && is_glob);
        if parts.len() > 1 || is_use {
            self.found.push((line, parts));
        }
    }

    fn group(&mut self, prefix: &[String]) {
        while let Some((line, token)) = self.tokens.get(self.at).cloned() {
            match token {
                Token::Word(word) if word == "as" => self.at += 2,
                Token::Word(_) => self.path(prefix, true),
                Token::Mark('}') => {
                    self.at += 1;
                    return;
                }
                Token::Mark('*') => {
                    self.found.push((line, prefix.to_vec()));
                    self.at += 1;
                }
                _ => self.at += 1,
            }
        }
    }
}

#[cfg(test)]
mod tests;
