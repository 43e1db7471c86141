//! Walks over the chunks of a store: the last samples of some tags, those between two stamps.

use super::backend::{Reads, StoredTag};
use super::rows::{AlarmRow, TagName};
use super::{MAX_CHUNK, Reader, StoreError, codec};
use crate::signal::Sample;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Chunks that are looked through for what was in force at a time, or for the last of some tags: a month of chunks of a minute.
const MOST_BACK: usize = 50_000;

/// Tags, each with samples of it.
pub type Tagged = Vec<(StoredTag, Vec<Sample>)>;

/// Where a walk that wants samples from a time on begins (s): a chunk may begin before the first of its samples.
pub fn first_start(from: f64) -> i64 {
    ((from.clamp(0.0, 1e11) as i64) - MAX_CHUNK).max(0)
}

/// States of alarms, with newer ones in their place, by loop and kind.
pub(super) fn over(older: Vec<AlarmRow>, newer: Vec<AlarmRow>) -> Vec<AlarmRow> {
    let keyed = |row: AlarmRow| ((row.control_loop.clone(), row.kind.clone()), row);
    let rows: BTreeMap<(String, String), AlarmRow> = older.into_iter().chain(newer).map(keyed).collect();
    rows.into_values().collect()
}

pub(super) fn last(
    reads: &mut dyn Reads,
    names: &[TagName],
    count: usize,
) -> Result<HashMap<TagName, Vec<Sample>>, StoreError> {
    let plain = |name: &TagName| TagName { unit: String::new(), ..name.clone() };
    let mut eras: HashMap<TagName, Vec<(i64, u32)>> = HashMap::new();
    for tag in reads.tags()? {
        eras.entry(plain(&tag.name)).or_default().push((tag.era, tag.id));
    }
    // The present era comes first to be taken.
    eras.values_mut().for_each(|ids| ids.sort_unstable());
    let mut found: HashMap<TagName, Vec<Sample>> = HashMap::new();
    let mut lacking: Vec<&TagName> = names.iter().collect();
    while !lacking.is_empty() {
        lacking.retain(|name| eras.get(&plain(name)).is_some_and(|ids| !ids.is_empty()));
        let next: Vec<(&TagName, u32)> =
            lacking.iter().filter_map(|name| Some((*name, eras.get_mut(&plain(name))?.pop()?.1))).collect();
        let mut older = last_of(reads, next.iter().map(|(_, id)| *id).collect(), count)?;
        lacking.clear();
        for (name, id) in next {
            let Some(mut samples) = older.remove(&id) else { continue };
            let newer = found.entry(name.clone()).or_default();
            let overlaps = newer.first().zip(samples.last()).is_some_and(|(new, old)| old.t >= new.t);
            if overlaps {
                continue;
            }
            samples.append(newer);
            samples.drain(..samples.len().saturating_sub(count));
            *newer = samples;
            if newer.len() < count {
                lacking.push(name);
            }
        }
    }
    Ok(found)
}

/// The last `count` samples of each tag by number.
fn last_of(
    reads: &mut dyn Reads,
    mut missing: Vec<u32>,
    count: usize,
) -> Result<HashMap<u32, Vec<Sample>>, StoreError> {
    missing.sort_unstable();
    missing.dedup();
    let mut found: HashMap<u32, Vec<Sample>> = HashMap::new();
    let mut before = i64::MAX;
    // A tag has a sample in each of the chunks that count, or it is not looked for any further.
    for _ in 0..count {
        if missing.is_empty() {
            break;
        }
        let Some(start) = reads.previous_start(before)? else { break };
        before = start;
        for (tag, samples) in reads.chunk(start, Some(&missing))? {
            found.entry(tag).or_default().extend(samples);
        }
        missing.retain(|tag| found.get(tag).is_none_or(|samples| samples.len() < count));
    }
    for samples in found.values_mut() {
        codec::unique(samples);
        samples.drain(..samples.len().saturating_sub(count));
    }
    Ok(found)
}

/// What lies between two stamps, whatever its source and era, as one series: for who asks for a time in which a tag had one of
/// each. Who cannot know asks [`Reader::apart`].
pub(super) fn between(
    reads: &mut dyn Reads,
    control_loop: &str,
    tag: &str,
    [first, last]: [f64; 2],
) -> Result<Vec<Sample>, StoreError> {
    let own = |stored: &StoredTag| stored.name.control_loop == control_loop && stored.name.tag == tag;
    let ids: Vec<u32> = reads.tags()?.iter().filter(|stored| own(stored)).map(|stored| stored.id).collect();
    let (mut found, mut from) = (Vec::new(), first_start(first));
    while let Some(start) = reads.next_start(from)?.filter(|start| *start as f64 <= last) {
        from = start + 1;
        let chunk = reads.chunk(start, Some(&ids))?;
        found.extend(chunk.into_values().flatten().filter(|s| s.t >= first && s.t <= last));
    }
    codec::unique(&mut found);
    Ok(found)
}

