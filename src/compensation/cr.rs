//! Constant reinforcement (Ivan & Lakshminarayanan 2009, eq 5).

use super::{Compensator, sign};

/// How a reinforcement behaves towards noise and how far and fast it may go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrSettings {
    /// OP has to turn back by more than this before the term changes its sign [%]; 2 to 3 times the sd of OP's
    /// noise from sample to sample. 0 is the paper's rule.
    pub dead_band: f64,
    /// OP counts as constant once it has not changed for longer than this (s). 0 is the paper's rule; a
    /// collector that polls faster than the controller executes needs the controller's period here.
    pub rest_s: f64,
    /// The term is never larger than this [%].
    pub size: f64,
    /// The term never changes faster than this [%/s]. Reinforcement works by crossing `2 f` between two samples:
    /// less than `2 f` a sample period gives part of that away. Infinite is the paper's rule.
    pub rate: f64,
}

impl Default for CrSettings {
    /// The paper's rule, with the term held to 5 %.
    fn default() -> Self {
        Self { dead_band: 0.0, rest_s: 0.0, size: 5.0, rate: f64::INFINITY }
    }
}

/// Why a reinforcement cannot be set up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CrError {
    /// A setting that makes no sense.
    #[error("constant reinforcement: {name} = {value} must be {must}")]
    Setting {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// f is not inside its own interval, or one of them is no number.
    #[error("constant reinforcement: f = {f} must lie inside its interval {low} to {high}, all from 0")]
    Interval {
        /// Friction [%].
        f: f64,
        /// Lower end [%].
        low: f64,
        /// Upper end [%].
        high: f64,
    },
}

/// What became of a new estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Followed {
    /// The amplitude is the new f, held within the interval the term was set up with.
    Yes,
    /// The new interval is apart from the one the term was set up with: the amplitude stays.
    Outside,
}

/// `R[k] = a sign(Δu)`, and 0 while u is constant.
///
/// u is OP [%], a = f [%] the friction (S/2). Adding `±f` makes every reversal of u one of more than `2 f = S` at the
/// valve, so that the stem answers each move of the controller instead of waiting for the integral.
///
/// Under noise `sign(Δu)` is a coin toss, and each toss moves the stem. Here the sign is that of u against a
/// reference: the last u that went further in the present direction, or turned back by more than the dead band.
/// In between the last sign is held: a term of 0 there would let the valve stick in every dead band.
///
/// The term is held to `size` and moves by at most `rate` times the time passed.
#[derive(Clone, Debug)]
pub struct ConstantReinforcement {
    settings: CrSettings,
    amplitude: f64,
    interval: [f64; 2],
    last: f64,
    reference: f64,
    direction: f64,
    still_s: f64,
    term: f64,
}

impl ConstantReinforcement {
    /// A reinforcement at rest, its amplitude `f` [%], which later may move within `interval` [%] only.
    ///
    /// # Errors
    /// [`CrError`] where a setting makes no sense or f is not inside its interval.
    pub fn new(f: f64, interval: [f64; 2], settings: CrSettings) -> Result<Self, CrError> {
        let [low, high] = interval;
        if !(0.0 <= low && low <= f && f <= high && high.is_finite()) {
            return Err(CrError::Interval { f, low, high });
        }
        let at_least_0 =
            [("dead_band", settings.dead_band), ("rest_s", settings.rest_s), ("size", settings.size)];
        for (name, value) in at_least_0 {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(CrError::Setting { name, value, must: "a finite number from 0" });
            }
        }
        // Not `rate <= 0.0`: NaN must be refused too.
        if settings.rate.is_nan() || settings.rate <= 0.0 {
            return Err(CrError::Setting { name: "rate", value: settings.rate, must: "above 0" });
        }
        Ok(Self {
            settings,
            amplitude: f,
            interval,
            last: f64::NAN,
            reference: f64::NAN,
            direction: 0.0,
            still_s: 0.0,
            term: 0.0,
        })
    }

    /// Takes a later estimate of f [%] with its own interval [%] as the amplitude, held within the interval the term was set up
    /// with. Two intervals that have no value in common say that the valve is another one than was granted. f alone does not
    /// say so: of two estimates of one valve, each as uncertain as the other, the second leaves the interval of the first
    /// more often than the interval says.
    pub fn follow(&mut self, f: f64, ci95: [f64; 2]) -> Followed {
        let ([low, high], [from, to]) = (self.interval, ci95);
        // What is no number is no estimate of this valve.
        if f.is_finite() && from <= high && low <= to {
            self.amplitude = f.clamp(low, high);
            Followed::Yes
        } else {
            Followed::Outside
        }
    }

    /// The amplitude a [%], before the clamp.
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// The term as last given [%].
    pub fn term(&self) -> f64 {
        self.term
    }

    /// The term on its way to 0 [%], whatever OP does; what OP did so far is forgotten.
    pub fn withdraw(&mut self, dt_s: f64) -> f64 {
        self.last = f64::NAN;
        self.reference = f64::NAN;
        self.direction = 0.0;
        self.approach(0.0, dt_s)
    }

    fn sense(&mut self, op: f64, dt_s: f64) {
        if !self.last.is_finite() {
            self.reference = op;
        }
        self.still_s = if op == self.last { self.still_s + dt_s } else { 0.0 };
        self.last = op;
        if self.still_s > self.settings.rest_s {
            // After a rest noise alone must not bring the old direction back.
            self.direction = 0.0;
            self.reference = op;
        }
        let moved = op - self.reference;
        if moved.abs() > self.settings.dead_band || moved * self.direction > 0.0 {
            self.direction = sign(moved);
            self.reference = op;
        }
    }

    fn approach(&mut self, target: f64, dt_s: f64) -> f64 {
        let size = self.settings.size;
        // No time, no change: an infinite rate times 0 would be no number.
        let reach = if dt_s > 0.0 { self.settings.rate * dt_s } else { 0.0 };
        self.term = target.clamp(-size, size).max(self.term - reach).min(self.term + reach);
        self.term
    }
}

