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
/// Step of the periods tried, in periods over the stretch that is looked at.
const STEP: f64 = 0.04;
/// Intervals of the first look, how many more each further one has, and candidates that go on to it.
const FIRST: usize = 200;
const FURTHER: usize = 3;
const KEPT: usize = 6;

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
    let mut size = FIRST.min(whole);
    let mut step = STEP * least * least / span(&tags[1][..size.min(tags[1].len())]).max(least);
    let count = ((most - least) / step).ceil().min(20_000.0) as usize;
    let mut best: Vec<Candidate> = (0..=count)
        .map(|i| rated(&tags, size, least + (most - least) * i as f64 / count.max(1) as f64))
        .collect();
    loop {
        best.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut apart: Vec<Candidate> = Vec::with_capacity(KEPT);
        for candidate in best {
            if apart.len() < KEPT
                && apart.iter().all(|other| (other.period - candidate.period).abs() > 3.0 * step)
            {
                apart.push(candidate);
            }
        }
        best = apart;
        if size == whole {
            break;
        }
        let before = step;
        size = (size * FURTHER).min(whole);
        step = STEP * least * least / span(&tags[1][..size]).max(least);
        let reach = (2.0 * before / step).ceil().max(1.0) as i64;
        best = best
            .iter()
            .flat_map(|near| (-reach..=reach).map(|i| near.period + i as f64 * step))
            .map(|period| rated(&tags, size, period))
            .collect();
    }
    let found = best.first().filter(|found| found.score > BELIEVED)?;
    // A value that is newer at every poll is not held: its polls are its samples.
    let expected = (1.0 - polled.period / found.period).max(0.0);
    let held = |tag: &[Interval]| {
        tag.iter().filter(|i| !i.changed).count() as f64 >= HELD * expected * tag.len() as f64
    };
    if !tags.iter().all(|tag| held(tag)) {
        return None;
    }
    let [of_op, mut of_pv] = found.phases;
    // The nearer of PV's scans belongs to OP's.
    of_pv -= ((of_pv - of_op) / found.period).round() * found.period;
    Some(Scan { period: found.period, phases: [t0 + of_op, t0 + of_pv] })
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

/// The first `size` intervals at a period: the mean of both tags' best scores.
fn rated(tags: &[Vec<Interval>; 2], size: usize, period: f64) -> Candidate {
    let of = |tag: &Vec<Interval>| best_phase(&tag[..size.min(tag.len())], period);
    let [(a, of_op), (b, of_pv)] = [of(&tags[0]), of(&tags[1])];
    Candidate { period, score: 0.5 * (a + b), phases: [of_op, of_pv] }
}

/// The largest score of a tag and its phase (s).
fn best_phase(tag: &[Interval], period: f64) -> (f64, f64) {
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
    if counts[0] < 1.0 || counts[1] < 1.0 {
        return (0.0, 0.0);
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
    (most, (at as f64 + 0.5 * (after - before) + 0.5) / per)
}
