//! Finds the samples again that a run worked on: in the rings, and what those have overwritten in the store.

use crate::config::Neighbour;
use crate::results::{Basis, basis};
use crate::schedule::Snapshot;
use crate::serve::Recall;
use crate::signal::{LoopId, Record, Sample};
use crate::store::{self, Reader, StoreError, StoredTag};
use std::collections::HashMap;
use std::sync::Arc;

/// Looks into what `snapshot` copies and then into the store; `neighbours` says whose the other tags are.
pub(super) fn recall(
    snapshot: Snapshot,
    store: Option<store::Config>,
    neighbours: HashMap<LoopId, Vec<Neighbour>>,
) -> Recall {
    Arc::new(move |id, basis| {
        let rings = snapshot(id)?;
        let (record, lost) = basis.cut(rings.clone());
        if lost.is_empty() {
            return Some(record);
        }
        let own = neighbours.get(id).map_or(&[][..], Vec::as_slice);
        let kept = store.as_ref().map(|store| joined(store, id, basis, &rings, own))?;
        let kept = kept
            .inspect_err(|error| tracing::warn!(%error, "a bundle cannot be read from the store"))
            .ok()?;
        let (record, lost) = basis.cut(kept);
        lost.is_empty().then_some(record)
    })
}

/// What the store has of the run's tags and time, and after it what only the rings have.
fn joined(
    store: &store::Config,
    id: &LoopId,
    basis: &Basis,
    rings: &Record,
    neighbours: &[Neighbour],
) -> Result<Record, StoreError> {
    let mut reader = Reader::at_hand(store)?;
    let mut record = Record::default();
    for extent in &basis.extents {
        let own = basis::series(rings).find(|(tag, _)| *tag == extent.tag);
        let own = own.map_or(&[][..], |(_, own)| own.as_slice());
        let mut all = own.to_vec();
        if let Some((first, last)) = extent.span {
            let (whose, tag) = whose(id, &extent.tag, neighbours);
            all = followed(reader.between(&whose, &tag, first, last)?, own);
            if !is_whole(basis, &extent.tag, &all) {
                // The time came twice, or the tag was read in another place too: the run knew one of them.
                let is_tag = |stored: &StoredTag| stored.name.control_loop == whose && stored.name.tag == tag;
                let tags: Vec<StoredTag> = reader.tags()?.into_iter().filter(is_tag).collect();
                let apart = reader.apart(&tags, [first, last], &mut |_| true)?.unwrap_or_default();
                let mut each = apart.into_iter().map(|(_, samples)| followed(samples, own));
                all = each.find(|samples| is_whole(basis, &extent.tag, samples)).unwrap_or(all);
            }
        }
        basis::put(&mut record, &extent.tag, all);
    }
    Ok(record)
}

/// Samples of the store, and after them what only a ring has.
fn followed(mut stored: Vec<Sample>, ring: &[Sample]) -> Vec<Sample> {
    let newest = stored.last().map_or(f64::NEG_INFINITY, |sample| sample.t);
    stored.extend(ring.iter().filter(|sample| sample.t > newest));
    stored
}

/// Whether these are the samples of a tag that the run worked on.
fn is_whole(basis: &Basis, tag: &str, samples: &[Sample]) -> bool {
    let mut alone = Record::default();
    basis::put(&mut alone, tag, samples.to_vec());
    !basis.cut(alone).1.iter().any(|lost| lost == tag)
}

/// The loop and tag behind a name in a record.
pub(super) fn whose(id: &LoopId, tag: &str, neighbours: &[Neighbour]) -> (String, String) {
    match neighbours.iter().find(|own| own.name == tag) {
        Some(own) => (own.id.to_string(), own.kind.name().to_string()),
        None => (id.to_string(), tag.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::Settings;
    use crate::store::{Batch, Config, Series, Store, TagName};

    #[test]
    fn a_run_of_before_the_clock_was_set_back_finds_its_own_samples() {
        let folder = std::env::temp_dir().join(format!("stictiond-recall-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let config = Config::new(&folder);
        let at = |from: u32, value: f64| -> Vec<Sample> {
            (from..from + 1000).map(|t| Sample::good(f64::from(t), value)).collect()
        };
        let batch = |source: &str, samples: &[Sample]| {
            let series = ["op", "pv"].map(|tag| {
                let (control_loop, tag, source) = ("A".into(), tag.into(), source.into());
                let name = TagName { control_loop, tag, source, unit: String::new() };
                Series { tag: Arc::new(name), samples: samples.to_vec() }
            });
            Batch { series: series.to_vec(), rows: Vec::new() }
        };
        // The same hour three times: as it was, from another register, and after the clock was set back.
        let (first, elsewhere, again) = (at(1000, 1.0), at(1400, 2.0), at(1200, 3.0));
        let mut store = Store::open(&config).expect("opens");
        store.write(&batch("a", &first)).expect("writes");
        store.write(&batch("b", &elsewhere)).expect("writes");
        store.begin_era();
        store.write(&batch("a", &again)).expect("writes");
        drop(store);
        let snapshot: Snapshot = Arc::new(|_: &LoopId| Some(Record::default()));
        let recall = recall(snapshot, Some(config), HashMap::new());
        for samples in [first, elsewhere, again] {
            let record = Record { op: samples.clone(), pv: samples, ..Record::default() };
            let basis = Basis::of(&record, &Settings::default(), None);
            assert_eq!(recall(&LoopId::new("A"), &basis), Some(record));
        }
        std::fs::remove_dir_all(&folder).expect("it was made");
    }
}
