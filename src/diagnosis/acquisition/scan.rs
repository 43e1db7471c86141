//! The controller's scans from when held values change.
//!
//! Between two polls that found different values there was a scan; between two that found the same value there was most
//! likely none. On a circle of one period a scan is where the intervals of changes lie and those without are not:
//!
//! ```text
//! score(T, phase) = share of the changes whose interval covers the phase - share of the others that do
//! ```
//!
//! 1 at the true period and phase, about 0 at others. Both tags are asked on their own, since PV may be read later than OP,
//! and have to agree on the period.

use super::lattice::Lattice;
use crate::signal::Sample;

/// Places on the circle of one period.
const PLACES: usize = 60;
/// Least score at which scans are believed: a value that repeats itself by chance in every fifth scan leaves as much.
const BELIEVED: f64 = 0.75;
/// Fewest intervals without a change of a tag that say anything.
const LEAST_HELD: usize = 12;
/// Least share of the intervals without a change that there have to be, of those that the period leaves.
const HELD: f64 = 0.6;
/// Shortest and longest period tried, from the polls' and from the mean time between changes.
const PERIODS: [f64; 2] = [0.85, 1.15];
/// Least share of the intervals that are shorter than a period, for it to be asked: the others say nothing.
const SHORTER: f64 = 0.3;
/// Step of the periods tried, in periods over the stretch that is looked at.
const STEP: f64 = 0.08;
/// How much further before OP's scan than behind it PV's may lie (share of the period).
const EARLIER: f64 = 0.15;
/// Intervals of the first look.
const FIRST: usize = 120;
/// How many times more each further look has.
const FURTHER: usize = 3;
/// Candidates that go on to it.
const KEPT: usize = 6;
/// Most periods of the first look.
const MOST_PERIODS: f64 = 20_000.0;
/// How far below the best a score is as good.
const LEVEL: f64 = 0.04;
/// The same over the whole record.
const SHARP: f64 = 0.004;
/// Periods tried to each side in the end, and twice as many phases; their steps as shares of those before.
const SHARPER: (i32, f64) = (10, 0.1);

/// The controller's scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan {
    /// Their period (s).
    pub period: f64,
    /// When OP and PV become new, by the polls' stamps (s): PV before OP where it is read later.
    pub phases: [f64; 2],
}

/// The time between two samples of a tag, and whether its value changed.
#[derive(Clone, Copy, Debug)]
struct Interval {
    from: f64,
    to: f64,
    changed: bool,
}

/// A period with its score and the phase of each tag there.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    period: f64,
    score: f64,
    phases: [f64; 2],
}

/// Neighbouring periods that are as good: short stretches leave the period open.
#[derive(Clone, Copy, Debug)]
struct Plateau {
    /// Its middle.
    best: Candidate,
    /// How far the true period may be from there (s).
    reach: f64,
}

