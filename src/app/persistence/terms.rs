//! Gives back terms of write-back to loops that have it no more: OP that the rings have again went to the valve with them.

use crate::history::{History, TagKind};
use crate::signal::{LoopId, Role};
use crate::store::{Reader, StoreError};
use crate::writeback::SAID_AGAIN_S;
use std::collections::HashSet;

/// The rings of OP are filled already.
pub(super) fn give_back(reader: &mut Reader, history: &History) -> Result<(), StoreError> {
    let term = Role::Term.as_str();
    let tags = reader.tags()?.into_iter().filter(|stored| stored.name.tag == term);
    let ids: HashSet<LoopId> = tags.map(|stored| LoopId::new(stored.name.control_loop.as_str())).collect();
    for id in ids.iter().filter(|id| history.lacks_terms(id)) {
        let op = history.series(id, &TagKind::Role(Role::Op)).unwrap_or_default();
        let Some((first, last)) = op.first().zip(op.last()) else { continue };
        // A term is said again and again, so the one in force at the first sample of OP is among them.
        let (from, to) = (first.t - SAID_AGAIN_S, last.t + SAID_AGAIN_S);
        history.keep_terms(id, reader.between(id.as_str(), term, from, to)?, SAID_AGAIN_S);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{named, refill};
    use super::*;
    use crate::app::writeback::tests::config;
    use crate::signal::Sample;
    use crate::store::{Batch, Config, Series, Store};
    use std::sync::Arc;

    #[test]
    fn a_start_without_write_back_knows_the_terms_that_acted() {
        let folder = std::env::temp_dir().join(format!("stictiond-terms-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let (store, mut plant) = (Config::new(&folder), config());
        let rings = |plant: &crate::config::Config| {
            History::new(&plant.plant().expect("sound").loops, &plant.history)
        };
        let with_term = rings(&plant);
        let series = named(&with_term).filter_map(|(name, _)| {
            let samples: Vec<Sample> = match name.tag.as_str() {
                "op" => (1000..2000).map(|t| Sample::good(f64::from(t), 50.0)).collect(),
                // The last one is of a daemon that was killed.
                "term" => [(500.0, 9.0), (560.0, 0.0), (1500.0, 2.5), (1560.0, 2.5)]
                    .map(|(t, value)| Sample::good(t, value))
                    .to_vec(),
                _ => return None,
            };
            Some(Series { tag: Arc::new(name), samples })
        });
        let batch = Batch { series: series.collect(), rows: Vec::new() };
        assert_eq!(batch.series.len(), 2);
        Store::open(&store).and_then(|mut store| store.write(&batch)).expect("writes");
        plant.loops[0].writeback = None;
        let history = rings(&plant);
        let filled = refill(&mut Reader::at_hand(&store).expect("opens"), &history, 256);
        assert_eq!(filled.expect("reads"), 1000);
        let record = history.snapshot(&LoopId::new("A")).expect("there");
        let told = [1499.0, 1500.0, 1619.0, 1620.0].map(|t| record.term_at(t));
        assert_eq!(told, [0.0, 2.5, 2.5, 0.0]);
        assert_eq!(record.input()[501].value, 52.5);
        std::fs::remove_dir_all(&folder).expect("it was made");
    }
}
