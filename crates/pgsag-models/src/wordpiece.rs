//! BERT's tokenizer: text to the numbers that GroundingDINO reads, and back to words.
//!
//! Unaccented lower case, words and punctuation apart, each word cut greedily into the longest pieces of the vocabulary.
//! Follows the published behaviour of Hugging Face's `tokenizers` for `bert-base-uncased`; held by goldens of that library.

use std::collections::HashMap;
use std::path::Path;

use serde_json::Value;
use unicode_normalization::UnicodeNormalization as _;
use unicode_properties::{GeneralCategory, GeneralCategoryGroup, UnicodeGeneralCategory as _};

use crate::error::ModelError;

/// A vocabulary and how words are cut.
#[derive(Clone, Debug)]
pub struct WordPiece {
    ids: HashMap<String, u32>,
    pieces: Vec<String>,
    /// Tokens that are found in the text as they stand, such as `[SEP]`.
    whole: Vec<String>,
    unknown: u32,
    start: u32,
    end: u32,
    is_lowered: bool,
    longest_word_chars: usize,
}

/// A text as numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tokens {
    /// Numbers of the pieces, `[CLS]` first and `[SEP]` last.
    pub ids: Vec<u32>,
}

impl WordPiece {
    /// Reads `tokenizer.json`.
    ///
    /// # Errors
    /// [`ModelError::File`] where it is not a WordPiece tokenizer.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        let cure = "take tokenizer.json from the model's own repository";
        let text = std::fs::read_to_string(path)
            .map_err(|cause| ModelError::file(path, format!("cannot be read ({cause})"), cure))?;
        let file: Value = serde_json::from_str(&text).map_err(|cause| ModelError::file(path, cause, cure))?;
        Self::from_json(&file).map_err(|what| ModelError::file(path, what, cure))
    }

    /// A tokenizer from the content of `tokenizer.json`.
    ///
    /// # Errors
    /// What is missing, in words.
    pub fn from_json(file: &Value) -> Result<Self, String> {
        let model = &file["model"];
        let kind = model["type"].as_str().unwrap_or("WordPiece");
        let vocabulary = model["vocab"].as_object().filter(|_| kind == "WordPiece");
        let vocabulary = vocabulary.ok_or("no WordPiece vocabulary in it")?;
        let mut ids = HashMap::with_capacity(vocabulary.len());
        let mut pieces = vec![String::new(); vocabulary.len()];
        for (piece, id) in vocabulary {
            let id =
                id.as_u64().filter(|id| *id < pieces.len() as u64).ok_or("its vocabulary is not numbered 0, 1, 2…")?;
            pieces[id as usize].clone_from(piece);
            ids.insert(piece.clone(), id as u32);
        }
        let id_of = |piece: &str| ids.get(piece).copied().ok_or(format!("no token {piece} in its vocabulary"));
        let unknown = id_of(model["unk_token"].as_str().unwrap_or("[UNK]"))?;
        let (start, end) = (id_of("[CLS]")?, id_of("[SEP]")?);
        let mut whole: Vec<String> = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]"].map(str::to_owned).to_vec();
        whole.retain(|piece| ids.contains_key(piece));
        let is_lowered = file["normalizer"]["lowercase"].as_bool().unwrap_or(true);
        let longest_word_chars = model["max_input_chars_per_word"].as_u64().unwrap_or(100) as usize;
        Ok(Self { ids, pieces, whole, unknown, start, end, is_lowered, longest_word_chars })
    }

    /// The number of a piece, if the vocabulary has it.
    #[must_use]
    pub fn id(&self, piece: &str) -> Option<u32> {
        self.ids.get(piece).copied()
    }

    /// Text to numbers, `[CLS]` before and `[SEP]` after.
    #[must_use]
    pub fn encode(&self, text: &str) -> Tokens {
        let mut ids = vec![self.start];
        let mut rest = text;
        while let Some((at, piece)) = self.first_whole(rest) {
            self.encode_plain(&rest[..at], &mut ids);
            ids.push(self.ids[piece]);
            rest = &rest[at + piece.len()..];
        }
        self.encode_plain(rest, &mut ids);
        ids.push(self.end);
        Tokens { ids }
    }

    /// The first token that stands in the text as it is.
    fn first_whole(&self, text: &str) -> Option<(usize, &str)> {
        self.whole.iter().filter_map(|piece| Some((text.find(piece.as_str())?, piece.as_str()))).min()
    }

    fn encode_plain(&self, text: &str, ids: &mut Vec<u32>) {
        let text = self.normalized(text);
        for word in text.split(char::is_whitespace) {
            let mut start = 0;
            for (at, letter) in word.char_indices().filter(|(_, letter)| is_punctuation(*letter)) {
                self.cut(&word[start..at], ids);
                start = at + letter.len_utf8();
                self.cut(&word[at..start], ids);
            }
            self.cut(&word[start..], ids);
        }
    }

    /// Controls out, Chinese characters apart, accents off, lower case.
    fn normalized(&self, text: &str) -> String {
        let mut clean = String::with_capacity(text.len());
        for letter in text.chars().filter(|letter| !is_control(*letter)) {
            if letter.is_whitespace() {
                clean.push(' ');
            } else if is_chinese(letter) {
                clean.extend([' ', letter, ' ']);
            } else {
                clean.push(letter);
            }
        }
        if !self.is_lowered {
            return clean;
        }
        let is_accent = |letter: &char| letter.general_category() == GeneralCategory::NonspacingMark;
        clean.nfd().filter(|letter| !is_accent(letter)).flat_map(char::to_lowercase).collect()
    }

    /// One word to its longest pieces; a word that cannot be cut to the end is unknown as a whole.
    fn cut(&self, word: &str, ids: &mut Vec<u32>) {
        if word.is_empty() {
            return;
        }
        if word.chars().count() > self.longest_word_chars {
            ids.push(self.unknown);
            return;
        }
        let (before, mut start) = (ids.len(), 0);
        while start < word.len() {
            let ends = word[start..].char_indices().rev().map(|(at, letter)| start + at + letter.len_utf8());
            let mut found = ends.filter_map(|end| Some((end, self.piece_id(start > 0, &word[start..end])?)));
            let Some((end, id)) = found.next() else {
                ids.truncate(before);
                ids.push(self.unknown);
                return;
            };
            ids.push(id);
            start = end;
        }
    }

    fn piece_id(&self, is_continued: bool, piece: &str) -> Option<u32> {
        if is_continued { self.id(&format!("##{piece}")) } else { self.id(piece) }
    }

    /// Numbers back to text, as the reference writes its labels.
    #[must_use]
    pub fn decode(&self, ids: &[u32]) -> String {
        let mut text = String::new();
        for (index, id) in ids.iter().enumerate() {
            let piece = self.pieces.get(*id as usize).map_or("", String::as_str);
            let piece = match piece.strip_prefix("##") {
                _ if index == 0 => piece.to_owned(),
                Some(rest) => rest.to_owned(),
                None => format!(" {piece}"),
            };
            text.push_str(&TIDIED.iter().fold(piece, |piece, (from, to)| piece.replace(from, to)));
        }
        text
    }
}

