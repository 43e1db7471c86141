//! A configuration file: read, checked, and where it is good wired to a plant.

use stictiond::config;

/// Takes the text of a file.
pub fn run(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    match config::parse("fuzzed.toml", &text) {
        Ok(config) => {
            let _ = config.plant();
            for own in &config.loops {
                let _ = (config.period_s(own), config.neighbours(own));
            }
        }
        Err(wrong) => {
            assert!(!wrong.is_empty(), "refused without a word");
            for diagnostic in wrong {
                let _ = diagnostic.to_string();
            }
        }
    }
}
