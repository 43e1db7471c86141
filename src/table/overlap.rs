//! Times that are recorded twice. A file may be in no order of time: the newest first, blocks of days or months one after the other, single
//! rows that came late. Sorted, each of these is one record. Two records in one file are not, and neither is one whose clock was set back:
//! sorted, rows of the one lie between rows of the other.
//!
//! | step | finds |
//! |---|---|
//! | [`Runs`] | the runs of rows of each channel that follow each other in time, in a few numbers each |
//! | [`Runs::overlaps`] | the times that two runs have in common |
//! | [`Overlaps::first`] | whether rows of the two lie between each other there, or say other things at the same time |
//!
//! The same rows twice, as two exports of overlapping times have them, are one record.

use std::collections::{BTreeSet, BinaryHeap};

/// Rows that may come late one after the other, and islands of rows between those of another run that count.
const FEW: u64 = 3;
/// A step that is so many usual ones long ends a run: another may lie within it.
const LEAP: f64 = 20.0;
/// Steps from which the usual one is taken.
const STEPS: usize = 8;
/// Runs that are kept of all channels together: 8 MB.
const MOST_RUNS: usize = 1 << 18;
/// Runs that are kept for each channel at least, so that many channels do not take them from each other.
const RUNS_OF_EACH: usize = 16;
/// Times in common that are looked at, those with most rows.
const MOST_OVERLAPS: usize = 64;
/// Rows that are looked at in each.
const MOST_ROWS: usize = 1 << 12;
/// Islands that each step back may make where rows come late.
const ISLANDS: u64 = 6;
/// One time in so many may have another value when it comes again.
const OTHERS: u64 = 10;
/// Less than one row in so many of a channel may lie within another record: a clock that was set right by some seconds moves so few.
const SMALL: u64 = 50;

/// Rows of one channel that follow each other; times have their sign turned where the newest stands first.
#[derive(Clone, Copy)]
struct Run {
    from: f64,
    to: f64,
    rows: u64,
    /// Steps back that led to it and within it.
    turns: u64,
}

impl Run {
    fn new(t: f64, turns: u64) -> Self {
        Self { from: t, to: t, rows: 1, turns }
    }

    fn join(&mut self, other: &Run) {
        self.from = self.from.min(other.from);
        self.to = self.to.max(other.to);
        self.rows += other.rows;
        self.turns += other.turns;
    }

    /// Whether it goes back so often that nothing can be said of it.
    fn is_in_no_order(&self) -> bool {
        self.rows <= FEW * self.turns
    }
}

/// The runs of one channel so far.
#[derive(Clone, Default)]
struct OfChannel {
    done: Vec<Run>,
    now: Option<Run>,
    /// Rows before the end of the run that may be late ones.
    late: Option<Run>,
    /// The row before.
    last: f64,
    /// The latest steps forward, and how many there were.
    steps: [f64; STEPS],
    taken: usize,
}

impl OfChannel {
    fn add(&mut self, t: f64) {
        let last = std::mem::replace(&mut self.last, t);
        let usual = self.usual();
        let Some(now) = &mut self.now else {
            self.now = Some(Run::new(t, 0));
            return;
        };
        if t < now.to {
            let own = Run::new(t, u64::from(self.late.is_none() || t < last));
            let late = match self.late.take() {
                Some(mut late) => {
                    late.join(&own);
                    late
                }
                None => own,
            };
            if late.rows > FEW {
                self.end();
                self.now = Some(late);
            } else {
                self.late = Some(late);
            }
            return;
        }
        let step = t - now.to;
        if let Some(late) = self.late.take() {
            now.rows += late.rows;
            now.turns += late.turns;
        }
        if step > LEAP * usual {
            self.end();
            self.now = Some(Run::new(t, 0));
        } else {
            now.to = t;
            now.rows += 1;
        }
        if step > 0.0 {
            self.steps[self.taken % STEPS] = step;
            self.taken += 1;
        }
    }

    /// The usual step (s); without end before the first one.
    fn usual(&self) -> f64 {
        let mut steps = self.steps;
        let steps = &mut steps[..self.taken.min(STEPS)];
        steps.sort_unstable_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or(f64::INFINITY)
    }

    fn end(&mut self) {
        let Some(now) = self.now.take() else { return };
        match self.done.last_mut() {
            Some(before) if before.is_in_no_order() && now.is_in_no_order() => before.join(&now),
            _ => self.done.push(now),
        }
    }

