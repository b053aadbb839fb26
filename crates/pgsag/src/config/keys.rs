//! The unit of every key, from its name, and values as people write them.

use serde_json::Value;

/// Units that the name's last word says.
const SUFFIXES: [(&str, &str); 13] = [
    ("_px", "px"),
    ("_px2", "px²"),
    ("_m", "m"),
    ("_m2", "m²"),
    ("_deg", "deg"),
    ("_rad", "rad"),
    ("_secs", "s"),
    ("_bytes", "bytes"),
    ("_gsd", "local GSD"),
    ("_steps", "steps"),
    ("_voxels", "voxels"),
    ("_units", "scene units"),
    ("_degree", "degree"),
];

/// Units of names that do not say it.
const NAMED: [(&str, &str); 6] = [
    ("image_width", "px"),
    ("memory_limit", "bytes, KiB, MiB, GiB"),
    ("iterations", "steps"),
    ("holdout", "every Nth image"),
    ("jobs", "jobs"),
    ("threads", "threads"),
];

/// The unit of a dotted key; `-` for words, switches and plain numbers.
#[must_use]
pub fn unit(key: &str) -> &'static str {
    let name = key.rsplit('.').next().unwrap_or(key);
    let named = NAMED.iter().find(|(known, _)| *known == name);
    let suffixed = || SUFFIXES.iter().find(|(suffix, _)| name.ends_with(suffix));
    named.or_else(suffixed).map_or("-", |(_, unit)| unit)
}

/// A value as it would be typed; single-precision numbers in their own shortest spelling.
#[must_use]
pub fn shown(value: &Value) -> String {
    match value {
        Value::Null => "unset".into(),
        Value::String(text) if text.is_empty() => "\"\"".into(),
        Value::String(text) => text.clone(),
        Value::Number(number) => match number.as_f64() {
            Some(double) if number.is_f64() && f64::from(double as f32) == double => format!("{}", double as f32),
            _ => number.to_string(),
        },
        Value::Array(values) => format!("[{}]", values.iter().map(shown).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn single_precision_is_shown_as_it_was_written() {
        assert_eq!(shown(&serde_json::to_value(0.8_f32).expect("number")), "0.8");
        assert_eq!(shown(&json!(0.1)), "0.1");
        assert_eq!(shown(&json!([1, 2])), "[1, 2]");
    }

    #[test]
    fn units_come_from_names() {
        assert_eq!(unit("mesh.truncation_voxels"), "voxels");
        assert_eq!(unit("train.iterations"), "steps");
        assert_eq!(unit("masks"), "-");
    }
}
