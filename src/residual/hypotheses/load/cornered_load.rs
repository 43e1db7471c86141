//! A periodic load with two corners in each period: a square wave, pulses, a triangle or a saw tooth.
//!
//! ```text
//! t(k) = rises from 0 to 1 over the share d of a period and falls back over the rest
//! p(k) = t(k) - t(k-1)                                        scaled to a largest value of about 1: a pulse
//! load = g t(k) + g_0 p(k) + ... + g_na p(k-na)               a load added to PV enters through A(q): na more samples
//! ```
//!
//! A square wave needs dozens of harmonics; in this form its penalty is no larger than that of five. Without this form, a valve that
//! sticks would be the explanation of its corners with the least penalty.
//!
//! Parameters: angular frequency w (rad/sample), rate 3/2; phase (periods), d (-) and `na + 2` coefficients, rate 1/2 each. A jump
//! between two samples is interpolated, so that the likelihood is smooth in its time. Alternatives: together with the sets of
//! harmonics ([`super::periodic`]). It is proposed at the lines at which harmonics gain most.

use super::periodic::{PERIODIC_SHAPES, describe_periodic};
use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind};
use crate::residual::screening::Screen;
use crate::sysid::armax::{Armax, ORDER, Smooth};
use crate::sysid::criterion::{FREQUENCY, REGULAR};
use crate::sysid::iddata::IdData;
use multiversion::multiversion;
use std::f64::consts::TAU;

/// Fewest samples in a period: with fewer, the fourth harmonic lies above Nyquist's frequency, and the first three are a set of
/// their own.
const LEAST_PERIOD: f64 = 8.0;
/// Least share of a period in which the wave rises, or falls.
const LEAST_RISE: f64 = 0.05;
/// Rising shares from which a search starts: a pulse, and a square or triangular wave. A share above one half is the same wave
/// upside down, started at its other corner.
const RISES: [f64; 2] = [0.2, 0.5];
/// Phases tried in a period.
const PHASES: usize = 12;
/// Passes of the coordinate search, each with half the step of the one before.
const PASSES: usize = 7;
/// Lags of the pulse in a search: the time of a corner hardly depends on the further lags.
const SEARCHED: usize = 2;

/// A wave with corners, with values for its parameters.
#[derive(Clone, Debug)]
pub struct Cornered {
    /// Angular frequency (rad/sample).
    w: f64,
    /// Least w (rad/sample).
    lowest: f64,
    /// Phase at which the rise begins (periods).
    phase: f64,
    /// Share of the period that rises, d (-).
    rise: f64,
}

impl Cornered {
    /// The shapes at the first `n` samples: t(k), then p(k) and `lags` lags of it.
    fn columns(&self, n: usize, lags: usize) -> Vec<Vec<f64>> {
        let turn = self.w / TAU;
        let scale = self.rise.min(1.0 - self.rise) / turn;
        // The wave is known before the record as well.
        let mut t = vec![0.0; n + lags + 1];
        wave(&mut t, lags + 1, turn, self.phase, self.rise);
        let p: Vec<f64> = t.windows(2).map(|pair| scale * (pair[1] - pair[0])).collect();
        let mut columns = vec![t[lags + 1..].to_vec()];
        columns.extend((0..=lags).map(|lag| p[lags - lag..lags - lag + n].to_vec()));
        columns
    }

    /// The expected gain, with a number of lags of p (-).
    fn gain(&self, screen: &Screen<'_>, lags: usize) -> f64 {
        let columns: Vec<Vec<f64>> =
            self.columns(screen.data.len(), lags).iter().map(|column| screen.arx_regressor(column)).collect();
        screen.arx.joint_gain(&columns).0
    }

    /// The wave with its parameters inside their bounds.
    fn clamped(self) -> Self {
        let highest = TAU / LEAST_PERIOD;
        Self {
            w: self.w.clamp(self.lowest, highest),
            rise: self.rise.clamp(LEAST_RISE, 1.0 - LEAST_RISE),
            ..self
        }
    }
}

/// The part of a period that has passed at phase `v` (periods), from 0 up to 1. It vectorises, and a remainder does not.
#[inline(always)]
fn part_of_period(v: f64) -> f64 {
    v - v.floor()
}

/// The wave t at the samples from `before` samples before the record on.
///
/// * `turn`: periods in a sample.
/// * `phase`, `rise`: see [`Cornered`].
#[multiversion(targets("x86_64+avx2"))]
fn wave(t: &mut [f64], before: usize, turn: f64, phase: f64, rise: f64) {
    for (k, t) in t.iter_mut().enumerate() {
        // Numbers of 32 bits are converted side by side.
        let part = part_of_period(turn * f64::from(k as i32 - before as i32) - phase);
        *t = if part < rise { part / rise } else { (1.0 - part) / (1.0 - rise) };
    }
}

