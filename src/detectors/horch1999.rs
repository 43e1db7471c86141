//! Horch 1999: the cross-correlation of OP and PV.
//!
//! Under PI control of a self-regulating process, a valve that sticks puts PV a quarter of a period behind (an odd
//! function); a load or tight tuning puts OP and PV half a period apart (an even one).
//!
//! ```text
//! r(l) = sum u[k] y[k + l] / (N sd(u) sd(y))
//! d_rho = | |r_0| - |r_opt| | / (|r_0| + |r_opt|)      r_0 = r(0), r_opt: the largest |r| between the two crossings
//! d_tau = |tau_l - tau_r| / (tau_l + tau_r)            tau_l, tau_r: zero crossings of r nearest to 0 (samples)
//! ```
//!
//! A cosine `r = cos(w l + phi)` has `d_rho = (1 - cos phi)/(1 + cos phi)` and `d_tau = 2 phi/pi`, phi its shift from an even
//! function. The author's thresholds are phi = 30° (`d_rho = (2 - sqrt 3)/(2 + sqrt 3) = 0.072, d_tau = 1/3`) and 60°
//! (`1/3, 2/3`). The index is d_tau; d_rho must say the same.
//!
//! Source: A simple method for detection of stiction in control valves, Control Eng. Practice 1999, 7, 1221.
//! Limits: integrating processes and P control are not covered; dead time and a lag turn the phase towards the half period
//! of a load, so that a valve that sticks weakly in a slow process is called sound.

use super::facts::Facts;
use super::integration::Integrates;
use super::opinion::{Band, Method, Opinion, Says};
use super::picture::{Layer, Picture, Tone};
use crate::sysid::least_squares::dot;

const METHOD: Method = Method::Horch1999;
/// The author's thresholds of `d_tau` (-).
pub const BY_TIME: Band = Band { sound: 1.0 / 3.0, sticks: 2.0 / 3.0 };
/// The author's thresholds of `d_rho` (-): the first is (2 - √3)/(2 + √3).
pub const BY_HEIGHT: Band = Band { sound: 0.071_796_769_724_490_8, sticks: 1.0 / 3.0 };

/// The shape of the cross-correlation around lag 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// `d_rho` (-).
    pub by_height: f64,
    /// `d_tau` (-).
    pub by_time: f64,
}

/// The cross-correlation within a period of 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Correlation {
    /// r (-) from lag `-reach` to `reach` (samples).
    pub r: Vec<f64>,
    /// The zero crossings nearest to 0, before and after it (samples, both positive); none where r does not cross there.
    pub crossings: Option<[f64; 2]>,
    /// r_opt: the largest |r| between them; without crossings the largest within the reach.
    pub largest: f64,
}

impl Correlation {
    /// The cross-correlation of two centred signals. `period`: the reach (samples).
    pub fn new(u: &[f64], y: &[f64], period: f64) -> Self {
        let n = u.len().min(y.len());
        let (u, y) = (&u[..n], &y[..n]);
        let reach = (period.ceil() as usize).min(n / 2);
        let scale = (dot(u, u) * dot(y, y)).sqrt();
        let at = |lag: usize| dot(&u[..n - lag], &y[lag..]) / scale;
        let before = |lag: usize| dot(&u[lag..], &y[..n - lag]) / scale;
        let r: Vec<f64> = (1..=reach).rev().map(before).chain((0..=reach).map(at)).collect();
        let mut largest = r[reach].abs();
        let sides = [1, -1].map(|side| {
            let mut before = r[reach];
            (1..=reach).find_map(|lag| {
                let now = if side < 0 { r[reach + lag] } else { r[reach - lag] };
                if (now > 0.0) != (before > 0.0) && now != before {
                    return Some((lag - 1) as f64 + before / (before - now));
                }
                largest = largest.max(now.abs());
                before = now;
                None
            })
        });
        let [left, right] = sides;
        Self { r, crossings: left.zip(right).map(<[f64; 2]>::from), largest }
    }

    /// r at lag 0.
    fn zero(&self) -> f64 {
        self.r[self.r.len() / 2]
    }

    /// `d_rho` and `d_tau`; none where r does not cross zero.
    pub fn shape(&self) -> Option<Shape> {
        let crossings = self.crossings?;
        let (zero, largest, sum) = (self.zero().abs(), self.largest, crossings[0] + crossings[1]);
        (largest > 0.0 && sum > 0.0).then(|| Shape {
            by_height: (largest - zero) / (largest + zero),
            by_time: (crossings[0] - crossings[1]).abs() / sum,
        })
    }
}

/// `d_rho` and `d_tau` of two centred signals within a period (samples); none where r does not cross zero there.
pub fn shape(u: &[f64], y: &[f64], period: f64) -> Option<Shape> {
    Correlation::new(u, y, period).shape()
}

/// The cross-correlation of OP and PV of a loop.
fn evaluate(facts: &Facts<'_>) -> Result<Correlation, String> {
    let period = facts.oscillates()?;
    match facts.integration.answer {
        Integrates::No => Ok(Correlation::new(&facts.op.centred, &facts.pv.centred, period)),
        Integrates::Yes => Err("the process integrates".into()),
        Integrates::Unknown => Err(facts.integration.why()),
    }
}

/// The correlation over the lag, its crossings, r_0 and r_opt.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok(found) = evaluate(facts) else { return Vec::new() };
    let reach = (found.r.len() / 2) as f64;
    let lag = |k: usize| (k as f64 - reach) * facts.window.ts;
    let curve = found.r.iter().enumerate().map(|(k, r)| (lag(k), *r)).collect();
    let mut layers = vec![
        Layer::level("0", Tone::Mark, 0.0),
        Layer::line("r", Tone::Data, curve),
        Layer::dots("r at lag 0", Tone::Sound, vec![(0.0, found.zero())]),
    ];
    if let Some([left, right]) = found.crossings {
        let seconds = |lag: f64| lag * facts.window.ts;
        layers.push(Layer::upright("nearest zero crossings", Tone::Mark, seconds(-left)));
        layers.push(Layer::upright("nearest zero crossings", Tone::Mark, seconds(right)));
        let within = |k: &usize| (-left..=right).contains(&(*k as f64 - reach));
        let tops = (0..found.r.len()).filter(within);
        let top = tops.max_by(|a, b| found.r[*a].abs().total_cmp(&found.r[*b].abs()));
        let at = top.map(|k| (lag(k), found.r[k])).into_iter().collect();
        layers.push(Layer::dots("r_opt", Tone::Sticks, at));
    }
    let title =
        "Cross-correlation of OP and PV: odd about lag 0 where the valve sticks, even where a load swings";
    vec![Picture::new(title, "lag (s)", "correlation (-)", layers)]
}

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let found = match evaluate(facts) {
        Ok(found) => found,
        Err(why) => return Opinion::cannot_tell(METHOD, why),
    };
    let Some(Shape { by_height, by_time }) = found.shape() else {
        return Opinion::cannot_tell(METHOD, "the cross-correlation does not cross zero within a period");
    };
    let why = format!("d_tau {}, d_rho {}", BY_TIME.told(by_time, 2), BY_HEIGHT.told(by_height, 2));
    let opinion = Opinion::of(METHOD, by_time, BY_TIME, why.clone());
    let other = BY_HEIGHT.says(by_height);
    if opinion.says != other && opinion.says != Says::CannotTell {
        return opinion.but_cannot_tell(format!("{why}: they do not say the same"));
    }
    opinion
}
