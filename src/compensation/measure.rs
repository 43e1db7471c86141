//! What a reinforcement does to its loop, from measurements: the same numbers over the same length before and with it.

use std::collections::VecDeque;

/// Most points kept of the time before.
pub const MAX_POINTS: usize = 20_000;

/// Points of a stretch that come closer than this (s) are left out, so that the whole of it fits into memory however often the
/// loop is polled. They are left out of the time before and with the term alike: travel counts for more in smaller steps.
fn apart_s(length_s: f64) -> f64 {
    // A stretch keeps one point before its beginning and one at either end.
    length_s / (MAX_POINTS - 2) as f64
}

/// One moment of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// When (s).
    pub t: f64,
    /// Process variable (PV unit).
    pub pv: f64,
    /// Set point (PV unit).
    pub sp: f64,
    /// What the valve was told: OP plus the term in force [%].
    pub input: f64,
    /// Measured stem position [%], where there is one.
    pub mv: Option<f64>,
}

/// What is measured over one stretch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Length T (s).
    pub length_s: f64,
    /// Points.
    pub n: usize,
    /// ∫ (SP − PV)² dt (PV unit² s).
    pub ise: f64,
    /// ∫ |SP − PV| dt (PV unit s).
    pub iae: f64,
    /// Standard deviation of PV (PV unit).
    pub pv_sd: f64,
    /// Way of the stem Σ|ΔMV| [%].
    pub travel: f64,
    /// Turns of the stem by more than the band.
    pub reversals: u64,
    /// True when the stem was measured; else it is what a valve with dead band 2 f makes of its input.
    pub stem_measured: bool,
}

/// Adds up one stretch.
#[derive(Clone, Debug)]
pub struct Meter {
    f: f64,
    band: f64,
    sum: Measured,
    mean: f64,
    squares: f64,
    last: Option<(f64, f64)>,
    /// The last turning point or furthest position, and the direction since.
    turn: (f64, f64),
}

impl Meter {
    /// Begins a stretch on a valve with friction `f` [%]; a turn counts from `band` [%].
    pub fn new(f: f64, band: f64) -> Self {
        let sum = Measured { stem_measured: true, ..Measured::default() };
        Self { f, band, sum, mean: 0.0, squares: 0.0, last: None, turn: (f64::NAN, 0.0) }
    }

    /// Goes on to a point; one that is not later than the last, or no number, is left out.
    pub fn push(&mut self, point: &Point) {
        let numbers = [point.t, point.pv, point.sp, point.input];
        let dt = self.last.map_or(0.0, |(t, _)| point.t - t);
        if numbers.iter().any(|v| !v.is_finite()) || dt < 0.0 || (dt == 0.0 && self.last.is_some()) {
            return;
        }
        self.sum.stem_measured &= point.mv.is_some();
        let stem = match (point.mv, self.last) {
            (Some(mv), _) => mv,
            (None, None) => point.input,
            (None, Some((_, stem))) => stem.max(point.input - self.f).min(point.input + self.f),
        };
        let error = point.sp - point.pv;
        self.sum.length_s += dt;
        self.sum.ise += error * error * dt;
        self.sum.iae += error.abs() * dt;
        self.sum.travel += self.last.map_or(0.0, |(_, before)| (stem - before).abs());
        self.turn_at(stem);
        // Welford: PV far from 0 loses no digits.
        self.sum.n += 1;
        let off = point.pv - self.mean;
        self.mean += off / self.sum.n as f64;
        self.squares += off * (point.pv - self.mean);
        self.last = Some((point.t, stem));
    }

    fn turn_at(&mut self, stem: f64) {
        let (furthest, direction) = self.turn;
        if furthest.is_nan() {
            self.turn.0 = stem;
            return;
        }
        let moved = stem - furthest;
        if moved * direction > 0.0 {
            self.turn.0 = stem;
        } else if moved.abs() > self.band {
            self.sum.reversals += u64::from(direction != 0.0);
            self.turn = (stem, moved.signum());
        }
    }

    /// What was measured so far.
    pub fn measured(&self) -> Measured {
        let n = self.sum.n.max(1) as f64;
        Measured { pv_sd: (self.squares / n).max(0.0).sqrt(), ..self.sum }
    }
}

/// The last `length_s` of the loop, in bounded memory.
#[derive(Clone, Debug)]
pub struct Baseline {
    length_s: f64,
    max_gap_s: f64,
    points: VecDeque<Point>,
    /// When the last point was, kept or left out (s).
    seen: Option<f64>,
}

impl Baseline {
    /// Remembers `length_s`; a pause longer than `max_gap_s`, or a clock set back, begins anew.
    pub fn new(length_s: f64, max_gap_s: f64) -> Self {
        Self { length_s, max_gap_s, points: VecDeque::new(), seen: None }
    }

