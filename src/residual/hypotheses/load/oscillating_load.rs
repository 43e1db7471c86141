//! A periodic load: `sum over harmonics h of s_h sin(h w k) + c_h cos(h w k)`.
//!
//! Parameters: angular frequency w (rad/sample), rate 3/2; two coefficients for each harmonic, rate 1/2 each. Alternatives: three
//! sets of harmonics, and a wave with corners ([`super::cornered_load`]). It is proposed at the lines of the spectra of the errors
//! and of PV.

use super::cornered_load::likeliest;
use super::periodic::{HARMONICS, PERIODIC_SHAPES, describe_periodic};
use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind, Lasting};
use crate::residual::hypotheses::proposal::{Proposal, Propose, best};
use crate::residual::screening::Screen;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::{FREQUENCY, REGULAR, untempered_penalty};
use crate::sysid::iddata::IdData;
use crate::sysid::spectrum;
use std::f64::consts::{PI, TAU};

/// Highest angular frequency of a harmonic (rad/sample): near Nyquist's frequency nothing can be told.
const HIGHEST: f64 = 0.9 * PI;
/// Fewest periods in the fitted rows: with fewer, a wave cannot be told from a drift.
const PERIODS: f64 = 3.0;
/// Spectral lines of the errors, and of PV, that are screened.
const LINES: [usize; 2] = [4, 3];
/// Loads proposed.
const LOADS: usize = 3;
/// Lines at which a wave with corners is searched for: those at which harmonics gain most.
const CORNERED: usize = 2;

/// The periodic loads.
pub struct Oscillating;

#[derive(Clone, Debug)]
struct Load {
    /// Angular frequency (rad/sample).
    w: f64,
    /// Least w (rad/sample): that of a load with the fewest periods.
    lowest: f64,
    /// Numbers of the harmonics.
    harmonics: &'static [usize],
}

impl Load {
    fn shapes(&self, n: usize) -> Vec<Vec<f64>> {
        let wave = |h: &usize| wave(self.w * *h as f64, n);
        self.harmonics.iter().flat_map(wave).collect()
    }
}

/// Samples whose sines are rotated from those of the first one: over more, rounding errors would add up.
const TURNED: usize = 64;

/// `sin(w k)` and `cos(w k)`, by the addition theorem: `sin(w (k + i)) = sin(w k) cos(w i) + cos(w k) sin(w i)`.
fn wave(w: f64, n: usize) -> [Vec<f64>; 2] {
    let turns: [(f64, f64); TURNED] = std::array::from_fn(|i| (w * i as f64).sin_cos());
    let (mut sines, mut cosines) = (vec![0.0; n], vec![0.0; n]);
    let blocks = sines.chunks_mut(TURNED).zip(cosines.chunks_mut(TURNED));
    for (block, (sines, cosines)) in blocks.enumerate() {
        let (s, c) = (w * (block * TURNED) as f64).sin_cos();
        for ((sine, cosine), (by_s, by_c)) in sines.iter_mut().zip(cosines).zip(&turns) {
            (*sine, *cosine) = (s * by_c + c * by_s, c * by_c - s * by_s);
        }
    }
    [sines, cosines]
}