impl Reader {
    /// The samples of some tags between two stamps (s, inclusive), by time. A tag of another source or another era is another
    /// tag: none is sorted into another's. `go_on` hears after each chunk how many samples there are, and ends the reading by
    /// saying false; then there is nothing.
    ///
    /// Of a store in PostgreSQL this is what the database has, without what waits for it.
    pub fn apart(
        &mut self,
        tags: &[StoredTag],
        [first, last]: [f64; 2],
        go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<Option<Tagged>, StoreError> {
        let ids = numbers(tags);
        let mut found: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
        let (mut from, mut count) = (first_start(first), 0);
        if ids.is_empty() {
            return Ok(Some(Tagged::new()));
        }
        while let Some(start) = self.next_start(from)?.filter(|start| *start as f64 <= last) {
            from = start + 1;
            for (id, samples) in self.chunk(start, Some(&ids))? {
                let own = found.entry(id).or_default();
                let before = own.len();
                own.extend(samples.into_iter().filter(|s| s.t >= first && s.t <= last));
                count += own.len() - before;
            }
            if !go_on(count) {
                return Ok(None);
            }
        }
        found.values_mut().for_each(codec::unique);
        let own = |tag: &StoredTag| (tag.clone(), found.remove(&tag.id).unwrap_or_default());
        Ok(Some(tags.iter().map(own).collect()))
    }

    /// Start of the last chunk before a time (s) that has a sample of one of some tags; `None` where none of those that are looked
    /// through has one.
    pub fn last_start(&mut self, tags: &[StoredTag], mut before: i64) -> Result<Option<i64>, StoreError> {
        let ids = numbers(tags);
        if ids.is_empty() {
            return Ok(None);
        }
        for _ in 0..MOST_BACK {
            let Some(start) = self.previous_start(before)? else { break };
            if !self.chunk(start, Some(&ids))?.is_empty() {
                return Ok(Some(start));
            }
            before = start;
        }
        Ok(None)
    }

    /// As [`Reader::apart`], and before its samples those that say what was in force at the first stamp, of each tag but those
    /// that are `measured`, by name. A tag that is reported only when it changes may have been reported long before.
    pub fn in_force(
        &mut self,
        tags: &[StoredTag],
        measured: &[&str],
        [first, last]: [f64; 2],
        go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<Option<Tagged>, StoreError> {
        let is_held = |tag: &&StoredTag| !measured.contains(&tag.name.tag.as_str());
        let held: Vec<StoredTag> = tags.iter().filter(is_held).cloned().collect();
        let mut earlier = self.known_before(&held, first, go_on)?;
        let Some(mut found) = self.apart(tags, [first, last], go_on)? else { return Ok(None) };
        for (tag, samples) in &mut found {
            if let Some(mut own) = earlier.remove(&tag.id) {
                own.append(samples);
                *samples = own;
            }
        }
        Ok(Some(found))
    }

    /// By number, the last sample before a stamp that says something, and behind it the first since when nothing is known.
    /// Looked for until there is one of each tag by name, whatever its source and era, or the store has been walked far enough.
    fn known_before(
        &mut self,
        tags: &[StoredTag],
        stamp: f64,
        go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<BTreeMap<u32, Vec<Sample>>, StoreError> {
        let is_known = |sample: &Sample| sample.quality.is_good() && sample.value.is_finite();
        let ids = numbers(tags);
        let mut lacking: BTreeSet<&str> = tags.iter().map(|tag| tag.name.tag.as_str()).collect();
        let mut found: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
        let mut before = stamp.clamp(0.0, 1e11) as i64 + 1;
        for _ in 0..MOST_BACK {
            if lacking.is_empty() || !go_on(0) {
                break;
            }
            let Some(start) = self.previous_start(before)? else { break };
            before = start;
            for (id, samples) in self.chunk(start, Some(&ids))? {
                let own = found.entry(id).or_default();
                if own.first().is_some_and(is_known) {
                    continue;
                }
                let earlier = &samples[..samples.partition_point(|s| s.t < stamp)];
                let known = earlier.iter().rposition(is_known);
                // Of those of which nothing is known the first says since when.
                let mut all = earlier[known.unwrap_or(0)..].to_vec();
                all.append(own);
                all.truncate(2);
                *own = all;
                if let Some(tag) = tags.iter().find(|tag| known.is_some() && tag.id == id) {
                    lacking.remove(tag.name.tag.as_str());
                }
            }
        }
        Ok(found)
    }
}

/// The numbers of some tags as [`Reader::chunk`] wants them.
fn numbers(tags: &[StoredTag]) -> Vec<u32> {
    let mut ids: Vec<u32> = tags.iter().map(|tag| tag.id).collect();
    ids.sort_unstable();
    ids
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{BadReason, Quality};
    use crate::store::embedded::tests::Folder;
    use crate::store::{Batch, Config, Series, Store};
    use std::sync::Arc;

    fn batch(tag: &str, source: &str, samples: Vec<Sample>) -> Batch {
        let name =
            TagName { control_loop: "A".into(), tag: tag.into(), source: source.into(), unit: String::new() };
        Batch { series: vec![Series { tag: Arc::new(name), samples }], rows: Vec::new() }
    }

    fn good(stamps: std::ops::Range<u32>, value: f64) -> Vec<Sample> {
        stamps.map(|t| Sample::good(f64::from(t), value)).collect()
    }

    #[test]
    fn what_is_of_another_era_or_source_is_another_series() {
        let folder = Folder::new();
        let mut store = Store::open(&Config::new(&folder.0)).expect("opens");
        store.write(&batch("pv", "a", good(1000..2000, 1.0))).expect("writes");
        store.begin_era();
        store.write(&batch("pv", "a", good(1500..1800, 2.0))).expect("writes");
        store.write(&batch("pv", "b", good(1800..2500, 3.0))).expect("writes");
        drop(store);
        let mut reader = Reader::open(&folder.0).expect("opens");
        let tags = reader.tags().expect("reads");
        let found = reader.apart(&tags, [1400.0, 1899.0], &mut |_| true).expect("reads").expect("not ended");
        let told = |(tag, samples): &(StoredTag, Vec<Sample>)| {
            let first = samples[0];
            assert!(samples.iter().all(|s| s.value == first.value), "one signal");
            (tag.era, tag.name.source.clone(), first.t, samples.len())
        };
        let told: Vec<_> = found.iter().map(told).collect();
        let (a, b) = ("a".to_string(), "b".to_string());
        assert_eq!(told, [(0, a.clone(), 1400.0, 500), (1, a, 1500.0, 300), (1, b, 1800.0, 100)]);
        assert_eq!(reader.apart(&tags, [1400.0, 1899.0], &mut |_| false).expect("reads"), None);
        assert_eq!(reader.apart(&[], [0.0, 1e10], &mut |_| false).expect("reads"), Some(vec![]));
    }

    #[test]
    fn what_was_in_force_is_found_however_long_ago_it_was_reported() {
        let folder = Folder::new();
        let mut store = Store::open(&Config::new(&folder.0)).expect("opens");
        let bad = |t| Sample { t, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) };
        let mode = vec![Sample::good(1000.0, 0.0), Sample::good(2000.0, 1.0)];
        store.write(&batch("mode", "m", mode)).expect("writes");
        let (first, last) = (Sample::good(3000.0, 50.0), Sample::good(100_100.0, 51.0));
        let sp = vec![first, bad(50_000.0), bad(60_000.0), last];
        store.write(&batch("sp", "s", sp)).expect("writes");
        store.write(&batch("pv", "p", good(90_000..101_000, 1.0))).expect("writes");
        store.write(&batch("mv", "v", good(100_500..100_600, 1.0))).expect("writes");
        drop(store);
        let mut reader = Reader::open(&folder.0).expect("opens");
        let tags = reader.tags().expect("reads");
        let found = reader.in_force(&tags, &["op", "pv"], [100_000.0, 100_999.0], &mut |_| true);
        let found = found.expect("reads").expect("not ended");
        let stamps = |tag: &str| -> Vec<f64> {
            let own = found.iter().find(|(stored, _)| stored.name.tag == tag).expect("there");
            own.1.iter().map(|s| s.t).collect()
        };
        assert_eq!(stamps("mode"), [2000.0]);
        assert_eq!(stamps("sp"), [3000.0, 50_000.0, 100_100.0]);
        assert_eq!((stamps("pv").len(), stamps("pv")[0]), (1000, 100_000.0), "it is measured");
        assert_eq!((stamps("mv").len(), stamps("mv")[0]), (100, 100_500.0), "nothing was known of it");
    }
}
