//! The period and the phase of the controller's scans, from the times at which held values change.
//!
//! Between two polls with different values there was a scan. Between two polls with the same value there was most likely none.
//! So on a circle of one period T the intervals with a change cover the phase of the scan, and those without do not:
//!
//! ```text
//! score(T, phase) = share of the intervals with a change that cover the phase - share of those without a change that do
//! ```
//!
//! The score is 1 at the true period and phase, and about 0 at others. OP and PV have one period and may have different phases,
//! because PV may be read later. The period is searched on a short part of the record first, then on longer parts around the best.

use super::lattice::Lattice;
use crate::signal::Sample;

/// Number of places on the circle of one period.
const PLACES: usize = 60;
/// Least score of scans that are believed: a value that repeats itself by chance in every fifth scan has about this score.
const BELIEVED: f64 = 0.75;
/// Fewest intervals without a change that a tag must have.
const LEAST_HELD: usize = 12;
/// Least number of intervals without a change, as a share of the number that the period lets expect.
const HELD: f64 = 0.6;
/// Shortest period that is tried, in periods of the polls, and longest one, in mean times between changes.
const PERIODS: [f64; 2] = [0.85, 1.15];
/// Least share of a tag's intervals that are shorter than a period: longer ones say nothing of it.
const SHORTER: f64 = 0.3;
/// Step of the periods that are tried, as a share of T²/L: T the shortest period, L the length of the part.
const STEP: f64 = 0.08;
/// By how much the scan of PV may lie further before that of OP than after it (share of the period).
const EARLIER: f64 = 0.15;
/// Number of intervals of the first, shortest part.
const FIRST: usize = 120;
/// Factor by which each further part is longer.
const FURTHER: usize = 3;
/// Number of candidates that go on to it.
const KEPT: usize = 6;
/// Most periods that are tried on the first part.
const MOST_PERIODS: f64 = 20_000.0;
/// Distance below the best score up to which a score is taken for as good.
const LEVEL: f64 = 0.04;
/// The same where the part is the whole record.
const SHARP: f64 = 0.004;
/// Number of periods that are tried to each side at the end, with twice as many phases, and their steps as shares of those before.
const SHARPER: (i32, f64) = (10, 0.1);

/// The controller's scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan {
    /// Their period (s).
    pub period: f64,
    /// A time at which OP becomes new, and one at which PV does, by the stamps of the polls (s). PV's is earlier where PV is read
    /// later.
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

/// A run of neighbouring periods that are about as good, because a short part does not determine the period.
#[derive(Clone, Copy, Debug)]
struct Plateau {
    /// The period in its middle.
    best: Candidate,
    /// Largest distance of the true period from the middle (s).
    reach: f64,
}

/// The controller's scans; `None` where the values are not held between scans, or the polls are too slow to show it.
///
/// * `polled`: the period of the polls.
pub fn recognise(op: &[Sample], pv: &[Sample], polled: &Lattice) -> Option<Scan> {
    let t0 = polled.t0;
    let tags = [intervals(op, t0), intervals(pv, t0)];
    let longest = tags.iter().map(|tag| between_changes(tag)).fold(f64::INFINITY, f64::min);
    if tags.iter().any(|tag| tag.iter().filter(|i| !i.changed).count() < LEAST_HELD) || !longest.is_finite() {
        return None;
    }
    let found = best_period(&tags, [PERIODS[0] * polled.period, PERIODS[1] * longest.max(polled.period)])?;
    // A value that is new at every poll is not held: each poll is a sample then.
    let expected = (1.0 - polled.period / found.period).max(0.0);
    let held = |tag: &[Interval]| {
        tag.iter().filter(|i| !i.changed).count() as f64 >= HELD * expected * tag.len() as f64
    };
    if !tags.iter().all(|tag| held(tag)) {
        return None;
    }
    let found = sharpened(&tags, found);
    let [of_op, mut of_pv] = found.phases;
    // PV's scan is the one that is nearest to OP's. Of two about as near it is the earlier one, because a PV that is read late
    // shows its scan early.
    of_pv -= ((of_pv - of_op) / found.period + EARLIER).round() * found.period;
    Some(Scan { period: found.period, phases: [t0 + of_op, t0 + of_pv] })
}

/// The period between `least` and `most` (s) with the best score, from a short part of the record to the whole of it.
///
/// `None` where no score is above [`BELIEVED`].
fn best_period(tags: &[Vec<Interval>; 2], [least, most]: [f64; 2]) -> Option<Candidate> {
    let whole = tags[0].len().min(tags[1].len());
    let middle = most_held(tags, whole);
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
        // The true period fits every part of the record.
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
    best.first().map(|plateau| plateau.best).filter(|found| found.score > BELIEVED)
}