    /// Makes one of runs that follow each other in time, wherever they stand in the file: as few as there are at one time.
    fn close_gaps(&mut self) {
        let mut done = std::mem::take(&mut self.done);
        done.sort_unstable_by(|a, b| a.from.total_cmp(&b.from));
        // The ends of those that are made, each with its place.
        let mut ends: BTreeSet<(u64, usize)> = BTreeSet::new();
        for run in done {
            // The one that ends last before this one begins.
            let before = ends.range(..=(ordered(run.from), usize::MAX)).next_back().copied();
            let at = match before {
                Some(end) => {
                    ends.remove(&end);
                    self.done[end.1].join(&run);
                    end.1
                }
                None => {
                    self.done.push(run);
                    self.done.len() - 1
                }
            };
            ends.insert((ordered(self.done[at].to), at));
        }
    }
}

/// The runs of all channels.
pub struct Runs {
    channels: Vec<OfChannel>,
    falls: bool,
    count: usize,
    most: usize,
}

impl Runs {
    /// Of so many channels; `falls` where the newest stands first.
    pub fn new(channels: usize, falls: bool) -> Self {
        let most = MOST_RUNS.max(RUNS_OF_EACH * channels);
        Self { channels: vec![OfChannel::default(); channels], falls, count: 0, most }
    }

    /// One more sample of a channel at `t` (s); `false` where there are more runs than can be kept: then no more can be added.
    pub fn add(&mut self, channel: usize, t: f64) -> bool {
        let own = &mut self.channels[channel];
        let before = own.done.len();
        own.add(if self.falls { -t } else { t });
        self.count += own.done.len() - before;
        if self.count <= self.most {
            return true;
        }
        self.channels.iter_mut().for_each(OfChannel::close_gaps);
        self.count = self.channels.iter().map(|own| own.done.len()).sum();
        // Where few are left, many can be added before this is done again.
        2 * self.count <= self.most
    }

    /// The times that runs of a channel have in common: those with most rows, and for each channel all of them together.
    pub fn overlaps(mut self) -> Overlaps {
        let mut all: Vec<Overlap> = Vec::new();
        for (channel, own) in self.channels.iter_mut().enumerate() {
            own.end();
            own.done.sort_unstable_by(|a, b| a.from.total_cmp(&b.from));
            let Some((mut widest, rest)) = own.done.split_first().map(|(first, rest)| (*first, rest)) else {
                continue;
            };
            let (mut whole, mut parts): (Option<Overlap>, usize) = (None, 0);
            for run in rest {
                let size = run.rows.min(widest.rows);
                if run.from < widest.to && size > FEW {
                    let part = [run.from, run.to.min(widest.to)];
                    parts += 1;
                    match &mut whole {
                        Some(whole) => whole.extend(part, size),
                        None => whole = Some(Overlap::new(channel, part, size)),
                    }
                    all.push(Overlap::new(channel, part, size));
                }
                if run.to > widest.to {
                    widest = *run;
                }
            }
            all.extend(whole.filter(|_| parts > 1));
        }
        all.sort_by_key(|own| std::cmp::Reverse(own.size));
        all.truncate(MOST_OVERLAPS);
        Overlaps { all, rows: vec![0; self.channels.len()], falls: self.falls }
    }
}

/// A row within times that two runs have in common. The fields are in the order by which rows are sorted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Row {
    /// Its time, as a number of the same order.
    t: u64,
    /// Its number among the rows of its channel, in the order of the file.
    at: u64,
    line: u64,
    value: u64,
}

/// Times that two runs of a channel have in common.
struct Overlap {
    channel: usize,
    from: f64,
    to: f64,
    /// Rows of the shorter run.
    size: u64,
    /// Its parts, in the order of time and apart from each other; one that is no whole has one.
    parts: Vec<[f64; 2]>,
    /// Rows of both within its parts.
    count: u64,
    /// The first rows in the order of time; the latest of them stands first.
    rows: BinaryHeap<Row>,
}

impl Overlap {
    fn new(channel: usize, [from, to]: [f64; 2], size: u64) -> Self {
        Self { channel, from, to, size, parts: vec![[from, to]], count: 0, rows: BinaryHeap::new() }
    }

    /// One more part, which does not begin before the last one.
    fn extend(&mut self, [from, to]: [f64; 2], size: u64) {
        self.to = self.to.max(to);
        self.size += size;
        match self.parts.last_mut() {
            Some(last) if from <= last[1] => last[1] = last[1].max(to),
            _ => self.parts.push([from, to]),
        }
    }

    /// Whether a time is within a part.
    fn has(&self, t: f64) -> bool {
        let begun = self.parts.partition_point(|part| part[0] <= t);
        self.parts[..begun].last().is_some_and(|part| t <= part[1])
    }