    /// Goes on to a point.
    pub fn push(&mut self, point: Point) {
        if let Some(seen) = self.seen.replace(point.t) {
            if point.t == seen {
                return;
            }
            if !(point.t > seen && point.t - seen <= self.max_gap_s) {
                self.points.clear();
            }
        }
        if self.points.back().is_some_and(|last| point.t - last.t < apart_s(self.length_s)) {
            return;
        }
        self.points.push_back(point);
        // One point at or before the beginning of the stretch is kept, so that its whole length is there.
        while self.points.len() > MAX_POINTS
            || self.points.get(1).is_some_and(|second| point.t - second.t >= self.length_s)
        {
            self.points.pop_front();
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.points.clear();
        self.seen = None;
    }

    /// How much of the length is there (s).
    pub fn have_s(&self) -> f64 {
        match (self.points.front(), self.points.back()) {
            (Some(first), Some(last)) => last.t - first.t,
            _ => 0.0,
        }
    }

    /// The stretch on a valve with friction `f`, once it has its whole length.
    pub fn measured(&self, f: f64, band: f64) -> Option<Measured> {
        if self.have_s() < self.length_s {
            return None;
        }
        let mut meter = Meter::new(f, band);
        self.points.iter().for_each(|point| meter.push(point));
        Some(meter.measured())
    }
}

/// What decides whether a reinforcement may stay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Criteria {
    /// Length measured before and with it (s).
    pub length_s: f64,
    /// Time within which it must have shown the gain (s), from `length_s`.
    pub prove_s: f64,
    /// ISE before over ISE with it must reach this (-), above 1.
    pub ise_gain: f64,
    /// ISE with it over ISE before must never exceed this (-).
    pub ise_limit: f64,
    /// Travel with it over travel before must never exceed this (-).
    pub travel_limit: f64,
    /// A turn of the stem counts from this [%].
    pub reversal_band: f64,
}

/// Why a trial has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// More ISE than allowed.
    Ise,
    /// More travel than allowed.
    Travel,
    /// Not the gain that was asked for, in time.
    NoGain,
}

/// A reinforcement on trial.
#[derive(Clone, Debug)]
pub struct Trial {
    criteria: Criteria,
    f: f64,
    before: Measured,
    with: Option<Measured>,
    meter: Meter,
    began: Option<f64>,
    proven: bool,
}

impl Trial {
    /// Begins, against what was measured before.
    pub fn new(before: Measured, f: f64, criteria: Criteria) -> Self {
        let meter = Meter::new(f, criteria.reversal_band);
        Self { criteria, f, before, with: None, meter, began: None, proven: false }
    }

    /// Before.
    pub fn before(&self) -> Measured {
        self.before
    }

    /// The latest whole stretch with it.
    pub fn with(&self) -> Option<Measured> {
        self.with
    }

    /// The stretch under way.
    pub fn running(&self) -> Measured {
        self.meter.measured()
    }

    /// Whether a whole stretch has shown the gain.
    pub fn proven(&self) -> bool {
        self.proven
    }