/// The scans that OP and PV tell; `None` where their values are not held, or polls come too seldom to see it.
pub fn recognise(op: &[Sample], pv: &[Sample], polled: &Lattice) -> Option<Scan> {
    let t0 = polled.t0;
    let tags = [intervals(op, t0), intervals(pv, t0)];
    let longest = tags.iter().map(|tag| between_changes(tag)).fold(f64::INFINITY, f64::min);
    if tags.iter().any(|tag| tag.iter().filter(|i| !i.changed).count() < LEAST_HELD) || !longest.is_finite() {
        return None;
    }
    let (least, most) = (PERIODS[0] * polled.period, PERIODS[1] * longest.max(polled.period));
    let whole = tags[0].len().min(tags[1].len());
    let middle = most_held(&tags, whole);
    let about = |size: usize| {
        let from = middle.saturating_sub(size / 2).min(whole - size);
        tags.each_ref().map(|tag| &tag[from..from + size])
    };
    let step_of = |part: &[&[Interval]; 2]| STEP * least * least / span(part[1]).max(least);
    let mut size = FIRST.min(whole);
    let mut part = about(size);
    let mut step = step_of(&part);
    let count = ((most - least) / step).ceil().min(MOST_PERIODS) as usize;
    let all = |i: usize| least + (most - least) * i as f64 / count.max(1) as f64;
    let mut best = plateaus((0..=count).map(|i| rated(&part, all(i))).collect(), step, LEVEL);
    while size < whole {
        // A period that is true fits every part of the record.
        best.retain(|plateau| plateau.best.score > BELIEVED - LEVEL);
        size = (size * FURTHER).min(whole);
        part = about(size);
        step = step_of(&part);
        let level = if size == whole { SHARP } else { LEVEL };
        let finer = |near: &Plateau| {
            let reach = (near.reach / step).ceil() as i64;
            let at = |i: i64| near.best.period + i as f64 * step;
            plateaus((-reach..=reach).map(|i| rated(&part, at(i))).collect(), step, level)
        };
        best = best.iter().flat_map(finer).collect();
        keep_best(&mut best);
    }
    let found = best.first().map(|plateau| plateau.best).filter(|found| found.score > BELIEVED)?;
    // A value that is newer at every poll is not held: its polls are its samples.
    let expected = (1.0 - polled.period / found.period).max(0.0);
    let held = |tag: &[Interval]| {
        tag.iter().filter(|i| !i.changed).count() as f64 >= HELD * expected * tag.len() as f64
    };
    if !tags.iter().all(|tag| held(tag)) {
        return None;
    }
    let found = sharpened(&tags, found);
    let [of_op, mut of_pv] = found.phases;
    // The nearer of PV's scans belongs to OP's; of two as near the one before, since PV read late shows its scan early.
    of_pv -= ((of_pv - of_op) / found.period + EARLIER).round() * found.period;
    Some(Scan { period: found.period, phases: [t0 + of_op, t0 + of_pv] })
}

/// The period and the phases on a finer grid: a poll next to a scan must come to lie on its right side over all of the record.
fn sharpened(tags: &[Vec<Interval>; 2], about: Candidate) -> Candidate {
    let span = span(&tags[1]).max(about.period);
    let (most, step) = SHARPER;
    let mut tried = Vec::new();
    for i in -most..=most {
        let period = about.period * (1.0 + f64::from(i) * step * STEP * about.period / span);
        let of = |tag: usize| {
            let at = |k: i32| about.phases[tag] + f64::from(k) * step * about.period / PLACES as f64;
            let scores = (-2 * most..=2 * most).map(|k| (score(&tags[tag], period, at(k)), at(k)));
            middle(&scores.collect::<Vec<_>>())
        };
        let [op, pv] = [of(0), of(1)];
        tried.push((op.0 + pv.0, Candidate { period, score: about.score, phases: [op.1, pv.1] }));
    }
    middle(&tried).1
}

/// The middle of the best that stand side by side.
fn middle<T: Copy>(tried: &[(f64, T)]) -> (f64, T) {
    let most = tried.iter().map(|one| one.0).fold(f64::NEG_INFINITY, f64::max);
    let first = tried.iter().position(|one| one.0 == most).unwrap_or(0);
    let run = tried[first..].iter().take_while(|one| one.0 == most).count();
    tried[first + run / 2]
}

/// The score of one phase at a period.
fn score(tag: &[Interval], period: f64, phase: f64) -> f64 {
    let mut covering = [0.0_f64; 2];
    let mut counts = [0.0_f64; 2];
    for interval in tag.iter().filter(|i| i.to - i.from < period) {
        let scans = ((interval.to - phase) / period).floor() - ((interval.from - phase) / period).floor();
        counts[usize::from(!interval.changed)] += 1.0;
        covering[usize::from(!interval.changed)] += scans;
    }
    covering[0] / counts[0].max(1.0) - covering[1] / counts[1].max(1.0)
}

/// The best stretches of neighbouring periods, by increasing period.
fn plateaus(tried: Vec<Candidate>, step: f64, level: f64) -> Vec<Plateau> {
    let most = tried.iter().map(|candidate| candidate.score).fold(f64::NEG_INFINITY, f64::max);
    // Short of the best by this a period is not ruled out by a few intervals more.
    let good = |candidate: &Candidate| candidate.score > most - level;
    let runs = tried.chunk_by(|a, b| good(a) == good(b)).filter(|run| good(&run[0]));
    let mut found: Vec<Plateau> = runs
        .map(|run| Plateau { best: run[run.len() / 2], reach: (0.5 * run.len() as f64 + 1.5) * step })
        .collect();
    keep_best(&mut found);
    found
}

