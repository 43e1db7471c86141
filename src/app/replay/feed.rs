//! Recorded samples in the order of their stamps.

use super::ReplayError;
use crate::history::{History, LoopTags};
use crate::results::basis;
use crate::signal::{Record, Sample};
use crate::store::{self, Reader};
use crate::table::{self, Found, Options, Source, TableError};
use std::collections::HashMap;
use std::path::Path;

/// Most samples of an export; a store has no such bound.
const MOST_SAMPLES: usize = 20_000_000;

/// Gives samples by time.
pub(super) trait Feed: Send {
    /// Hands all samples up to `t` (s) that were not handed out before to `take`, with the numbers of their tags.
    fn until(&mut self, t: f64, take: &mut dyn FnMut(usize, Sample)) -> Result<(), ReplayError>;
}

/// The number of each tag by loop and name.
fn numbers(loops: &[LoopTags]) -> HashMap<(String, String), usize> {
    let tags = loops.iter().flat_map(|own| own.tags.iter().map(move |tag| (own, tag)));
    tags.enumerate().map(|(at, (own, tag))| ((own.id.to_string(), tag.kind.name().to_string()), at)).collect()
}

/// Samples of a store, chunk by chunk.
pub(super) struct Stored {
    reader: Reader,
    /// Stored tags that the plant has, by number, and the plant's number.
    tags: HashMap<u32, usize>,
    wanted: Vec<u32>,
    from: i64,
    first: f64,
    /// Read and not handed out yet, latest first.
    pending: Vec<(usize, Sample)>,
}

impl Stored {
    /// Samples from `first` (s) on.
    pub(super) fn new(reader: Reader, history: &History, first: f64) -> Result<Self, ReplayError> {
        let numbers = numbers(history.loops());
        let own = |tag: &crate::store::StoredTag| {
            Some((tag.id, *numbers.get(&(tag.name.control_loop.clone(), tag.name.tag.clone()))?))
        };
        let tags: HashMap<u32, usize> = reader.tags()?.iter().filter_map(own).collect();
        let mut wanted: Vec<u32> = tags.keys().copied().collect();
        wanted.sort_unstable();
        Ok(Self { from: store::first_start(first), reader, tags, wanted, first, pending: Vec::new() })
    }
}

impl Feed for Stored {
    fn until(&mut self, t: f64, take: &mut dyn FnMut(usize, Sample)) -> Result<(), ReplayError> {
        let mut read = false;
        while let Some(start) = self.reader.next_start(self.from)?.filter(|start| *start as f64 <= t) {
            self.from = start + 1;
            for (tag, samples) in self.reader.chunk(start, Some(&self.wanted))? {
                let Some(&at) = self.tags.get(&tag) else { continue };
                let samples = samples.into_iter().filter(|sample| sample.t >= self.first);
                self.pending.extend(samples.map(|sample| (at, sample)));
            }
            read = true;
            // A long time without a run is handed out as it is read, so that memory stays small.
            hand_out(&mut self.pending, true, (start as f64).min(t), take);
        }
        hand_out(&mut self.pending, read, t, take);
        Ok(())
    }
}

fn hand_out(pending: &mut Vec<(usize, Sample)>, sort: bool, t: f64, take: &mut dyn FnMut(usize, Sample)) {
    if sort {
        pending.sort_by(|a, b| b.1.t.total_cmp(&a.1.t));
    }
    while let Some((tag, sample)) = pending.pop_if(|(_, sample)| sample.t <= t) {
        take(tag, sample);
    }
}

/// Samples in memory.
pub(super) struct Listed(Vec<(usize, Sample)>);

impl Listed {
    /// The samples of a record, its tags in the order of [`basis::series`].
    pub(super) fn of(record: &Record) -> Self {
        let tags = basis::series(record).enumerate();
        let mut all: Vec<_> =
            tags.flat_map(|(at, (_, samples))| samples.iter().rev().map(move |s| (at, *s))).collect();
        // Stable, and turned round beforehand: equal stamps come out in the order they came in.
        all.sort_by(|a, b| b.1.t.total_cmp(&a.1.t));
        Self(all)
    }

    /// The samples of an export that belong to `loops`, and the stamps of the first and the last; `told` is what its table does
    /// not say itself.
    pub(super) fn read(
        file: &Path,
        told: &Options,
        loops: &[LoopTags],
    ) -> Result<(Self, Option<(f64, f64)>), ReplayError> {
        let bad = |what: &str| ReplayError::Input(format!("{}: {what}", file.display()));
        let numbers = numbers(loops);
        let mut all = Vec::new();
        let mut too_many = false;
        table::stream(Source::File(file), told, &mut |tag, sample| {
            let name = (tag.owner.clone(), tag.name.clone());
            let Some(&at) = numbers.get(&name) else { return Ok(()) };
            too_many = all.len() == MOST_SAMPLES;
            if too_many {
                return Err(TableError::Refused("too many samples".into()));
            }
            all.push((at, sample));
            Ok(())
        })
        .or_else(
            |error: TableError| if too_many { Ok(Found::default()) } else { Err(bad(&error.to_string())) },
        )?;
        if too_many {
            return Err(bad(&format!(
                "more than {MOST_SAMPLES} samples: put them into a store with `stictiond store import`"
            )));
        }
        all.reverse();
        all.sort_by(|a, b| b.1.t.total_cmp(&a.1.t));
        let span = all.last().zip(all.first()).map(|(first, last)| (first.1.t, last.1.t));
        Ok((Self(all), span))
    }
}

impl Feed for Listed {
    fn until(&mut self, t: f64, take: &mut dyn FnMut(usize, Sample)) -> Result<(), ReplayError> {
        hand_out(&mut self.0, false, t, take);
        Ok(())
    }
}
