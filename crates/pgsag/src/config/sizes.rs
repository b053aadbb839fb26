//! Sizes of memory as people write them.

use crate::error::UserError;

const UNITS: [(&str, u64); 9] = [
    ("tib", 1 << 40),
    ("gib", 1 << 30),
    ("mib", 1 << 20),
    ("kib", 1 << 10),
    ("tb", 1_000_000_000_000),
    ("gb", 1_000_000_000),
    ("mb", 1_000_000),
    ("kb", 1_000),
    ("b", 1),
];

/// `8GiB`, `500 MB`, `4096`.
///
/// # Errors
/// [`UserError`] where it is no size.
pub fn parse_size(text: &str) -> Result<u64, UserError> {
    let lower = text.trim().to_ascii_lowercase();
    let (number, unit) =
        UNITS.iter().find_map(|(name, unit)| Some((lower.strip_suffix(name)?, *unit))).unwrap_or((&lower, 1));
    match number.trim().parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok((value * unit as f64) as u64),
        _ => Err(UserError::new("--memory-limit", format!("{text:?} is not a size"), "write it like 8GiB")),
    }
}

/// Bytes in the largest unit that leaves a number above one.
#[must_use]
pub fn size_text(bytes: u64) -> String {
    let unit = UNITS[..4].iter().find(|(_, unit)| bytes >= *unit);
    match unit {
        None => format!("{bytes} B"),
        Some((name, unit)) => {
            let name = format!("{}iB", name[..1].to_ascii_uppercase());
            format!("{:.1} {name}", bytes as f64 / *unit as f64)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_written() {
        assert_eq!(parse_size("8GiB"), Ok(8 << 30));
        assert_eq!(parse_size(" 1.5 kb"), Ok(1500));
        assert_eq!(parse_size("4096"), Ok(4096));
        assert!(parse_size("much").is_err());
        assert!(parse_size("-1GB").is_err());
        assert_eq!(size_text(3 << 29), "1.5 GiB");
        assert_eq!(size_text(12), "12 B");
    }
}