fn keep_best(found: &mut Vec<Plateau>) {
    found.sort_by(|a, b| b.best.score.total_cmp(&a.best.score));
    found.truncate(KEPT);
}

fn intervals(series: &[Sample], t0: f64) -> Vec<Interval> {
    let interval =
        |w: &[Sample]| Interval { from: w[0].t - t0, to: w[1].t - t0, changed: w[1].value != w[0].value };
    series.windows(2).map(interval).collect()
}

/// Mean time between changes, holes left out (s).
fn between_changes(tag: &[Interval]) -> f64 {
    let short = 3.0 * crate::sysid::stats::median(&tag.iter().map(|i| i.to - i.from).collect::<Vec<f64>>());
    let near = || tag.iter().filter(|i| i.to - i.from < short);
    near().map(|i| i.to - i.from).sum::<f64>() / near().filter(|i| i.changed).count() as f64
}

fn span(tag: &[Interval]) -> f64 {
    tag.last().map_or(0.0, |last| last.to) - tag.first().map_or(0.0, |first| first.from)
}

/// The middle of the stretch with the most intervals without a change: there the scans show.
fn most_held(tags: &[Vec<Interval>; 2], whole: usize) -> usize {
    let size = FIRST.min(whole);
    let held =
        |from: &usize| tags.iter().flat_map(|tag| &tag[*from..from + size]).filter(|i| !i.changed).count();
    let from = (0..=whole - size).step_by((size / 2).max(1)).max_by_key(held).unwrap_or(0);
    from + size / 2
}

/// A stretch at a period: the mean of the tags' best scores.
fn rated(part: &[&[Interval]; 2], period: f64) -> Candidate {
    let [op, pv] = part.map(|tag| best_phase(tag, period));
    // A tag that changes at every poll of this stretch says nothing of it.
    let score = match (op, pv) {
        (Some(op), Some(pv)) => 0.5 * (op.0 + pv.0),
        (Some(one), None) | (None, Some(one)) => one.0,
        (None, None) => 0.0,
    };
    Candidate { period, score, phases: [op, pv].map(|of| of.map_or(0.0, |of| of.1)) }
}

/// The largest score of a tag and its phase (s); `None` where it has nothing to say.
fn best_phase(tag: &[Interval], period: f64) -> Option<(f64, f64)> {
    let per = PLACES as f64 / period;
    // How often each place is entered less how often it is left, by intervals with and without a change.
    let mut turns = [[0.0_f64; PLACES + 1]; 2];
    let mut counts = [0.0_f64; 2];
    for interval in tag.iter().filter(|i| i.to - i.from < period) {
        let place = |t: f64| (t * per + 0.5).floor();
        let (from, to) = (place(interval.from), place(interval.to));
        let length = (to - from) as usize;
        let from = from.rem_euclid(PLACES as f64) as usize % PLACES;
        let kind = usize::from(!interval.changed);
        counts[kind] += 1.0;
        let turns = &mut turns[kind];
        let end = from + length.min(PLACES);
        turns[from] += 1.0;
        if end <= PLACES {
            turns[end] -= 1.0;
        } else {
            turns[0] += 1.0;
            turns[end - PLACES] -= 1.0;
        }
    }
    if counts[0] < 1.0 || counts[1] < 1.0 || counts[0] + counts[1] < SHORTER * tag.len() as f64 {
        return None;
    }
    let mut scores = [0.0_f64; PLACES];
    let (mut changed, mut held) = (0.0, 0.0);
    for (place, score) in scores.iter_mut().enumerate() {
        changed += turns[0][place];
        held += turns[1][place];
        *score = changed / counts[0] - held / counts[1];
    }
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // The middle of the places that are about as good, from the best on in both directions.
    let at = scores.iter().position(|score| *score == most).unwrap_or(0);
    let good = |i: isize| scores[(at as isize + i).rem_euclid(PLACES as isize) as usize] > most - 0.02;
    let after = (1..PLACES as isize).take_while(|i| good(*i)).count() as f64;
    let before = (1..PLACES as isize).take_while(|i| good(-i)).count() as f64;
    Some((most, (at as f64 + 0.5 * (after - before) + 0.5) / per))
}
