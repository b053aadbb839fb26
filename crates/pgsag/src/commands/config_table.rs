//! `pgsag config`.

use anyhow::Result;
use serde_json::json;

use super::print;
use crate::cli::SettingArgs;
use crate::config::keys::{shown, unit};
use crate::config::{Config, Source};

/// Prints every key with its value, default, unit and where the value came from.
pub(super) fn run(args: &SettingArgs, json: bool) -> Result<()> {
    let resolved = args.resolve()?;
    let defaults = Config::default().settings();
    let settings = resolved.config.settings();
    let width = settings.iter().map(|(key, _)| key.len()).max().unwrap_or(0);
    if !json {
        print(&format!("{:width$}  {:>14} {:>14}  {:12} {}", "key", "value", "default", "unit", "source"))?;
    }
    for (key, value) in settings.iter() {
        let source = resolved.sources.get(key).unwrap_or(&Source::Default).to_string();
        let default = defaults.get(key).cloned().unwrap_or_default();
        if json {
            print(
                &json!({"key": key, "value": value, "default": default, "unit": unit(key), "source": source})
                    .to_string(),
            )?;
        } else {
            let (value, default) = (shown(value), shown(&default));
            print(&format!("{key:width$}  {value:>14} {default:>14}  {:12} {source}", unit(key)))?;
        }
    }
    Ok(())
}
