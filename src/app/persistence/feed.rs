//! What the writer asks for what is new: the rings, each from where it was left, and the changes as rows.

use super::again::Again;
use super::rows::rows;
use super::set_back::SET_BACK_S;
use super::waiting::{drop_oldest, keep_latest};
use super::{Shared, Tap, lock};
use crate::signal::Sample;
use crate::store::{Batch, Feed, Found, Row, Series};
use std::borrow::Borrow;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

/// Samples written in one go.
const MAX_SAMPLES: usize = 200_000;
/// Other rows written in one go, and what was said together with the last of them.
const MAX_ROWS: usize = 1000;
/// A source whose stamps fall back more often than this (s) has no clock to go by: what it sends is taken for late.
const FALLS_S: f64 = 3600.0;
/// Stamps of a source may be ahead of our clock by this (s) when the daemon starts.
const AHEAD_S: f64 = 60.0;

/// Tells the time (s).
pub(super) type Now = Box<dyn Fn() -> f64 + Send>;

/// Takes what was not known into what there is; what changes by it is noted.
pub(super) type Merge = Box<dyn Fn(Found) + Send>;

/// A row that waits.
#[derive(Debug)]
struct Queued {
    /// Number of what was said with it: all of that is kept or nothing.
    said: u64,
    row: Row,
}

impl Borrow<Row> for Queued {
    fn borrow(&self) -> &Row {
        &self.row
    }
}

/// What the writer asks for what is new.
pub(super) struct StoreFeed {
    shared: Arc<Shared>,
    clock: Now,
    merge: Merge,
    again: Again,
    /// Rows that are not durable, oldest first, and about what memory they take; at most how much those may that are no state.
    rows: VecDeque<Queued>,
    bytes: usize,
    max_bytes: usize,
    /// What was said so far that belongs together.
    said: u64,
    batch: Batch,
    /// How far each ring was read for the batch, and the last stamp that was read.
    read: Vec<(Arc<Tap>, u64, Option<f64>)>,
    /// The ring that comes first in the next batch, so that none waits for ever.
    first: usize,
    full: bool,
    told: f64,
    /// When a ring last told of a clock that was set back (s).
    fell: f64,
    back: Back,
    /// How often the clock was set back and no era was begun for it yet.
    owed: u32,
    /// How often it was set back, as far as eras were begun or are owed for it.
    seen: u32,
}

/// Where a clock that was set back has taken us.
#[derive(Clone, Copy, PartialEq)]
enum Back {
    /// It was not.
    No,
    /// Samples of before are written first.
    Before,
    /// What comes now belongs to the new era.
    Now,
}

impl StoreFeed {
    pub(super) fn new(
        shared: Arc<Shared>,
        clock: Now,
        (merge, again): (Merge, Again),
        max_bytes: usize,
    ) -> Self {
        // Set back while nobody ran: what was kept is of later.
        let last = |tap: &Arc<Tap>| f64::from_bits(tap.last.load(Relaxed));
        let newest = lock(&shared.taps).iter().map(last).fold(f64::NEG_INFINITY, f64::max);
        let told = clock().max(newest - AHEAD_S);
        let seen = lock(&shared.set_backs).begin(told);
        Self {
            shared,
            told,
            fell: f64::NEG_INFINITY,
            clock,
            merge,
            again,
            rows: VecDeque::new(),
            bytes: 0,
            max_bytes,
            said: 0,
            batch: Batch::default(),
            read: Vec::new(),
            first: 0,
            full: false,
            back: Back::No,
            owed: 0,
            seen,
        }
    }

    fn queue(&mut self, row: Row) {
        self.bytes += row.bytes();
        self.rows.push_back(Queued { said: self.said, row });
    }

    fn say_leaving(&self) {
        self.shared.leaving.store(self.back != Back::No, Relaxed);
    }

    /// Keeps what waits within its bound, beside the latest state of each thing: the oldest reports go first, then the oldest rows.
    /// States count to no bound: they may not go, and all else would go for them.
    fn bound(&mut self) {
        if self.bytes <= self.max_bytes {
            return;
        }
        let (shared, bytes) = (&self.shared, &mut self.bytes);
        keep_latest(&mut self.rows, |row| *bytes -= row.bytes());
        let states = self.rows.iter().filter(|own| own.row.is_state());
        let most = self.max_bytes.saturating_add(states.map(|own| own.row.bytes()).sum());
        for own in &mut self.rows {
            if *bytes <= most {
                return;
            }
            if let Row::Diagnosis(row) = &mut own.row {
                // What it worked on says nothing without what it said.
                let whole = [row.report.take(), row.basis.take()];
                let taken: usize = whole.iter().flatten().map(Vec::len).sum();
                *bytes -= taken;
                shared.dropped_rows.fetch_add(u64::from(taken > 0), Relaxed);
            }
        }
        drop_oldest(&mut self.rows, |row| {
            let is_over = *bytes > most;
            if is_over {
                *bytes -= row.bytes();
                shared.dropped_rows.fetch_add(1, Relaxed);
            }
            is_over
        });
    }
}

