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

use std::collections::BinaryHeap;

/// Rows that may come late one after the other, and islands of rows between those of another run that count.
const FEW: u64 = 3;
/// A step that is so many usual ones long ends a run: another may lie within it.
const LEAP: f64 = 20.0;
/// Steps from which the usual one is taken.
const STEPS: usize = 8;
/// Runs that are kept of all channels together: 10 MB.
const MOST_RUNS: usize = 1 << 18;
/// Times in common that are looked at, those with most rows.
const MOST_OVERLAPS: usize = 64;
/// Rows that are looked at in each.
const MOST_ROWS: usize = 1 << 12;
/// Islands that each step back may make where rows come late.
const ISLANDS: u64 = 6;
/// One time in so many may have another value when it comes again.
const OTHERS: u64 = 10;

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

    /// Makes one of runs that follow each other after a long step.
    fn close_gaps(&mut self) {
        self.done.dedup_by(|next, before| {
            let follows = next.from >= before.to;
            if follows {
                before.join(next);
            }
            follows
        });
    }
}

/// The runs of all channels.
pub struct Runs {
    channels: Vec<OfChannel>,
    falls: bool,
    count: usize,
}

impl Runs {
    /// Of so many channels; `falls` where the newest stands first.
    pub fn new(channels: usize, falls: bool) -> Self {
        Self { channels: vec![OfChannel::default(); channels], falls, count: 0 }
    }

