//! Walks over the chunks of a store: the last samples of some tags, those between two stamps.

use super::backend::{Reads, StoredTag};
use super::rows::{AlarmRow, TagName};
use super::{MAX_CHUNK, StoreError, codec};
use crate::signal::Sample;
use std::collections::{BTreeMap, HashMap};

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
