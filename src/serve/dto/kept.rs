//! The report as text that is kept and read again after a restart.

use super::report::Report;
use crate::results::Run;

impl Report {
    /// The report of a run as text; `None` for a run that failed.
    pub fn text(run: &Run) -> Option<String> {
        serde_json::to_string(&Self::of(run)?).ok()
    }

    /// The report of such a text; `None` for what this version cannot read.
    pub fn read(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }

    /// How good the data behind it was.
    pub fn quality(&self) -> &'static str {
        self.window.quality.as_str()
    }
}
