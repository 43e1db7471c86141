//! Horch 2000: the distribution of the second derivative of PV, for processes that integrate.
//!
//! Behind an integrating process a valve that sticks makes a triangle of PV. Its second derivative is noise, with a pulse
//! at each jump: one hump. A sine stays a sine: two humps, at its amplitudes (a camel).
//!
//! ```text
//! v[k] = s[k + h] - 2 s[k] + s[k - h]           s: PV averaged twice over h = a twelfth of a period
//! gauss: N(0, q)                                camel: q1 g + A sin(theta), theta even over a turn, g ~ N(0, 1)
//! index = MSE_camel / (MSE_camel + MSE_gauss)   MSE: of the best fit to the histogram of v
//! ```
//!
//! v (PV unit), index (-): above 0.5 the hump fits better, and the valve sticks.
//!
//! Source: Condition monitoring of control loops, thesis, KTH Stockholm 2000; his rule is that the better fit decides.
//! Chosen here: the filter's width, and `q1 <= A/2`: a camel with more noise has one hump too, and would always fit.
//! Limits: noise hides both humps and is taken for a valve that sticks; a load that jumps looks like a valve.

use super::{Band, Facts, Integrates, Method, Opinion};
use crate::sysid::stats::sd;

const ME: Method = Method::Horch2000;
/// The better fit decides (-).
pub const BAND: Band = Band::at(0.5);
/// Twelfths of a period over which PV is averaged.
const SHARE: f64 = 12.0;
/// Bins of the histogram over ±`REACH` standard deviations.
const BINS: usize = 33;
const REACH: f64 = 3.3;
/// Turns of the sine that the camel is averaged over.
const TURNS: usize = 16;

/// The index of a sequence whose period is so many samples; none where its second derivative does not move.
pub fn index(y: &[f64], period: f64) -> Option<f64> {
    let h = ((period / SHARE).round() as usize).max(1);
    let s = average(&average(y, h), h);
    let v: Vec<f64> = s.windows(2 * h + 1).map(|w| w[2 * h] - 2.0 * w[h] + w[0]).collect();
    let spread = sd(&v);
    if v.len() < 2 * BINS || !(spread.is_finite() && spread > 1e-9) {
        return None;
    }
    let width = 2.0 * REACH / BINS as f64;
    let mut density = [0.0; BINS];
    for x in &v {
        let bin = (x / spread + REACH) / width;
        if (0.0..BINS as f64).contains(&bin) {
            density[bin as usize] += 1.0 / (v.len() as f64 * width);
        }
    }
    let error = |of: &dyn Fn(f64) -> f64| -> f64 {
        density.iter().enumerate().map(|(i, d)| (d - of((i as f64 + 0.5) * width - REACH)).powi(2)).sum()
    };
    let gauss =
        (1..=30).map(|i| 0.05 * f64::from(i)).map(|q| error(&|x| normal(x, q))).fold(f64::INFINITY, f64::min);
    let mut camel = f64::INFINITY;
    for a in (3..=9).map(|i| 0.2 * f64::from(i)) {
        for q in [0.1, 0.2, 0.3, 0.4, 0.5].map(|share| share * a) {
            let humps: [f64; TURNS] = std::array::from_fn(|i| {
                a * (std::f64::consts::PI * ((i as f64 + 0.5) / TURNS as f64 - 0.5)).sin()
            });
            camel = camel.min(error(&|x| humps.iter().map(|m| normal(x - m, q)).sum::<f64>() / TURNS as f64));
        }
    }
    Some(camel / (camel + gauss))
}

fn normal(x: f64, q: f64) -> f64 {
    (-0.5 * (x / q).powi(2)).exp() / (q * std::f64::consts::TAU.sqrt())
}

/// The mean of every `h` samples on end.
fn average(v: &[f64], h: usize) -> Vec<f64> {
    v.windows(h.max(1)).map(|w| w.iter().sum::<f64>() / w.len() as f64).collect()
}

/// What the method says.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let period = match facts.oscillates() {
        Ok(period) => period,
        Err(why) => return Opinion::cannot_tell(ME, why),
    };
    match facts.integration.answer {
        Integrates::Yes => {}
        Integrates::No => return Opinion::cannot_tell(ME, "the process does not integrate"),
        Integrates::Unknown => return Opinion::cannot_tell(ME, facts.integration.why()),
    }
    match index(&facts.y, period) {
        Some(index) => Opinion::of(
            ME,
            index,
            BAND,
            format!("camel's share of the misfit to PV's second derivative {index:.2}"),
        ),
        None => Opinion::cannot_tell(ME, "PV's second derivative does not move"),
    }
}
