//! Whether a store that is opened again is the one that was written to. Where its disk was replaced, or its folder moved or deleted, it
//! is another: what was durable is not in it, and nobody says it again until it changes.

use crate::store::embedded::ledger_in;
use crate::store::{Config, Reader, StoreError};

/// What is known of that.
#[derive(Debug, Default)]
pub(super) struct Anew {
    /// The one that was open is gone; what its ledger said last.
    gone: Option<u32>,
    /// Nothing could be written to the folder, which was a store of its own: what its states were is known, and in no other.
    is_refused: bool,
}

impl Anew {
    /// The store has failed.
    pub(super) fn failed(&mut self, error: &StoreError) {
        match error {
            StoreError::Gone { ledger, .. } => self.gone = Some(*ledger),
            StoreError::OwnStore { .. } => self.is_refused = true,
            _ => {}
        }
    }

    /// Looks whether the one that was gone is back, as a disk that was away for a moment; asked before it is opened, which changes
    /// its ledger.
    pub(super) fn look(&mut self, config: &Config) {
        if self.gone.is_some() && self.gone == ledger_in(&config.folder) {
            self.gone = None;
        }
    }

    /// Whether the one that is opened now is another. Where something was written, one that has nothing is new. What a database
    /// elsewhere has and does not have shows when it is reached.
    pub(super) fn is_other(&self, config: &Config, has_written: bool) -> bool {
        let is_known = self.gone.is_some() || self.is_refused;
        is_known || has_written && config.url.is_none() && is_new(config).unwrap_or(false)
    }
}

/// Whether a store has nothing: no tag, no state of anything, and no run, of which there are also some without samples.
fn is_new(config: &Config) -> Result<bool, StoreError> {
    let reader = Reader::open(&config.folder)?;
    Ok(reader.tags()?.is_empty() && reader.alarms()?.is_empty() && reader.diagnoses(0, 1)?.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Sample;
    use crate::store::embedded::tests::Folder;
    use crate::store::{AlarmRow, Batch, Row, Series, Store, TagName};
    use std::sync::Arc;

    fn of_samples(t: f64) -> Batch {
        let [control_loop, tag, source, unit] = ["A", "op", "", ""].map(String::from);
        let tag = Arc::new(TagName { control_loop, tag, source, unit });
        Batch { series: vec![Series { tag, samples: vec![Sample::good(t, 1.0)] }], rows: Vec::new() }
    }

    #[test]
    fn one_that_is_empty_is_another_where_something_was_written() {
        let of_alarm = Batch { series: Vec::new(), rows: vec![Row::Alarm(AlarmRow::default())] };
        for batch in [of_samples(1000.0), of_alarm] {
            let folder = Folder::new();
            let config = Config::new(&folder.0);
            let mut store = Store::open(&config).expect("opens");
            let mut anew = Anew::default();
            assert!(anew.is_other(&config, true), "nothing was ever written to it");
            assert!(!anew.is_other(&config, false), "nor to another");
            store.write(&batch).expect("writes");
            anew.failed(&StoreError::Missing(folder.0.clone()));
            assert!(!anew.is_other(&config, true));
        }
    }

    #[test]
    fn one_that_was_away_for_a_moment_is_the_same_and_one_in_its_place_another() {
        let (folder, aside) = (Folder::new(), Folder::new());
        let config = Config::new(&folder.0);
        let mut store = Store::open(&config).expect("opens");
        store.write(&of_samples(1000.0)).expect("writes");
        std::fs::rename(&folder.0, &aside.0).expect("writable");
        let mut anew = Anew::default();
        anew.failed(&store.tidy(1000.0).expect_err("it is gone"));
        drop(store);
        let mut other = Store::open(&config).expect("begins anew");
        other.write(&of_samples(2000.0)).expect("writes");
        anew.look(&config);
        assert!(anew.is_other(&config, true));
        drop(other);
        std::fs::remove_dir_all(&folder.0).expect("there");
        std::fs::rename(&aside.0, &folder.0).expect("writable");
        anew.look(&config);
        drop(Store::open(&config).expect("opens"));
        assert!(!anew.is_other(&config, true));
    }
}
