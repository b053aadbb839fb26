//! Every setting of a run as dotted keys, so that a stage can be re-run exactly when the slice that it reads changed.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// Dotted key -> value; arrays are values, tables are not.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Settings(BTreeMap<String, Value>);

impl Settings {
    /// The leaves of nested tables.
    #[must_use]
    pub fn flatten(nested: &Value) -> Self {
        let mut flat = BTreeMap::new();
        walk(nested, String::new(), &mut flat);
        Self(flat)
    }

    /// The tables again; keys without a value (absent, or a number that JSON cannot hold) are left to their default.
    #[must_use]
    pub fn nest(&self) -> Value {
        let mut root = Map::new();
        for (key, value) in self.0.iter().filter(|(_, value)| !value.is_null()) {
            let mut table = &mut root;
            let mut parts = key.split('.').peekable();
            while let Some(part) = parts.next() {
                if parts.peek().is_none() {
                    table.insert(part.to_owned(), value.clone());
                    break;
                }
                let next = table.entry(part.to_owned()).or_insert_with(|| Value::Object(Map::new()));
                match next {
                    Value::Object(inner) => table = inner,
                    _ => break,
                }
            }
        }
        Value::Object(root)
    }

    /// The keys that equal one of `prefixes` or lie below it.
    #[must_use]
    pub fn slice(&self, prefixes: &[&str]) -> Self {
        let below = |key: &str, prefix: &str| {
            key.strip_prefix(prefix).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        Self(
            self.0
                .iter()
                .filter(|(key, _)| prefixes.iter().any(|prefix| below(key, prefix)))
                .map(|(key, value)| (key.clone(), value.clone()))
                .collect(),
        )
    }

    /// One value.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.0.get(key)
    }

    /// Sets one value.
    pub fn set(&mut self, key: &str, value: Value) {
        self.0.insert(key.to_owned(), value);
    }

    /// Keys that begin with `before` begin with `after` instead: a short name for what lies deep.
    pub fn rename(&mut self, before: &str, after: &str) {
        let renamed = std::mem::take(&mut self.0).into_iter().map(|(key, value)| match key.strip_prefix(before) {
            Some(rest) => (format!("{after}{rest}"), value),
            None => (key, value),
        });
        self.0 = renamed.collect();
    }

    /// Takes a key out.
    pub fn remove(&mut self, key: &str) {
        self.0.remove(key);
    }

    /// All, by key.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.0.iter().map(|(key, value)| (key.as_str(), value))
    }
}

fn walk(value: &Value, prefix: String, flat: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(table) => {
            for (key, inner) in table {
                let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                walk(inner, path, flat);
            }
        }
        leaf => {
            flat.insert(prefix, leaf.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn flatten_and_nest_are_inverse() {
        let nested = json!({"seed": 3, "train": {"weights": {"l1": 0.8}, "steps": [1, 2]}});
        let flat = Settings::flatten(&nested);
        assert_eq!(flat.get("train.weights.l1"), Some(&json!(0.8)));
        assert_eq!(flat.nest(), nested);
    }

    #[test]
    fn a_slice_does_not_take_a_key_that_only_begins_alike() {
        let flat = Settings::flatten(&json!({"mask": 1, "masks": 2, "mask_px": 3, "train": {"a": 4}}));
        let keys: Vec<_> = flat.slice(&["mask", "train"]).0.into_keys().collect();
        assert_eq!(keys, ["mask", "train.a"]);
    }
}
