//! Whether PV follows a stem or OP itself: an encompassing regression, in which both are inputs.
//!
//! ```text
//! y[k] = c + sum a_i y[k-i] + sum b_i p[k-i] + sum d_i u[k-i] + w[k]
//! ```
//!
//! `p` is the stem of the one-parameter element, `u` is OP. The t value of `sum b_i` decides, with `u` in the equation and without:
//!
//! * **The valve sticks.** PV follows the stem, and OP beside it adds little: t is positive.
//! * **The valve is sound and a load jumps.** A stem predicts PV better than OP does here, too: it ignores the noise of OP and
//!   keeps the jumps. But PV also follows OP inside the dead band. So beside OP, t is negative, as if PV moved against the stem.
//! * **Loads hide the valve.** t is no larger than by chance, in both equations.
//!
//! Source: Davidson & MacKinnon, Econometrica 1981, 49, 781; Mizon & Richard, Econometrica 1986, 54, 657.

use super::ols::Ols;
use std::ops::Range;

/// Number of lags of PV.
const LAGS_Y: usize = 8;
/// One-sided 5 % point of the normal distribution.
const ONE_SIDED: f64 = 1.645;

/// The t values of the regression. They are positive where the gain from the stem to PV has the sign that makes feedback negative.
/// Where that sign is not known, it is the sign of `sum b_i` without OP in the equation.
#[derive(Clone, Copy, Debug)]
pub struct Response {
    /// t of `sum b_i` without OP in the equation (-).
    pub alone: f64,
    /// t of `sum b_i` with OP in the equation (-).
    pub beside: f64,
    /// t of `sum d_i`, of `u` beside the stem (-).
    pub other: f64,
}

impl Response {
    /// Whether PV follows the stem significantly, in either equation.
    pub fn is_seen(&self) -> bool {
        self.alone.max(self.beside) >= ONE_SIDED
    }

    /// Whether PV follows `u` significantly beside the stem.
    pub fn is_seen_of_other(&self) -> bool {
        self.other >= ONE_SIDED
    }

    /// Whether PV moves against the stem significantly, with OP in the equation.
    ///
    /// The regression is linear. A gain that depends on OP or PV may reverse the sign as well.
    pub fn is_reversed(&self) -> bool {
        self.beside < -ONE_SIDED
    }
}

/// The signals of the regression, one value a sample.
pub struct Encompassing<'a> {
    /// PV.
    pub y: &'a [f64],
    /// The input that competes with the stem: OP, or the part of the stem that a stop holds back (unit of OP).
    pub u: &'a [f64],
    /// The stem as it arrives at the process (unit of OP).
    pub p: &'a [f64],
    /// Further columns, such as loads, one value for each sample.
    pub extra: &'a [Vec<f64>],
    /// Lags of `u` and of the stem.
    pub lags: usize,
    /// Samples that are fitted; those before the longest lag are left out.
    pub rows: Range<usize>,
    /// Whether a sample counts.
    pub counts: &'a [bool],
    /// Sign of the process gain, +1 or -1, where it is known ([`super::gain_sign`]).
    pub gain_sign: Option<f64>,
}

impl Encompassing<'_> {
    /// The t values; `None` where there are no more samples than columns.
    pub fn response(&self) -> Option<Response> {
        let known = 1 + LAGS_Y + self.extra.len();
        let first = self.rows.start.max(LAGS_Y.max(self.lags));
        let rows: Vec<usize> = (first..self.rows.end).filter(|k| self.counts[*k]).collect();
        let column = |v: &[f64], lag: usize| -> Vec<f64> { rows.iter().map(|k| v[k - lag]).collect() };
        let lagged =
            |v: &[f64], lags: usize| -> Vec<Vec<f64>> { (1..=lags).map(|lag| column(v, lag)).collect() };
        let mut columns = vec![vec![1.0; rows.len()]];
        columns.extend(lagged(self.y, LAGS_Y));
        columns.extend(self.extra.iter().map(|extra| column(extra, 0)));
        columns.extend(lagged(self.p, self.lags));
        columns.extend(lagged(self.u, self.lags));
        let ols = Ols::new(&columns, &column(self.y, 0))?;
        let stem = known..known + self.lags;
        let other = stem.end..columns.len();
        let (without, beside) = (ols.t(stem.end, stem.clone()), ols.t(columns.len(), stem));
        let other = ols.t(columns.len(), other);
        let sign = self.gain_sign.unwrap_or_else(|| without.signum());
        Some(Response { alone: sign * without, beside: sign * beside, other: sign * other })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysid::valve::{Start, ValveModel};

    /// White noise of unit size without a library: sums of a linear congruential generator.
    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            let mut sum = 0.0;
            for _ in 0..12 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                sum += (state >> 11) as f64 / (1u64 << 53) as f64;
            }
            sum - 6.0
        }
    }

    /// A loop of a lag of ten samples and a PI controller; OP, PV.
    fn record(f: f64, load: impl Fn(usize) -> f64, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = noise(seed);
        let (mut u, mut y) = (Vec::new(), Vec::new());
        let (mut x, mut force, mut level, mut integral, mut last) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for k in 0..1500 {
            let pv: f64 = level + 0.1 * random();
            integral -= 0.08 * pv;
            let op: f64 = integral - 0.8 * pv;
            let moved: f64 = force + op - last;
            (x, force) = if moved.abs() > f { (op, moved.signum() * f) } else { (x, moved) };
            last = op;
            level += 0.1 * (x + load(k) - level);
            u.push(op);
            y.push(pv);
        }
        (u, y)
    }

    fn response(f: f64, (u, y): (Vec<f64>, Vec<f64>), rows: Range<usize>) -> Option<Response> {
        let (mut z, mut dir) = (Vec::new(), Vec::new());
        let start = Start { index: 0, is_max: true };
        ValveModel::one_parameter(f).run(&u, start, u.len(), &mut z, &mut dir);
        let counts = vec![true; u.len()];
        Encompassing { y: &y, u: &u, p: &z, extra: &[], lags: 10, rows, counts: &counts, gain_sign: None }
            .response()
    }

    #[test]
    fn pv_of_a_sticking_valve_follows_the_stem() {
        for seed in 1..6 {
            let found = response(0.5, record(0.5, |_| 2.0, seed), 60..1500).expect("long enough");
            assert!(found.is_seen() && found.beside > ONE_SIDED, "seed {seed}: {found:?}");
        }
    }

    #[test]
    fn pv_of_a_sound_valve_does_not_follow_a_stem_however_its_load_jumps() {
        let pump = |k: usize| if k % 310 < 120 { 4.0 } else { 0.0 };
        for seed in 1..6 {
            let found = response(0.4, record(0.0, pump, seed), 60..1500).expect("long enough");
            assert!(found.is_reversed(), "seed {seed}: {found:?}");
        }
    }

    #[test]
    fn a_valve_that_pv_does_not_depend_on_is_seldom_seen_to_be_followed() {
        let seen = |seed: &u64| {
            let ((u, _), (_, y)) = (record(0.5, |_| 2.0, *seed), record(0.0, |_| 0.0, seed + 100));
            response(0.5, (u, y), 60..1500).expect("long enough").is_seen()
        };
        // About 15 of 100 by chance, sd 3.6.
        let seen = (1..101).filter(seen).count();
        assert!(seen < 27, "{seen}");
    }

    #[test]
    fn a_record_that_is_too_short_says_nothing() {
        assert!(response(1.5, record(1.5, |_| 2.0, 1), 60..85).is_none());
    }
}