/// The wave that gains most near a spectral line at `w` (rad/sample), with its expected gain, by a coordinate search over w, phase
/// and d. `lowest`: the least w. `None` where a period has too few samples.
pub fn likeliest(screen: &Screen<'_>, w: f64, lowest: f64) -> Option<(Cornered, f64)> {
    if w.max(lowest) > TAU / LEAST_PERIOD {
        return None;
    }
    let begun = RISES.iter().flat_map(|&rise| {
        // A wave whose two parts are equal is the same upside down half a period later.
        let phases = if rise < 0.5 { PHASES } else { PHASES / 2 };
        (0..phases).map(move |i| Cornered { w, lowest, phase: i as f64 / PHASES as f64, rise }.clamped())
    });
    let rated = begun.map(|load| (load.gain(screen, 0), load));
    let mut best = rated.max_by(|a, b| a.0.total_cmp(&b.0)).map(|own| own.1)?;
    let mut gain = best.gain(screen, SEARCHED);
    let rows = screen.data.rows();
    let middle = 0.5 * (rows.start + rows.end) as f64;
    // A quarter of a period over all the rows, half the distance of two phases, a tenth of a period.
    let mut steps = [0.25 * TAU / rows.len() as f64, 0.5 / PHASES as f64, 0.1];
    for _ in 0..PASSES {
        for (i, step) in steps.into_iter().enumerate() {
            for by in [-step, step] {
                let mut other = best.clone();
                match i {
                    // The phase moves along, so that the wave stays where it is in the middle of the rows.
                    0 => {
                        other.w += by;
                        other.phase += by / TAU * middle;
                    }
                    1 => other.phase += by,
                    _ => other.rise += by,
                }
                let other = other.clamped();
                let tried = other.gain(screen, SEARCHED);
                if tried > gain {
                    (best, gain) = (other, tried);
                    break;
                }
            }
        }
        steps.iter_mut().for_each(|step| *step *= 0.5);
    }
    best.phase = best.phase.rem_euclid(1.0);
    let gain = best.gain(screen, ORDER);
    Some((best, gain))
}

impl EffectModel for Cornered {
    fn kind(&self) -> Kind {
        Kind::OscillatingLoad
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        FREQUENCY + REGULAR * (ORDER + 4) as f64
    }
    fn alternatives(&self) -> f64 {
        PERIODIC_SHAPES
    }
    fn smooth(&self) -> Vec<Smooth> {
        vec![
            Smooth { value: self.w, step: 1e-6, bounds: (self.lowest, TAU / LEAST_PERIOD) },
            Smooth { value: self.phase, step: 1e-5, bounds: (-1.0, 2.0) },
            Smooth { value: self.rise, step: 1e-5, bounds: (LEAST_RISE, 1.0 - LEAST_RISE) },
        ]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        if let [w, phase, rise] = *theta {
            (self.w, self.phase, self.rise) = (w, phase, rise);
        }
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        out.extend(self.columns(data.len(), ORDER));
    }
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described {
        // The amplitude is that of its first harmonic.
        let columns = self.columns(data.len(), ORDER);
        let load = |k: usize| columns.iter().zip(gamma).map(|(column, g)| g * column[k]).sum::<f64>();
        let periods = (self.w * data.len() as f64 / TAU).floor().max(1.0);
        let n = ((periods * TAU / self.w) as usize).min(data.len());
        let (mut re, mut im) = (0.0, 0.0);
        for k in 0..n {
            let (s, c) = (self.w * k as f64).sin_cos();
            (re, im) = (re + load(k) * c, im + load(k) * s);
        }
        let own = 2.0 * f64::hypot(re, im) / n.max(1) as f64;
        describe_periodic(data, model, self.w, own).with("shorter_part", self.rise.min(1.0 - self.rise), "-")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_part_of_a_period_is_the_euclidean_remainder_to_the_last_bit(v in -2100.0..2100.0f64, by in -4i32..=4) {
            // Also next to whole numbers, where a remainder is nearly 1. The remainder of a negative one is -0: its sign goes.
            let whole = v.floor();
            for v in [v, whole, whole + 1e-13 * f64::from(by), 1e-300 * f64::from(by)] {
                prop_assert_eq!(part_of_period(v).to_bits(), (v.rem_euclid(1.0) + 0.0).to_bits(), "{}", v);
            }
        }

        #[test]
        fn a_wave_side_by_side_is_that_sample_by_sample_to_the_last_bit(
            period in LEAST_PERIOD..600.0f64,
            phase in -1.0..2.0f64,
            rise in LEAST_RISE..1.0 - LEAST_RISE,
            (n, before) in (0usize..70, 1usize..6),
        ) {
            let turn = TAU / period / TAU;
            let plain = |k: usize| {
                let part = (turn * (k as f64 - before as f64) - phase).rem_euclid(1.0) + 0.0;
                if part < rise { part / rise } else { (1.0 - part) / (1.0 - rise) }
            };
            let mut t = vec![f64::NAN; n];
            wave(&mut t, before, turn, phase, rise);
            for (k, t) in t.iter().enumerate() {
                prop_assert_eq!(t.to_bits(), plain(k).to_bits(), "{}", k);
            }
        }
    }

    #[test]
    fn a_wave_rises_falls_and_jumps_where_it_should() {
        let load = Cornered { w: TAU / 10.0, lowest: 0.1, phase: 0.2, rise: 0.5 };
        let columns = load.columns(12, 1);
        let near = |own: &[f64], of: &[f64]| own.iter().zip(of).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(
            near(&columns[0], &[0.4, 0.2, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2]),
            "{columns:?}"
        );
        assert!(near(&columns[1], &[-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0]));
        assert!(near(&columns[2], &[-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0]));
        assert!(columns.iter().all(|column| column.len() == 12));
    }

    #[test]
    fn a_square_wave_costs_no_more_than_five_harmonics() {
        let load = Cornered { w: 0.1, lowest: 0.01, phase: 0.0, rise: 0.5 };
        assert!(load.rate() <= FREQUENCY + 2.0 * REGULAR * 5.0, "{}", load.rate());
    }
}
