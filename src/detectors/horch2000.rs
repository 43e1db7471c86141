//! Horch 2000: the distribution of the second derivative of PV, for processes that integrate.
//!
//! Behind an integrating process, a valve that sticks makes a triangle of PV. Its second derivative is noise with a pulse at each jump,
//! and its distribution has one peak. The second derivative of a sine is a sine, and its distribution has two peaks, at plus and minus
//! the amplitude (a camel).
//!
//! ```text
//! v[k] = s[k + h] - 2 s[k] + s[k - h]           s: PV averaged twice over h = a twelfth of a period
//! gauss: N(0, q)                                camel: q1 g + A sin(theta), theta even over a turn, g ~ N(0, 1)
//! index = MSE_camel / (MSE_camel + MSE_gauss)   MSE: of the best fit to the histogram of v
//! ```
//!
//! v (PV unit), index (-): above 0.5 the Gaussian fits better, and the valve sticks.
//!
//! Source: Condition monitoring of control loops, thesis, KTH Stockholm 2000; his rule is that the better fit decides.
//! Chosen here: the width of the filter, and `q1 <= A/2`: a camel with more noise has one peak too, and would always fit.
//! Limits: noise hides both peaks, and is taken for a valve that sticks; a load that jumps looks like a valve.

use super::facts::Facts;
use super::integration::Integrates;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone};
use crate::sysid::stats::sd;

const METHOD: Method = Method::Horch2000;
/// The better fit decides (-).
pub const BAND: Band = Band::at(0.5);
/// PV is averaged over the period divided by this.
const SHARE: f64 = 12.0;
/// Bins of the histogram.
const BINS: usize = 33;
/// Half the range of the histogram (standard deviations).
const REACH: f64 = 3.3;
/// Width of a bin (standard deviations).
const WIDTH: f64 = 2.0 * REACH / BINS as f64;
/// Phases of the sine over which the camel is averaged.
const TURNS: usize = 16;

/// The distribution of the second derivative and the fits to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Distribution {
    /// Density of the second derivative in its standard deviations, bin by bin over ±`REACH`.
    density: [f64; BINS],
    /// Standard deviation q of the Gaussian that fits best.
    gauss: f64,
    /// Amplitude A and noise q1 of the camel that fits best.
    camel: (f64, f64),
    /// The index (-).
    pub index: f64,
}

/// The middle of a bin.
fn middle(bin: usize) -> f64 {
    (bin as f64 + 0.5) * WIDTH - REACH
}

/// The density of a camel of amplitude `a` and noise `q`.
fn camel(x: f64, a: f64, q: f64) -> f64 {
    let hump = |i: usize| {
        let phase = std::f64::consts::PI * ((i as f64 + 0.5) / TURNS as f64 - 0.5);
        normal(x - a * phase.sin(), q)
    };
    (0..TURNS).map(hump).sum::<f64>() / TURNS as f64
}

/// The distribution of the second derivative of a signal; none where that does not move. `period`: in samples.
pub fn distribution(y: &[f64], period: f64) -> Option<Distribution> {
    let h = ((period / SHARE).round() as usize).max(1);
    let s = average(&average(y, h), h);
    let v: Vec<f64> = s.windows(2 * h + 1).map(|w| w[2 * h] - 2.0 * w[h] + w[0]).collect();
    let spread = sd(&v);
    if v.len() < 2 * BINS || !(spread.is_finite() && spread > 1e-9) {
        return None;
    }
    let mut density = [0.0; BINS];
    for x in &v {
        let bin = (x / spread + REACH) / WIDTH;
        if (0.0..BINS as f64).contains(&bin) {
            density[bin as usize] += 1.0 / (v.len() as f64 * WIDTH);
        }
    }
    let error = |of: &dyn Fn(f64) -> f64| -> f64 {
        density.iter().enumerate().map(|(i, d)| (d - of(middle(i))).powi(2)).sum()
    };
    let mut one = (f64::INFINITY, 0.0);
    for q in (1..=30).map(|i| 0.05 * f64::from(i)) {
        let misfit = error(&|x| normal(x, q));
        if misfit < one.0 {
            one = (misfit, q);
        }
    }
    let mut two = (f64::INFINITY, (0.0, 0.0));
    for a in (3..=9).map(|i| 0.2 * f64::from(i)) {
        for q in [0.1, 0.2, 0.3, 0.4, 0.5].map(|share| share * a) {
            let misfit = error(&|x| camel(x, a, q));
            if misfit < two.0 {
                two = (misfit, (a, q));
            }
        }
    }
    Some(Distribution { density, gauss: one.1, camel: two.1, index: two.0 / (two.0 + one.0) })
}

/// The index of a signal (-); see [`distribution`].
pub fn index(y: &[f64], period: f64) -> Option<f64> {
    Some(distribution(y, period)?.index)
}

/// The density of `N(0, q)`.
fn normal(x: f64, q: f64) -> f64 {
    (-0.5 * (x / q).powi(2)).exp() / (q * std::f64::consts::TAU.sqrt())
}

/// The moving average over `h` samples.
fn average(v: &[f64], h: usize) -> Vec<f64> {
    v.windows(h.max(1)).map(|w| w.iter().sum::<f64>() / w.len() as f64).collect()
}

/// The distribution of a loop's PV.
fn evaluate(facts: &Facts<'_>) -> Result<Distribution, String> {
    let period = facts.oscillates()?;
    match facts.integration.answer {
        Integrates::Yes => {}
        Integrates::No => return Err("the process does not integrate".into()),
        Integrates::Unknown => return Err(facts.integration.why()),
    }
    distribution(&facts.y, period).ok_or_else(|| "PV's second derivative does not move".into())
}

/// The histogram with both fits.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok(found) = evaluate(facts) else { return Vec::new() };
    let bars = found.density.iter().enumerate().map(|(i, d)| (middle(i), *d)).collect();
    let over = |of: &dyn Fn(f64) -> f64| -> Vec<(f64, f64)> {
        (0..=120).map(|i| REACH * (f64::from(i) / 60.0 - 1.0)).map(|x| (x, of(x))).collect()
    };
    let (a, q) = found.camel;
    let layers = vec![
        Layer::bars("PV's second derivative", Tone::Data, bars, WIDTH),
        Layer::line("two humps: a sine", Tone::Sound, over(&|x| camel(x, a, q))),
        Layer::line("one hump: a valve that sticks", Tone::Sticks, over(&|x| normal(x, found.gauss))),
    ];
    let title =
        "Distribution of PV's second derivative: one hump where the valve sticks, two where PV is a sine";
    vec![Picture::new(title, "second derivative (standard deviations)", "density (-)", layers)]
}

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    match evaluate(facts) {
        Ok(found) => {
            let index = found.index;
            let told = BAND.told(index, 2);
            let why = format!("camel's share of the misfit to PV's second derivative {told}");
            Opinion::of(METHOD, index, BAND, why)
        }
        Err(why) => Opinion::cannot_tell(METHOD, why),
    }
}
