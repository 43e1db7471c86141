//! A periodic load with two corners a period: a square wave, pulses, a triangle or a saw tooth.
//!
//! ```text
//! t(k) = rises from 0 to 1 over the share d of a period and falls back over the rest
//! p(k) = t(k) - t(k-1)                                        scaled to a largest value of about 1: a pulse
//! load = g t(k) + g_0 p(k) + ... + g_na p(k-na)               a load added to PV enters through A(q): na more samples
//! ```
//!
//! A square wave needs dozens of harmonics; as one of these it costs no more than five. Without it a valve that sticks is the
//! cheapest way to explain its corners.
//!
//! Parameters: angular frequency w (rad/sample), rate 3/2; phase (periods), d (-) and `na + 2` coefficients, rate 1/2 each: between
//! two samples a jump is interpolated, so the likelihood is smooth in its place. Alternatives: with the sets of harmonics. Proposed at the lines at which harmonics gain most.

use super::oscillating_load::{PERIODIC_SHAPES, describe_periodic};
use crate::residual::Kind;
use crate::residual::effect::EffectModel;
use crate::residual::report::Described;
use crate::residual::screening::Screen;
use crate::sysid::armax::{Armax, ORDER, Smooth};
use crate::sysid::criterion::{FREQUENCY, REGULAR};
use crate::sysid::iddata::IdData;
use std::f64::consts::TAU;

/// Fewest samples in a period: with fewer, the fourth harmonic lies above Nyquist's frequency, and the first three are a set of
/// their own.
const LEAST_PERIOD: f64 = 8.0;
/// Least share of a period that rises, or falls.
const LEAST_RISE: f64 = 0.05;
/// Shares that rise from which a search starts: a pulse, a square or triangle. A share above one half is the same wave upside down,
/// begun at its other corner.
const RISES: [f64; 2] = [0.2, 0.5];
/// Phases tried in a period.
const PHASES: usize = 12;
/// Passes of the coordinate search, each with half the step of the one before.
const PASSES: usize = 7;
/// Lags of the pulse in a search: the place of a corner hardly depends on the others.
const SEARCHED: usize = 2;

/// A load at some value of its parameters.
#[derive(Clone, Debug)]
pub struct Cornered {
    /// Angular frequency (rad/sample).
    w: f64,
    /// Least w.
    lowest: f64,
    /// Where the rise begins (periods).
    phase: f64,
    /// Share of the period that rises.
    rise: f64,
}

impl Cornered {
    /// Lags of t(k) and of p(k) at the first samples: t, then p with `lags` lags.
    fn columns(&self, n: usize, lags: usize) -> Vec<Vec<f64>> {
        let turn = self.w / TAU;
        let at = |k: f64| {
            let part = (turn * k - self.phase).rem_euclid(1.0);
            if part < self.rise { part / self.rise } else { (1.0 - part) / (1.0 - self.rise) }
        };
        let scale = self.rise.min(1.0 - self.rise) / turn;
        // The wave is known before the record as well.
        let t: Vec<f64> = (0..=n + lags).map(|k| at(k as f64 - (lags + 1) as f64)).collect();
        let p: Vec<f64> = t.windows(2).map(|pair| scale * (pair[1] - pair[0])).collect();
        let mut columns = vec![t[lags + 1..].to_vec()];
        columns.extend((0..=lags).map(|lag| p[lags - lag..lags - lag + n].to_vec()));
        columns
    }

    /// What it promises with so many lags.
    fn gain(&self, screen: &Screen<'_>, lags: usize) -> f64 {
        let columns: Vec<Vec<f64>> =
            self.columns(screen.data.len(), lags).iter().map(|column| screen.rows(column)).collect();
        screen.long.several(&columns).0
    }

    fn clamped(self) -> Self {
        let highest = TAU / LEAST_PERIOD;
        Self {
            w: self.w.clamp(self.lowest, highest),
            rise: self.rise.clamp(LEAST_RISE, 1.0 - LEAST_RISE),
            ..self
        }
    }
}

/// The likeliest load about a line at `w`, and what it promises; `lowest`: the least w. `None` where a period has too few samples.
pub fn likeliest(screen: &Screen<'_>, w: f64, lowest: f64) -> Option<(Cornered, f64)> {
    if w.max(lowest) > TAU / LEAST_PERIOD {
        return None;
    }
    let begun = RISES.iter().flat_map(|&rise| {
        // Half a period later a wave with two like parts is the same upside down.
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