/// The period and the phases on a finer grid, so that a poll next to a scan lies on the right side of it in all of the record.
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

/// The middle of the first run of entries with the largest score.
fn middle<T: Copy>(tried: &[(f64, T)]) -> (f64, T) {
    let most = tried.iter().map(|one| one.0).fold(f64::NEG_INFINITY, f64::max);
    let first = tried.iter().position(|one| one.0 == most).unwrap_or(0);
    let run = tried[first..].iter().take_while(|one| one.0 == most).count();
    tried[first + run / 2]
}

/// The score of one tag at a period and a phase (s).
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

/// The best runs of neighbouring periods; the periods come in increasing order, `step` apart.
///
/// * `level`: distance below the best score up to which a period is as good.
fn plateaus(tried: Vec<Candidate>, step: f64, level: f64) -> Vec<Plateau> {
    let most = tried.iter().map(|candidate| candidate.score).fold(f64::NEG_INFINITY, f64::max);
    // A few more intervals would not rule out a period whose score is nearly the best.
    let good = |candidate: &Candidate| candidate.score > most - level;
    let runs = tried.chunk_by(|a, b| good(a) == good(b)).filter(|run| good(&run[0]));
    let mut found: Vec<Plateau> = runs
        .map(|run| Plateau { best: run[run.len() / 2], reach: (0.5 * run.len() as f64 + 1.5) * step })
        .collect();
    keep_best(&mut found);
    found
}

/// Keeps the plateaus that go on, the best first.
fn keep_best(found: &mut Vec<Plateau>) {
    found.sort_by(|a, b| b.best.score.total_cmp(&a.best.score));
    found.truncate(KEPT);
}

/// The intervals between the samples of a tag; times are counted from `t0` (s).
fn intervals(series: &[Sample], t0: f64) -> Vec<Interval> {
    let interval =
        |w: &[Sample]| Interval { from: w[0].t - t0, to: w[1].t - t0, changed: w[1].value != w[0].value };
    series.windows(2).map(interval).collect()
}

/// The mean time between changes of value, without holes (s).
fn between_changes(tag: &[Interval]) -> f64 {
    let short = 3.0 * crate::sysid::stats::median(&tag.iter().map(|i| i.to - i.from).collect::<Vec<f64>>());
    let near = || tag.iter().filter(|i| i.to - i.from < short);
    near().map(|i| i.to - i.from).sum::<f64>() / near().filter(|i| i.changed).count() as f64
}

/// The length of a part (s).
fn span(tag: &[Interval]) -> f64 {
    tag.last().map_or(0.0, |last| last.to) - tag.first().map_or(0.0, |first| first.from)
}

/// The middle of the part with the most intervals without a change: there the scans show best.
fn most_held(tags: &[Vec<Interval>; 2], whole: usize) -> usize {
    let size = FIRST.min(whole);
    let held =
        |from: &usize| tags.iter().flat_map(|tag| &tag[*from..from + size]).filter(|i| !i.changed).count();
    let from = (0..=whole - size).step_by((size / 2).max(1)).max_by_key(held).unwrap_or(0);
    from + size / 2
}

/// A period with its score on a part: the mean of the best scores of OP and PV.
fn rated(part: &[&[Interval]; 2], period: f64) -> Candidate {
    let [op, pv] = part.map(|tag| best_phase(tag, period));
    // A tag that changes at every poll of this part says nothing of the period.
    let score = match (op, pv) {
        (Some(op), Some(pv)) => 0.5 * (op.0 + pv.0),
        (Some(one), None) | (None, Some(one)) => one.0,
        (None, None) => 0.0,
    };
    Candidate { period, score, phases: [op, pv].map(|of| of.map_or(0.0, |of| of.1)) }
}

/// The largest score of a tag at a period, and its phase (s); `None` where too few intervals are shorter than the period.
///
/// The intervals that cover each place of the circle are counted by their ends (a prefix sum).
fn best_phase(tag: &[Interval], period: f64) -> Option<(f64, f64)> {
    let per = PLACES as f64 / period;
    // For each place: intervals that begin there less those that end there, with a change and without.
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
    // The middle of the places about as good as the best, to both sides of it.
    let at = scores.iter().position(|score| *score == most).unwrap_or(0);
    let good = |i: isize| scores[(at as isize + i).rem_euclid(PLACES as isize) as usize] > most - 0.02;
    let after = (1..PLACES as isize).take_while(|i| good(*i)).count() as f64;
    let before = (1..PLACES as isize).take_while(|i| good(-i)).count() as f64;
    Some((most, (at as f64 + 0.5 * (after - before) + 0.5) / per))
}
