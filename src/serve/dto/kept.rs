//! The report as text that is kept and read again after a restart.

use super::report::Report;
use crate::results::{Outcome, Run};
use serde_json::Value;
use std::collections::BTreeSet;

impl Report {
    /// The report of a run as text; `None` for a run that failed.
    pub fn text(run: &Run) -> Option<String> {
        if let Outcome::Elsewhere(told) = &run.outcome {
            return told.report.as_deref().map(str::to_string);
        }
        serde_json::to_string(&Self::of(run)?).ok()
    }

    /// The same text of a report that was read.
    pub fn as_text(&self) -> Option<String> {
        serde_json::to_string(self).ok()
    }

    /// The report of such a text; `None` for what this version cannot read.
    pub fn read(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }

    /// Where two such texts differ: the name of each part and what either says, in a few words; empty when they are the
    /// same to the last bit.
    pub fn differences(recorded: &str, replayed: &str) -> Vec<String> {
        if recorded == replayed {
            return Vec::new();
        }
        let read =
            |text: &str| serde_json::from_str::<serde_json::Map<String, Value>>(text).unwrap_or_default();
        let (old, new) = (read(recorded), read(replayed));
        let names: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
        let brief = |value: Option<&Value>| {
            let text = value.map_or("nothing".to_string(), Value::to_string);
            if text.chars().count() <= 60 {
                text
            } else {
                text.chars().take(60).chain("…".chars()).collect()
            }
        };
        let differ = names.into_iter().filter(|name| old.get(*name) != new.get(*name));
        let mut told: Vec<String> = differ
            .map(|name| format!("{name}: {} was {}", brief(new.get(name)), brief(old.get(name))))
            .collect();
        if told.is_empty() {
            told.push("the same numbers, written otherwise".to_string());
        }
        told
    }

    /// How good the data behind it was.
    pub fn quality(&self) -> &'static str {
        self.window.quality.as_str()
    }
}
