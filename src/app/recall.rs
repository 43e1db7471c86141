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
        let kept = store.as_ref().map(|store| looked_up(store, id, basis, &rings, own))?;
        let kept = kept
            .inspect_err(|error| tracing::warn!(%error, "a bundle cannot be read from the store"))
            .ok()?;
        let (record, lost) = basis.cut(kept);
        lost.is_empty().then_some(record)
    })
}

/// What the store has of the run. Where it is damaged there it fails from now on: nobody else may have read there since it was
/// opened, and it would go on as if nothing were missing.
fn looked_up(
    store: &store::Config,
    id: &LoopId,
    basis: &Basis,
    rings: &Record,
    neighbours: &[Neighbour],
) -> Result<Record, StoreError> {
    let found = Reader::at_hand(store).and_then(|mut reader| {
        let record = joined(&mut reader, id, basis, rings, neighbours)?;
        Ok((record, reader.damaged()))
    });
    match &found {
        Ok((_, blobs)) => store::heed_blobs(store, *blobs),
        Err(error) => store::heed(store, error),
    }
    found.map(|(record, _)| record)
}

/// What the store has of the run's tags and time, and after it what only the rings have.
fn joined(
    reader: &mut Reader,
    id: &LoopId,
    basis: &Basis,
    rings: &Record,
    neighbours: &[Neighbour],
) -> Result<Record, StoreError> {
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
    use crate::store::{Batch, Config, Series, Store, TagName, Upkeep};
    use std::os::unix::fs::FileExt;
    use std::path::{Path, PathBuf};

    fn batch(source: &str, samples: &[Sample]) -> Batch {
        let series = ["op", "pv"].map(|tag| {
            let (control_loop, tag, source) = ("A".into(), tag.into(), source.into());
            let name = TagName { control_loop, tag, source, unit: String::new() };
            Series { tag: Arc::new(name), samples: samples.to_vec() }
        });
        Batch { series: series.to_vec(), rows: Vec::new() }
    }

    fn samples(from: u32, value: f64) -> Vec<Sample> {
        (from..from + 1000).map(|t| Sample::good(f64::from(t), value)).collect()
    }

    fn empty_folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("stictiond-recall-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        folder
    }

    /// Overwrites the first page of the samples.
    fn a_page(folder: &Path) {
        let path = folder.join("store.db");
        let db = rusqlite::Connection::open(&path).expect("opens");
        let sql = "SELECT rootpage FROM sqlite_schema WHERE name = 'chunks'";
        let page: i64 = db.query_row(sql, [], |row| row.get(0)).expect("reads");
        let file = std::fs::OpenOptions::new().write(true).open(path).expect("there");
        file.write_all_at(&[0x5a; 8192], (page as u64 - 1) * 8192).expect("writable");
    }

    /// Puts something else into the place of some samples, as a page would that is damaged where the database does not look.
    fn a_blob(folder: &Path) {
        let db = rusqlite::Connection::open(folder.join("store.db")).expect("opens");
        db.execute("UPDATE chunks SET samples = zeroblob(40)", []).expect("writes");
    }

    /// Has reading fail, as on a sector that has gone bad: a process has nothing at the begin of its memory.
    fn a_sector(folder: &Path) {
        let path = folder.join("store.db");
        std::fs::rename(&path, folder.join("aside")).expect("writable");
        std::os::unix::fs::symlink("/proc/self/mem", path).expect("writable");
    }

    /// The store was opened before all of it was looked at, and the run is the first to read there.
    #[test]
    fn a_run_that_comes_upon_damage_has_the_store_fail() {
        type Hurt = fn(&Path);
        let hurts: [(&str, Hurt); 3] = [("page", a_page), ("blob", a_blob), ("sector", a_sector)];
        for (what, hurt) in hurts {
            let folder = empty_folder(what);
            let upkeep = Upkeep { at_once: 1, each: 0, ..Upkeep::default() };
            let config = Config { upkeep, ..Config::new(&folder) };
            let record = Record { op: samples(1000, 1.0), pv: samples(1000, 1.0), ..Record::default() };
            let mut store = Store::open(&config).expect("opens");
            store.insert(&batch("a", &record.op)).expect("writes");
            drop(store);
            let mut store = Store::open(&config).expect("opens");
            // It looks at what is old now, and not again for a minute.
            store.tidy(2000.0).expect("tidies");
            let snapshot: Snapshot = Arc::new(|_: &LoopId| Some(Record::default()));
            let recall = recall(snapshot, Some(config.clone()), HashMap::new());
            let basis = Basis::of(&record, &Settings::default(), None);
            assert_eq!(recall(&LoopId::new("A"), &basis), Some(record), "it is whole");
            assert!(!store::is_damaged(&config));
            hurt(&folder);
            store.tidy(2001.0).expect("nobody knows yet");
            assert_eq!(recall(&LoopId::new("A"), &basis), None, "{what}");
            assert!(store::is_damaged(&config), "{what}");
            assert!(store.tidy(2002.0).is_err_and(|error| error.is_damage()), "{what}: it works on");
            drop(store);
            std::fs::remove_dir_all(&folder).expect("it was made");
        }
    }

    #[test]
    fn a_run_of_before_the_clock_was_set_back_finds_its_own_samples() {
        let folder = empty_folder("back");
        let config = Config::new(&folder);
        // The same hour three times: as it was, from another register, and after the clock was set back.
        let (first, elsewhere, again) = (samples(1000, 1.0), samples(1400, 2.0), samples(1200, 3.0));
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
