//! Restores the terms of loops whose write-back was removed. While they were in force, the valve got OP plus the term, so a
//! diagnosis of OP of that time needs them.

use crate::history::{History, TagKind};
use crate::signal::{LoopId, Role, Series};
use crate::store::{Reader, StoreError, StoredTag};
use crate::writeback::TERM_REPEAT_S;
use std::cmp::Reverse;
use std::collections::HashSet;

/// Gives the history the terms that acted on the OP in its rings. The rings of OP have to be filled before.
pub(super) fn give_back(reader: &mut Reader, history: &History) -> Result<(), StoreError> {
    let stored = reader.tags()?;
    let terms = stored.iter().filter(|stored| stored.name.tag == Role::Term.as_str());
    let ids: HashSet<LoopId> = terms.map(|stored| LoopId::new(stored.name.control_loop.as_str())).collect();
    for id in ids.iter().filter(|id| history.lacks_terms(id)) {
        let terms = acted(reader, history, &stored, id)?;
        history.keep_terms(id, terms, TERM_REPEAT_S);
    }
    Ok(())
}

/// The terms that acted on the OP in the ring of a loop; `stored` are all tags of the store.
/// The store is asked for the eras of OP, because a ring does not have them, and one that a reload took over was not read from it.
fn acted(
    reader: &mut Reader,
    history: &History,
    stored: &[StoredTag],
    id: &LoopId,
) -> Result<Series, StoreError> {
    let kind = TagKind::Role(Role::Op);
    let filled = history.series(id, &kind).unwrap_or_default();
    let own = history.loops().iter().find(|own| own.id == *id);
    let spec = own.and_then(|own| own.tags.iter().find(|tag| tag.kind == kind));
    let (Some(first), Some(last), Some(spec)) = (filled.first(), filled.last(), spec) else {
        return Ok(Series::new());
    };
    // A term in force is recorded again each TERM_REPEAT_S, so the one in force at the first sample of OP is among them.
    let limits = [first.t - TERM_REPEAT_S, last.t + TERM_REPEAT_S];
    let term = Role::Term.as_str();
    let is_wanted = |own: &&StoredTag| {
        let name = &own.name;
        let is_op = name.tag == kind.name() && name.source == spec.source;
        name.control_loop == id.as_str() && (name.tag == term || is_op)
    };
    let tags: Vec<StoredTag> = stored.iter().filter(is_wanted).cloned().collect();
    let found = reader.apart(&tags, limits, &mut |_| true)?.unwrap_or_default();
    let (terms, mut ops): (Vec<_>, Vec<_>) = found.into_iter().partition(|(tag, _)| tag.name.tag == term);
    ops.sort_by_key(|(tag, _)| Reverse(tag.era));
    // Each era whose OP is in the ring, with the span of that OP; the present era comes first.
    let (mut eras, mut end) = (Vec::<(i64, [f64; 2])>::new(), f64::INFINITY);
    for (tag, samples) in ops {
        let mut own = samples.iter().filter(|sample| sample.t >= first.t);
        let Some(begin) = own.next() else { continue };
        let last = own.next_back().unwrap_or(begin);
        // An era that overlaps a later one is not in the ring: the clock was set back.
        if last.t < end {
            eras.push((tag.era, [begin.t - TERM_REPEAT_S, end]));
            end = begin.t;
        }
    }
    let is_known: HashSet<u64> = terms.iter().flat_map(|(_, own)| own).map(|own| own.t.to_bits()).collect();
    let is_of = |era: i64, t: f64| eras.iter().any(|(own, [from, to])| *own == era && *from <= t && t < *to);
    let mut acted = Series::new();
    for (tag, own) in &terms {
        acted.extend(own.iter().filter(|own| is_of(tag.era, own.t)));
    }
    // Terms in the spool are not in the database yet, so they have no era there. They are later than all that the database has.
    let all = reader.between(id.as_str(), term, limits[0], limits[1])?;
    acted.extend(all.into_iter().filter(|own| !is_known.contains(&own.t.to_bits())));
    acted.sort_by(|a, b| a.t.total_cmp(&b.t));
    Ok(acted)
}

#[cfg(test)]
mod tests {
    use super::super::{named, refill};
    use super::*;
    use crate::app::writeback::tests::config;
    use crate::signal::Sample;
    use crate::store::{Batch, Config, Series as Stored, Store};
    use std::ops::Range;
    use std::path::PathBuf;
    use std::sync::Arc;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("stictiond-terms-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        folder
    }

    fn rings(plant: &crate::config::Config) -> History {
        History::new(&plant.plant().expect("sound").loops, &plant.history)
    }

    /// OP of every second, which is 50 %, and terms by their stamps.
    fn batch(history: &History, op: Range<u32>, terms: &[(f64, f64)]) -> Batch {
        let series = named(history).filter_map(|(name, _)| {
            let samples: Vec<Sample> = match name.tag.as_str() {
                "op" => op.clone().map(|t| Sample::good(f64::from(t), 50.0)).collect(),
                "term" => terms.iter().map(|(t, value)| Sample::good(*t, *value)).collect(),
                _ => return None,
            };
            Some(Stored { tag: Arc::new(name), samples })
        });
        let series: Vec<Stored> = series.filter(|own| !own.samples.is_empty()).collect();
        Batch { series, rows: Vec::new() }
    }

    #[test]
    fn a_start_without_write_back_knows_the_terms_that_acted() {
        let (folder, mut plant) = (folder("acted"), config());
        let store = Config::new(&folder);
        // The last one is of a daemon that was killed.
        let terms = [(500.0, 9.0), (560.0, 0.0), (1500.0, 2.5), (1560.0, 2.5)];
        let batch = batch(&rings(&plant), 1000..2000, &terms);
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

    #[test]
    fn terms_of_before_the_clock_was_set_back_do_not_act_on_op_of_after() {
        for (name, new, expected) in [
            ("none", vec![], [0.0, 0.0, 0.0, 0.0]),
            ("new", vec![(1700.0, 1.5), (1720.0, 0.0)], [0.0, 0.0, 1.5, 0.0]),
        ] {
            let (folder, mut plant) = (folder(name), config());
            let (store, with_term) = (Config::new(&folder), rings(&plant));
            let mut writer = Store::open(&store).expect("opens");
            let old = [(1380.0, 2.5), (1500.0, 2.5), (1560.0, 2.5), (1800.0, 0.0)];
            writer.write(&batch(&with_term, 1000..2000, &old)).expect("writes");
            writer.begin_era();
            writer.write(&batch(&with_term, 1400..2400, &new)).expect("writes");
            drop(writer);
            plant.loops[0].writeback = None;
            let history = rings(&plant);
            let filled = refill(&mut Reader::at_hand(&store).expect("opens"), &history, 256);
            assert_eq!(filled.expect("reads"), 1000, "OP is that of after");
            let record = history.snapshot(&LoopId::new("A")).expect("there");
            let told = [1401.0, 1600.0, 1710.0, 1730.0].map(|t| record.term_at(t));
            assert_eq!(told, expected, "{name}");
            std::fs::remove_dir_all(&folder).expect("it was made");
        }
    }
}