impl Feed for StoreFeed {
    fn gather(&mut self) {
        let changes = std::mem::take(&mut *lock(&self.shared.changes));
        let own = std::mem::take(&mut *lock(&self.shared.rows));
        for change in changes.into_changes() {
            self.said += 1;
            rows(change).into_iter().for_each(|row| self.queue(row));
        }
        for row in own {
            // What happened to a thing comes behind how it is since then.
            self.said += u64::from(!matches!(row, Row::Transition(_)));
            self.queue(row);
        }
        self.bound();
        let now = (self.clock)();
        let count = lock(&self.shared.set_backs).look(now);
        if count > self.seen {
            self.owed = self.owed.saturating_add(count - self.seen);
            self.seen = count;
            if self.back == Back::No {
                self.back = Back::Before;
            }
        }
        self.told = now;
        self.say_leaving();
    }

    fn set_back(&mut self) -> bool {
        let now = self.back == Back::Now;
        if now {
            // While the store failed it may have been set back again: those samples are still to be told apart.
            self.owed = self.owed.saturating_sub(1);
            self.back = if self.owed > 0 { Back::Before } else { Back::No };
            // Whatever comes is of the new era: what was before is no measure for it.
            let begun = f64::NAN.to_bits();
            lock(&self.shared.taps).iter().for_each(|tap| tap.last.store(begun, Relaxed));
            self.say_leaving();
        }
        now
    }

    fn merge(&mut self, found: Found) {
        (self.merge)(found);
    }

    fn say_again(&mut self) {
        let ends = (self.again)();
        self.gather();
        let (mut steps, behind) = ends.steps(self.rows.iter().map(|own| &own.row), self.told);
        for (place, own) in std::mem::take(&mut self.rows).into_iter().enumerate() {
            if let Some(row) = steps.remove(&place) {
                self.bytes += row.bytes();
                self.rows.push_back(Queued { said: own.said, row });
            }
            self.rows.push_back(own);
        }
        for row in behind {
            self.said += u64::from(matches!(row, Row::Transition(_)));
            self.queue(row);
        }
        self.bound();
    }

    fn has_read(&self) -> bool {
        self.shared.has_read.load(Relaxed)
    }

    fn take(&mut self) -> &Batch {
        let mut end = MAX_ROWS.min(self.rows.len());
        while end > 0 && self.rows.get(end).is_some_and(|next| next.said == self.rows[end - 1].said) {
            end += 1;
        }
        self.batch.rows = self.rows.iter().take(end).map(|own| own.row.clone()).collect();
        self.batch.series.clear();
        self.read.clear();
        self.full = false;
        let taps = lock(&self.shared.taps).clone();
        self.first = if taps.is_empty() { 0 } else { self.first % taps.len() };
        let mut room = MAX_SAMPLES;
        let begun = self.seen.saturating_sub(self.owed);
        for tap in taps[self.first..].iter().chain(&taps[..self.first]) {
            if room == 0 {
                self.full = true;
                break;
            }
            // A ring that is followed since a later set-back has nothing of the era that is written now, and does not fall back.
            if self.back == Back::Before && tap.set_backs > begun {
                continue;
            }
            let next = tap.next.load(Relaxed);
            let (first, mut samples) = tap.ring.since(next, room);
            self.shared.lost_samples.fetch_add(first - next, Relaxed);
            tap.next.store(first, Relaxed);
            // A ring only goes forward: what falls back in it was stamped by a clock that was set back.
            let mut last = f64::from_bits(tap.last.load(Relaxed));
            let falls = |sample: &Sample| sample.t < std::mem::replace(&mut last, sample.t) - SET_BACK_S;
            let may = self.back == Back::Before || !(self.fell..self.fell + FALLS_S).contains(&self.told);
            if may && let Some(until) = samples.iter().position(falls) {
                samples.truncate(until);
                (self.back, self.fell) = (Back::Before, self.told);
            }
            let last = samples.last().map(|sample| sample.t);
            room -= samples.len();
            self.read.push((tap.clone(), first + samples.len() as u64, last));
            if !samples.is_empty() {
                self.batch.series.push(Series { tag: tap.tag.clone(), samples });
            }
        }
        self.say_leaving();
        &self.batch
    }

    fn settled(&mut self) -> bool {
        for (tap, next, last) in &self.read {
            tap.next.store(*next, Relaxed);
            if let Some(last) = last {
                tap.last.store(last.to_bits(), Relaxed);
            }
        }
        for own in self.rows.drain(..self.batch.rows.len()) {
            self.bytes -= own.row.bytes();
        }
        if self.full {
            self.first += self.read.len();
        }
        let drained =
            |tap: &Arc<Tap>| tap.retired.load(Relaxed) && tap.ring.pushed() <= tap.next.load(Relaxed);
        lock(&self.shared.taps).retain(|tap| !drained(tap));
        let crossing = self.back == Back::Before && !self.full;
        if crossing {
            self.back = Back::Now;
        }
        self.full || crossing || !self.rows.is_empty()
    }
}

#[cfg(test)]
mod tests;