/// What the reference's decoder closes up, piece by piece.
const TIDIED: [(&str, &str); 11] = [
    (" .", "."),
    (" ?", "?"),
    (" !", "!"),
    (" ,", ","),
    (" ' ", "'"),
    (" n't", "n't"),
    (" 'm", "'m"),
    (" do not", " don't"),
    (" 's", "'s"),
    (" 've", "'ve"),
    (" 're", "'re"),
];

fn is_control(letter: char) -> bool {
    use GeneralCategory::{Control, Format, PrivateUse};
    let is_space = matches!(letter, '\t' | '\n' | '\r');
    let is_other = matches!(letter.general_category(), Control | Format | PrivateUse);
    matches!(letter, '\0' | '\u{fffd}') || is_other && !is_space
}

fn is_punctuation(letter: char) -> bool {
    letter.is_ascii_punctuation() || letter.general_category_group() == GeneralCategoryGroup::Punctuation
}

/// The blocks that BERT's authors call Chinese, with the reference's own first number of the sixth.
fn is_chinese(letter: char) -> bool {
    matches!(u32::from(letter),
        0x4E00..=0x9FFF | 0x3400..=0x4DBF | 0x20000..=0x2A6DF | 0x2A700..=0x2B73F | 0x2B740..=0x2B81F
        | 0x2B920..=0x2CEAF | 0xF900..=0xFAFF | 0x2F800..=0x2FA1F)
}

#[cfg(test)]
mod tests;
