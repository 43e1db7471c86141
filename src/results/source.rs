//! Which valve the results of a loop are about: the one whose OP and PV were read. Where those are read elsewhere it is another
//! valve, though the loop has the same name.

use super::{Entry, Results, Run, lock};
use crate::signal::LoopId;

impl Run {
    /// What stands for where its samples were read; `None` where nobody said.
    pub fn source(&self) -> Option<u64> {
        self.basis.as_ref()?.source
    }
}

impl Entry {
    /// Whether samples that were read there are of the valve that the loop has now. Where either is not known they are taken to be.
    pub(super) fn is_of(&self, source: Option<u64>) -> bool {
        source.zip(self.source).is_none_or(|(source, own)| source == own)
    }

    /// Where the samples of its latest diagnosis were read.
    fn diagnosed_source(&self) -> Option<u64> {
        match &self.diagnosed {
            Some((run, _)) => run.source(),
            None => self.restored.as_ref()?.0.source,
        }
    }
}

impl Results {
    /// Takes where each loop is read from `now` (s) on, as [`Record::source`](crate::signal::Record::source) tells it. What speaks
    /// for the valve of before is forgotten of a loop that was read elsewhere: the friction of before a term, the votes for and
    /// against its alarms, and its f over time. Its structure is no longer given to a run. An alarm that stands does so until runs
    /// on the new source clear it; that friction rises is over at once, because only f over time shows it.
    pub fn read_from(&self, sources: impl IntoIterator<Item = (LoopId, u64)>, now: f64) {
        for (id, source) in sources {
            let Some(entry) = self.entry(&id) else { continue };
            let mut entry = lock(&entry);
            let before = entry.source.or_else(|| entry.diagnosed_source());
            entry.source = Some(source);
            if before.is_some_and(|before| before != source) {
                (entry.before, entry.fitted_before) = (None, None);
                self.forget_evidence(&id, now);
                tracing::info!(
                    control_loop = %id,
                    "OP or PV is read elsewhere: the loop is taken to have another valve"
                );
            }
        }
    }
}