    /// One more sample of a channel at `t` (s); `false` where there are more runs than can be kept.
    pub fn add(&mut self, channel: usize, t: f64) -> bool {
        let own = &mut self.channels[channel];
        let before = own.done.len();
        own.add(if self.falls { -t } else { t });
        self.count += own.done.len() - before;
        if self.count > MOST_RUNS {
            self.channels.iter_mut().for_each(OfChannel::close_gaps);
            self.count = self.channels.iter().map(|own| own.done.len()).sum();
        }
        self.count <= MOST_RUNS
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
                    let part = Overlap::new(channel, [run.from, run.to.min(widest.to)], size);
                    parts += 1;
                    match &mut whole {
                        Some(whole) => {
                            whole.to = whole.to.max(part.to);
                            whole.size += size;
                        }
                        None => whole = Some(Overlap::new(channel, [part.from, part.to], size)),
                    }
                    all.push(part);
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
    /// The first rows in the order of time; the latest of them stands first.
    rows: BinaryHeap<Row>,
}

impl Overlap {
    fn new(channel: usize, [from, to]: [f64; 2], size: u64) -> Self {
        Self { channel, from, to, size, rows: BinaryHeap::new() }
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
    pub fn add(&mut self, channel: usize, t: f64, line: u64, value: impl Fn() -> u64) {
        let at = self.rows[channel];
        self.rows[channel] += 1;
        let t = if self.falls { -t } else { t };
        let own = self.all.iter_mut().filter(|own| own.channel == channel);
        for overlap in own.filter(|own| (own.from..=own.to).contains(&t)) {
            overlap.rows.push(Row { t: ordered(t), at, line, value: value() });
            if overlap.rows.len() > MOST_ROWS {
                overlap.rows.pop();
            }
        }
    }

    /// The first two records within each other, in the order of the file.
    pub fn first(&self) -> Option<Found> {
        let found = self.all.iter().filter_map(|own| {
            let (line, is_so) = own.judge();
            is_so.then_some(Found { channel: own.channel, line, length: own.to - own.from })
        });
        found.min_by_key(|found| found.line)
    }

    /// The line and the length (s) of the longest time that two runs have in common.
    pub fn longest(&self) -> Option<(u64, f64)> {
        let longest = self.all.iter().max_by(|a, b| (a.to - a.from).total_cmp(&(b.to - b.from)));
        longest.map(|own| (own.judge().0, own.to - own.from))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether two records lie within each other, by times and values in the order of the file: the line, and for how long.
    fn found(rows: &[(f64, u64)]) -> Option<(u64, f64)> {
        let mut ways = [0, 0];
        for pair in rows.windows(2) {
            ways[usize::from(pair[1].0 < pair[0].0)] += 1;
        }
        let mut runs = Runs::new(1, ways[1] > ways[0]);
        assert!(rows.iter().all(|(t, _)| runs.add(0, *t)));
        let mut overlaps = runs.overlaps();
        for (line, (t, value)) in (2..).zip(rows) {
            overlaps.add(0, *t, line, || *value);
        }
        overlaps.first().map(|found| (found.line, found.length))
    }

    /// Rows every two seconds from a time on.
    fn steady(from: f64, count: usize, value: u64) -> Vec<(f64, u64)> {
        (0..count).map(|at| (from + 2.0 * at as f64, value + at as u64)).collect()
    }

    /// Numbers that look random, below `most`.
    fn random(most: usize) -> impl FnMut() -> usize {
        let mut state = 1_u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % most
        }
    }

    #[test]
    fn records_within_each_other_are_found_in_either_direction() {
        let first = steady(0.0, 1200, 0);
        for second in [
            // Another loop, between the rows and at the same times; a clock that was set back.
            steady(0.7, 1200, 5000),
            steady(0.0, 1200, 5000),
            steady(2400.7 - 900.0, 600, 5000),
            // Another one, thirty times as slow.
            (0..40).map(|at| (60.0 * f64::from(at) + 0.5, 7)).collect(),
        ] {
            let both = [first.clone(), second.clone()].concat();
            let length = 2398.0 - second[0].0;
            let (line, long) = found(&both).expect("two records");
            assert!(line == 1202 && (long - length).abs() < 60.0, "{line}: {long}");
            let turned: Vec<(f64, u64)> = both.iter().rev().copied().collect();
            assert!(found(&turned).is_some(), "{}", second[0].0);
        }
    }

    #[test]
    fn one_record_in_any_order_is_none_of_two() {
        let whole = steady(0.0, 1200, 0);
        let turned: Vec<(f64, u64)> = whole.iter().rev().copied().collect();
        let blocks = |order: &[usize]| -> Vec<(f64, u64)> {
            order.iter().flat_map(|at| whole[100 * at..100 * (at + 1)].iter().copied()).collect()
        };
        let names = blocks(&[3, 7, 11, 1, 0, 6, 5, 2, 4, 10, 9, 8]);
        let even_first = blocks(&[0, 2, 4, 6, 8, 10, 1, 3, 5, 7, 9, 11]);
        let again = [&whole[..700], &whole[500..]].concat();
        let late = |every: usize, by: usize| {
            let mut rows = whole.clone();
            (0..1200 - by).step_by(every).for_each(|at| {
                let row = rows.remove(at);
                rows.insert(at + by, row);
            });
            rows
        };
        let mut next = random(1200);
        let mut mixed = whole.clone();
        (0..1200).for_each(|at| mixed.swap(at, next()));
        for (what, rows) in [
            ("newest first", turned.clone()),
            ("months by their names", names),
            ("even first", even_first),
            ("overlapping exports", again.clone()),
            ("overlapping exports, newest first", again.iter().rev().copied().collect()),
            ("late by one row", late(7, 1)),
            ("late by forty rows", late(50, 40)),
            (
                "fifteen rows late",
                [&whole[..400], &whole[415..600], &whole[400..415], &whole[600..]].concat(),
            ),
            ("in no order", mixed),
        ] {
            assert_eq!(found(&rows), None, "{what}");
        }
    }

    #[test]
    fn blocks_of_an_irregular_record_are_one_in_any_order() {
        let mut next = random(1000);
        let mut t = 0.0;
        let rows: Vec<(f64, u64)> = (0..2000)
            .map(|at| {
                t += [1.0, 1.0, 2.0, 5.0, 30.0, 300.0][next() % 6] * (next() + 1) as f64 / 1000.0;
                (t, at)
            })
            .collect();
        for cuts in [[100, 900, 1500], [3, 700, 701], [20, 30, 1999]] {
            let [a, b, c] = cuts;
            for order in [[3, 1, 2, 0], [2, 0, 3, 1], [1, 0, 3, 2]] {
                let parts = [&rows[..a], &rows[a..b], &rows[b..c], &rows[c..]];
                let moved = order.map(|at| parts[at]).concat();
                assert_eq!(found(&moved), None, "{cuts:?} {order:?}");
            }
        }
        let other: Vec<(f64, u64)> = rows.iter().map(|(t, value)| (0.9 * t + 0.3, value + 5000)).collect();
        assert!(found(&[rows, other].concat()).is_some());
    }

    #[test]
    fn times_keep_their_order_as_numbers() {
        let times = [f64::NEG_INFINITY, -2.5, -0.5, 0.0, 0.5, 2.5, f64::INFINITY];
        assert!(times.windows(2).all(|pair| ordered(pair[0]) < ordered(pair[1])));
    }
}