    /// Goes on to a point and judges. ISE and travel only grow within a stretch, so too much of them is known before
    /// the stretch is over.
    pub fn push(&mut self, point: &Point) -> Option<Failure> {
        let criteria = self.criteria;
        let since = self.meter.last.map(|(t, _)| point.t - t);
        if since.is_some_and(|since| (0.0..apart_s(criteria.length_s)).contains(&since)) {
            return None;
        }
        let began = *self.began.get_or_insert(point.t);
        self.meter.push(point);
        let now = self.meter.measured();
        if now.ise > criteria.ise_limit * self.before.ise {
            return Some(Failure::Ise);
        }
        if now.travel > criteria.travel_limit * self.before.travel {
            return Some(Failure::Travel);
        }
        if now.length_s >= criteria.length_s {
            self.proven |= now.ise * criteria.ise_gain <= self.before.ise;
            self.with = Some(now);
            self.meter = Meter::new(self.f, criteria.reversal_band);
            self.meter.push(point);
        }
        let late = point.t - began >= criteria.prove_s;
        (late && !self.proven).then_some(Failure::NoGain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(t: f64, pv: f64, input: f64) -> Point {
        Point { t, pv, sp: 50.0, input, mv: None }
    }

    const CRITERIA: Criteria = Criteria {
        length_s: 10.0,
        prove_s: 15.0,
        ise_gain: 2.0,
        ise_limit: 1.5,
        travel_limit: 3.0,
        reversal_band: 0.1,
    };

    #[test]
    fn a_stretch_by_hand() {
        let mut meter = Meter::new(1.0, 0.1);
        // Errors 0, 2, -1 at 0, 1, 3 s; the input 50, 54, 49 carries a stem with dead band 2 to 50, 53, 50.
        for (t, pv, input) in [(0.0, 50.0, 50.0), (1.0, 48.0, 54.0), (3.0, 51.0, 49.0)] {
            meter.push(&point(t, pv, input));
        }
        let got = meter.measured();
        assert_eq!((got.length_s, got.n, got.ise, got.iae), (3.0, 3, 6.0, 4.0));
        assert_eq!((got.travel, got.reversals, got.stem_measured), (6.0, 1, false));
        // Mean 149/3, squares 1/9 + 25/9 + 16/9; 1e-12 for roundings of numbers of order 50.
        assert!((got.pv_sd - (42.0f64 / 27.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_measured_stem_is_believed_and_small_turns_are_noise() {
        let mut meter = Meter::new(1.0, 0.5);
        for (t, mv) in [(0.0, 50.0), (1.0, 51.0), (2.0, 50.8), (3.0, 52.0), (4.0, 51.0)] {
            meter.push(&Point { mv: Some(mv), ..point(t, 50.0, 0.0) });
        }
        let got = meter.measured();
        // 1 + 0.2 + 1.2 + 1, within a rounding.
        assert!(got.stem_measured && (got.travel - 3.4).abs() < 1e-12);
        assert_eq!(got.reversals, 1);
    }

    #[test]
    fn the_time_before_is_whole_bounded_and_begins_anew_after_a_gap() {
        let mut before = Baseline::new(10.0, 3.0);
        for k in 0..10 {
            before.push(point(f64::from(k), 50.0, 50.0));
        }
        assert_eq!((before.have_s(), before.measured(1.0, 0.1)), (9.0, None));
        (10..100).for_each(|k| before.push(point(f64::from(k), 50.0, 50.0)));
        assert_eq!(before.measured(1.0, 0.1).map(|m| (m.length_s, m.n)), Some((10.0, 11)));
        before.push(point(103.5, 50.0, 50.0));
        assert_eq!(before.have_s(), 0.0);
        before.push(point(3.0, 50.0, 50.0));
        assert_eq!(before.points.len(), 1, "a clock set back");
        (0..3 * MAX_POINTS).for_each(|k| before.push(point(4.0 + 1e-5 * k as f64, 50.0, 50.0)));
        assert!(before.points.len() <= MAX_POINTS);
    }

    /// A PV every 0.25 ms brings 40,000 points within the 10 s: twice of what is kept.
    #[test]
    fn a_loop_that_is_polled_too_fast_to_be_kept_is_measured_in_the_same_steps_before_and_with_the_term() {
        let mut before = Baseline::new(10.0, 3.0);
        let mut with = Trial::new(Measured { ise: 40.0, travel: 10.0, ..Measured::default() }, 0.0, CRITERIA);
        for k in 0..50_000 {
            let point = point(2.5e-4 * f64::from(k), 51.0, 50.0);
            before.push(point);
            assert_eq!(with.push(&point), None);
        }
        assert!(before.points.len() <= MAX_POINTS);
        let before = before.measured(0.0, 0.1).expect("the whole length is there");
        let with = with.with().expect("a whole stretch");
        // Every third is far enough from the last: 7.5e-4 s, and 10 s need 13,335 of them; one more by a rounding.
        assert!(before.n.abs_diff(13_335) <= 1 && with.n.abs_diff(13_335) <= 1, "{} {}", before.n, with.n);
    }

    fn trial(error: f64, step: f64) -> (Option<Failure>, Trial) {
        let before = Measured { ise: 40.0, travel: 10.0, length_s: 10.0, ..Measured::default() };
        let mut trial = Trial::new(before, 0.0, CRITERIA);
        let mut failed = None;
        for k in 0..40 {
            let input = 50.0 + if k % 2 == 0 { 0.0 } else { step };
            failed = failed.or(trial.push(&point(f64::from(k), 50.0 + error, input)));
        }
        (failed, trial)
    }

    #[test]
    fn a_trial_by_hand() {
        // ISE 10 of 40, no travel: good, and each stretch is published.
        let (failed, good) = trial(1.0, 0.0);
        assert_eq!((failed, good.proven(), good.with().map(|m| m.ise)), (None, true, Some(10.0)));
        // 30 of 40 is no gain of 2; 9 s² a second pass 60 within the first stretch; 4 % of travel a second pass 30 too.
        assert_eq!(trial(3.0f64.sqrt(), 0.0).0, Some(Failure::NoGain));
        assert_eq!(trial(3.0, 0.0).0, Some(Failure::Ise));
        assert_eq!(trial(1.0, 4.0).0, Some(Failure::Travel));
    }
}