    /// The line in which times go back, or in which the one run that is here begins, and whether two records lie within each other.
    fn judge(&self) -> (u64, bool) {
        let mut of_file: Vec<Row> = self.rows.iter().copied().collect();
        of_file.sort_unstable_by_key(|row| row.at);
        let turns = || of_file.windows(2).filter(|pair| pair[1].t < pair[0].t);
        let turn = turns().max_by_key(|pair| pair[0].t - pair[1].t).map(|pair| pair[1].line);
        let line = turn.or(of_file.first().map(|row| row.line)).unwrap_or_default();
        let allowed = ISLANDS * turns().count() as u64 + FEW;
        let mut rows = of_file.clone();
        rows.sort_unstable();
        let (mut again, mut others) = (0, 0);
        // The lengths of stretches of times that follow each other in the file, too.
        let mut stretches: Vec<u64> = Vec::new();
        let mut before: Vec<(u64, u64)> = Vec::new();
        for same in rows.chunk_by(|a, b| a.t == b.t) {
            // Rows of one time stand in one place of the file, or in several.
            let places: Vec<&[Row]> = same.chunk_by(|a, b| a.at + 1 == b.at).collect();
            let values = |place: &[Row]| place.iter().map(|row| row.value).collect::<Vec<u64>>();
            if let Some((first, rest)) = places.split_first().filter(|(_, rest)| !rest.is_empty()) {
                again += 1;
                others += u64::from(rest.iter().any(|place| values(place) != values(first)));
            }
            let ends: Vec<(u64, u64)> =
                places.iter().filter_map(|place| Some((place.first()?.at, place.last()?.at))).collect();
            let follows = |own: &(u64, u64)| before.iter().any(|b| b.1 + 1 == own.0 || own.1 + 1 == b.0);
            match stretches.last_mut() {
                Some(length) if ends.iter().any(follows) => *length += 1,
                _ => stretches.push(1),
            }
            before = ends;
        }
        // The first and the last one are cut by the window.
        let inner = stretches.get(1..stretches.len().saturating_sub(1)).unwrap_or_default();
        let islands = inner.iter().filter(|length| **length <= FEW).count() as u64;
        (line, islands > allowed || others > allowed && others * OTHERS > again)
    }
}

/// A number of the same order.
fn ordered(t: f64) -> u64 {
    let bits = t.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | (1 << 63) }
}

/// What was found.
pub struct Found {
    /// The place of the channel.
    pub channel: usize,
    /// The line in which times go back.
    pub line: u64,
    /// How long two records lie within each other (s).
    pub length: f64,
    /// Rows of the channel in these times, and all of them.
    pub rows: [u64; 2],
}

impl Found {
    /// Whether it has so few rows that the record is one all the same.
    pub fn is_small(&self) -> bool {
        self.rows[0] * SMALL < self.rows[1]
    }
}

/// All times that runs have in common.
pub struct Overlaps {
    all: Vec<Overlap>,
    /// Rows of each channel so far.
    rows: Vec<u64>,
    falls: bool,
}

impl Overlaps {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// One more sample of a channel at `t` (s), in the order of the file; `value` tells it from others.
    pub fn add(&mut self, channel: usize, t: f64, line: u64, value: u64) {
        let at = self.rows[channel];
        self.rows[channel] += 1;
        let t = if self.falls { -t } else { t };
        let own = self.all.iter_mut().filter(|own| own.channel == channel);
        for overlap in own.filter(|own| (own.from..=own.to).contains(&t)) {
            overlap.count += u64::from(overlap.has(t));
            overlap.rows.push(Row { t: ordered(t), at, line, value });
            if overlap.rows.len() > MOST_ROWS {
                overlap.rows.pop();
            }
        }
    }

    /// The first two records within each other, in the order of the file; small ones only where there are no others.
    pub fn first(&self) -> Option<Found> {
        let found = self.all.iter().filter_map(|own| {
            let (line, is_so) = own.judge();
            let (channel, length) = (own.channel, own.to - own.from);
            let rows = [own.count, self.rows[channel]];
            is_so.then_some(Found { channel, line, length, rows })
        });
        found.min_by_key(|found| (found.is_small(), found.line))
    }

    /// The line and the length (s) of the longest time that two runs have in common.
    pub fn longest(&self) -> Option<(u64, f64)> {
        let longest = self.all.iter().max_by(|a, b| (a.to - a.from).total_cmp(&(b.to - b.from)));
        longest.map(|own| (own.judge().0, own.to - own.from))
    }
}

#[cfg(test)]
mod tests;