impl EffectModel for Load {
    fn kind(&self) -> Kind {
        Kind::OscillatingLoad
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        FREQUENCY + 2.0 * REGULAR * self.harmonics.len() as f64
    }
    fn alternatives(&self) -> f64 {
        PERIODIC_SHAPES
    }
    fn smooth(&self) -> Vec<Smooth> {
        let highest = HIGHEST / self.harmonics.iter().copied().max().unwrap_or(1) as f64;
        vec![Smooth { value: self.w, step: 1e-6, bounds: (self.lowest, highest) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.w = theta[0];
    }
    fn lasting(&self, data: &IdData) -> Option<Lasting> {
        let period_s = TAU / self.w * data.units.ts;
        Some(Lasting::OscillatingLoad { period_s, harmonics: self.harmonics.len() })
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        out.extend(self.shapes(data.len()));
    }
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described {
        let own = gamma.iter().take(2).map(|g| g * g).sum::<f64>().sqrt();
        describe_periodic(data, model, self.w, own).with("harmonics", self.harmonics.len() as f64, "-")
    }
}

/// The angular frequency of a load with the fewest periods (rad/sample).
fn lowest(data: &IdData) -> f64 {
    PERIODS * TAU / data.rows().len() as f64
}

/// The load with this period (s) and number of harmonics; `None` where the record is too short or its sampling too slow for it.
pub fn restored(data: &IdData, period_s: f64, harmonics: usize) -> Option<Box<dyn EffectModel>> {
    let harmonics = HARMONICS.into_iter().find(|known| known.len() == harmonics)?;
    let w = TAU * data.units.ts / period_s;
    let lowest = lowest(data);
    let inside = w * *harmonics.last()? as f64 <= HIGHEST && w >= lowest;
    inside.then(|| Load { w, lowest, harmonics }.boxed())
}

impl Propose for Oscillating {
    fn kind(&self) -> Kind {
        Kind::OscillatingLoad
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        let data = screen.data;
        let n = screen.arx.errors.len();
        let mut lines = peaks(&screen.arx.errors, screen.limit(LINES[0]));
        for line in peaks(&data.y[data.rows()], screen.limit(LINES[1])) {
            if !lines.contains(&line) {
                lines.push(line);
            }
        }
        let rate = |load: &Load| -> f64 {
            let shapes = load.shapes(data.len());
            let columns: Vec<Vec<f64>> = shapes.iter().map(|s| screen.arx_regressor(s)).collect();
            screen.arx.joint_gain(&columns).0
        };
        // The penalty of a load, as a log-likelihood.
        let penalty = |load: &dyn EffectModel| untempered_penalty(load.rate(), n as f64);
        let (mut out, mut rated) = (Vec::new(), Vec::new());
        for w in lines {
            let sine = Load { w, lowest: lowest(data), harmonics: HARMONICS[0] };
            let (load, gain) = refined(sine, 0.25 * TAU / n as f64, rate);
            let mut most = f64::NEG_INFINITY;
            for harmonics in HARMONICS {
                let load = Load { harmonics, ..load };
                if load.w * harmonics[harmonics.len() - 1] as f64 <= HIGHEST {
                    let gain = if harmonics.len() == 1 { gain } else { rate(&load) };
                    // Loads with different numbers of harmonics are ranked by gain less penalty.
                    let net = gain - penalty(&load);
                    most = most.max(net);
                    out.push(Proposal::new(load, net));
                }
            }
            rated.push((most, load.w));
        }
        rated.sort_by(|a, b| b.0.total_cmp(&a.0));
        let lines = rated.into_iter().take(screen.limit(CORNERED));
        for (load, gain) in lines.filter_map(|line| likeliest(screen, line.1, lowest(data))) {
            let net = gain - penalty(&load);
            out.push(Proposal::new(load, net));
        }
        let mut out = best(out, screen.limit(LOADS));
        // A proposal has the gain itself: its score takes the penalty off later.
        out.iter_mut().for_each(|proposal| proposal.gain += penalty(proposal.effect.as_ref()));
        out
    }
}

/// The load with the frequency that gains most near a spectral line, and its gain. `step`: first step of the search (rad/sample);
/// it is halved five times.
fn refined(mut load: Load, mut step: f64, gain_of: impl Fn(&Load) -> f64) -> (Load, f64) {
    let mut gain = gain_of(&load);
    for _ in 0..5 {
        for w in [load.w - step, load.w + step] {
            let other = Load { w, ..load };
            let tried = gain_of(&other);
            if tried > gain {
                (load, gain) = (other, tried);
            }
        }
        step *= 0.5;
    }
    (load, gain)
}

/// The strongest lines of the spectrum with at least [`PERIODS`] periods (rad/sample), `most` of them, the strongest first.
fn peaks(v: &[f64], most: usize) -> Vec<f64> {
    let n = v.len();
    let size = (2 * n).next_power_of_two();
    let mean = v.iter().sum::<f64>() / n.max(1) as f64;
    let mut padded = vec![0.0; size];
    for (k, (p, v)) in padded.iter_mut().zip(v).enumerate() {
        // Hann's window: the leakage of a strong line must not hide its neighbours.
        *p = (v - mean) * (0.5 - 0.5 * (TAU * k as f64 / n as f64).cos());
    }
    let power = spectrum::power(&mut padded);
    let low = (PERIODS * size as f64 / n as f64) as usize;
    let mut found: Vec<usize> = (low.max(1)..(power.len() - 1) * 9 / 10)
        .filter(|&i| power[i] >= power[i - 1] && power[i] > power[i + 1])
        .collect();
    found.sort_by(|&a, &b| power[b].total_cmp(&power[a]));
    found.truncate(most);
    found.into_iter().map(|i| TAU * i as f64 / size as f64).collect()
}