impl Compensator for ConstantReinforcement {
    /// A value that is no number says nothing of OP's direction: the term goes towards 0.
    fn step(&mut self, op: f64, dt_s: f64) -> f64 {
        if !op.is_finite() {
            return self.withdraw(dt_s);
        }
        self.sense(op, dt_s.max(0.0));
        self.approach(self.amplitude * self.direction, dt_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn terms(settings: CrSettings, ops: &[f64]) -> Vec<f64> {
        let mut cr = ConstantReinforcement::new(2.0, [1.5, 2.5], settings).expect("valid");
        ops.iter().map(|&op| cr.step(op, 1.0)).collect()
    }

    #[test]
    fn the_papers_rule_by_hand() {
        let ops = [50.0, 50.1, 50.3, 50.3, 50.2, 50.2, 50.4];
        assert_eq!(terms(CrSettings::default(), &ops), [0.0, 2.0, 2.0, 0.0, -2.0, 0.0, 2.0]);
    }

    #[test]
    fn within_the_dead_band_the_sign_is_held() {
        let settings = CrSettings { dead_band: 0.5, ..CrSettings::default() };
        // Up by 0.6; back by 0.4 holds; 0.1 above the highest moves the reference; 0.6 below it turns.
        let ops = [50.0, 50.6, 50.2, 50.7, 50.3, 50.1, 50.4];
        assert_eq!(terms(settings, &ops), [0.0, 2.0, 2.0, 2.0, 2.0, -2.0, -2.0]);
    }

    #[test]
    fn a_drift_slower_than_the_dead_band_is_still_reinforced() {
        let settings = CrSettings { dead_band: 0.5, ..CrSettings::default() };
        let ops: Vec<f64> = (0..12).map(|k| 50.0 + 0.1 * f64::from(k)).collect();
        let terms = terms(settings, &ops);
        // 0.6 from the start is the first beyond the band; each further sample goes on in that direction.
        assert_eq!(terms[..6], [0.0; 6]);
        assert_eq!(terms[6..], [2.0; 6]);
    }

    #[test]
    fn repeated_readings_rest_only_after_the_rest_time() {
        let settings = CrSettings { rest_s: 2.0, ..CrSettings::default() };
        let ops = [50.0, 51.0, 51.0, 51.0, 51.0, 51.0];
        assert_eq!(terms(settings, &ops), [0.0, 2.0, 2.0, 2.0, 0.0, 0.0]);
    }

    #[test]
    fn size_and_rate_hold_the_term() {
        let settings = CrSettings { size: 1.5, rate: 1.0, ..CrSettings::default() };
        let ops = [50.0, 51.0, 52.0, 53.0, 52.0, 51.0];
        assert_eq!(terms(settings, &ops), [0.0, 1.0, 1.5, 1.5, 0.5, -0.5]);
        let mut cr = ConstantReinforcement::new(2.0, [1.5, 2.5], settings).expect("valid");
        cr.step(50.0, 1.0);
        assert_eq!(cr.step(51.0, 0.0), 0.0);
    }

    #[test]
    fn the_amplitude_follows_inside_the_interval_only() {
        let mut cr = ConstantReinforcement::new(2.0, [1.5, 2.5], CrSettings::default()).expect("valid");
        assert_eq!((cr.follow(2.4, [2.3, 2.5]), cr.amplitude()), (Followed::Yes, 2.4));
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        for apart in [[1.4, 1.49], [2.51, 2.6], [-2.1, -1.9], [nan, 2.5], [1.5, nan], [inf, inf]] {
            assert_eq!((cr.follow(apart[0], apart), cr.amplitude()), (Followed::Outside, 2.4), "{apart:?}");
        }
        assert_eq!((cr.follow(nan, [1.5, 2.5]), cr.amplitude()), (Followed::Outside, 2.4));
    }

    #[test]
    fn an_uncertain_estimate_beyond_the_interval_moves_the_amplitude_to_its_end() {
        let mut cr = ConstantReinforcement::new(2.0, [1.5, 2.5], CrSettings::default()).expect("valid");
        assert_eq!((cr.follow(2.9, [2.4, 3.4]), cr.amplitude()), (Followed::Yes, 2.5));
        assert_eq!((cr.follow(1.2, [0.9, 1.5]), cr.amplitude()), (Followed::Yes, 1.5));
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() {
        let new = |f, interval, settings| ConstantReinforcement::new(f, interval, settings).map(|_| ());
        for (f, interval) in [(f64::NAN, [0.0, 1.0]), (2.0, [0.0, 1.0]), (1.0, [-1.0, 2.0])] {
            assert!(matches!(new(f, interval, CrSettings::default()), Err(CrError::Interval { .. })));
        }
        let default = CrSettings::default();
        for (settings, field) in [
            (CrSettings { dead_band: -0.1, ..default }, "dead_band"),
            (CrSettings { rest_s: f64::NAN, ..default }, "rest_s"),
            (CrSettings { size: f64::INFINITY, ..default }, "size"),
            (CrSettings { rate: 0.0, ..default }, "rate"),
        ] {
            assert!(
                matches!(new(1.0, [0.5, 2.0], settings), Err(CrError::Setting { name, .. }) if name == field)
            );
        }
    }

    #[test]
    fn a_bad_value_withdraws_and_noise_after_it_brings_nothing_back() {
        let settings = CrSettings { dead_band: 0.5, rate: 1.5, ..CrSettings::default() };
        let ops = [50.0, 51.0, 52.0, f64::NAN, f64::NAN, 52.3, 52.1];
        assert_eq!(terms(settings, &ops), [0.0, 1.5, 2.0, 0.5, 0.0, 0.0, 0.0]);
    }

    fn any_op() -> impl Strategy<Value = f64> {
        prop_oneof![
            8 => 0.0..100.0f64,
            2 => Just(50.0),
            1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::MIN)],
        ]
    }

    proptest! {
        #[test]
        fn never_beyond_size_or_rate(
            steps in prop::collection::vec((any_op(), -1.0..20.0f64), 1..200),
            f in 0.0..10.0f64, size in 0.0..10.0f64, rate in 0.01..5.0f64, dead_band in 0.0..2.0f64,
        ) {
            let settings = CrSettings { dead_band, size, rate, rest_s: 1.0 };
            let mut cr = ConstantReinforcement::new(f, [f, f], settings).expect("valid");
            let mut before = 0.0;
            for (op, dt_s) in steps {
                let term = cr.step(op, dt_s);
                prop_assert!(term.abs() <= size.min(f));
                // 1e-12: one rounding of a sum of order 100.
                prop_assert!((term - before).abs() <= rate * dt_s.max(0.0) + 1e-12);
                before = term;
            }
        }

        #[test]
        fn a_constant_op_ends_at_zero(
            ops in prop::collection::vec(any_op(), 1..50), rest in any_op(), rate in 0.1..5.0f64,
        ) {
            let settings = CrSettings { rate, rest_s: 3.0, ..CrSettings::default() };
            let mut cr = ConstantReinforcement::new(4.0, [3.0, 5.0], settings).expect("valid");
            for op in ops {
                cr.step(op, 1.0);
            }
            // 3 s to rest, the sample that may bring a new value, and the way from ±4 at the rate.
            let samples = 5 + (8.0 / rate).ceil() as usize;
            let term = (0..samples).fold(f64::NAN, |_, _| cr.step(rest, 1.0));
            prop_assert_eq!(term, 0.0);
        }

        #[test]
        fn without_clamps_it_is_a_sign_du(ops in prop::collection::vec(0u8..6, 2..100)) {
            let settings = CrSettings { size: 100.0, ..CrSettings::default() };
            let mut cr = ConstantReinforcement::new(2.0, [2.0, 2.0], settings).expect("valid");
            let mut last = None;
            for op in ops.into_iter().map(f64::from) {
                let want = last.map_or(0.0, |last: f64| 2.0 * sign(op - last));
                prop_assert_eq!(cr.step(op, 1.0), want);
                last = Some(op);
            }
        }
    }
}
