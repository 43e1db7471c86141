//! From a window to the data that is fitted, and the declared model on it.

use super::model::{Data, Element, Linear, Scale, Spec};
use super::regress::restructure;
use crate::diagnosis::armax::Orders;
use crate::diagnosis::friction::{Start, largest_reversal};
use crate::diagnosis::region;
use crate::diagnosis::validation::FITTED_SHARE;
use crate::signal::Window;
use crate::sysid::stats::{mean, sd};

/// Longest process delay (samples).
const MAX_DELAY: usize = 10;
/// Samples before the first that counts: the longest delay and the longest lags behind it.
const LEAD: usize = 36;
/// Fewest samples that are fitted, and that are held out.
const LEAST_FITTED: usize = 120;

/// The window, normalised and split.
pub fn pose(window: &Window) -> Option<Data> {
    let n = window.len();
    let scale = Scale {
        t0: window.t0,
        ts: window.ts,
        u0: mean(&window.op),
        u: sd(&window.op),
        y0: mean(&window.pv),
        y: sd(&window.pv),
    };
    let usable = |x: f64| x.is_finite() && x > 0.0;
    if !(usable(scale.u) && usable(scale.y)) {
        return None;
    }
    let normal = |v: &[f64], m: f64, s: f64| -> Vec<f64> { v.iter().map(|x| (x - m) / s).collect() };
    let found = region::analyse(&window.op);
    let start = region::start_of(&found, &window.op, 0, n / 3).unwrap_or(Start { index: 0, is_max: true });
    let first = start.index + LEAD;
    let split = first + ((n.checked_sub(first)?) as f64 * FITTED_SHARE) as usize;
    if split < first + LEAST_FITTED || n < split + LEAST_FITTED / 4 {
        return None;
    }
    let u = normal(&window.op, scale.u0, scale.u);
    let tags = window.tags.iter().filter_map(|(name, v)| {
        let spread = sd(v);
        (v.len() == n && usable(spread)).then(|| (name.clone(), normal(v, mean(v), spread)))
    });
    Some(Data {
        f_top: largest_reversal(&u, start),
        y: normal(&window.pv, scale.y0, scale.y),
        sp: window.sp.as_ref().filter(|sp| sp.len() == n).map(|sp| normal(sp, scale.y0, scale.y)),
        u,
        start,
        first,
        split,
        max_delay: MAX_DELAY,
        scale,
        tags: tags.collect(),
    })
}

/// The declared model: the paper's element at f and a linear part.
pub fn declared(data: &Data, f: f64) -> Spec {
    let mut spec = Spec {
        element: Element { f, ..Element::default() },
        terms: Vec::new(),
        orders: Orders { na: 1, nb: 1, nc: 0, nk: 1 },
        linear: Linear { a: vec![0.0], b: vec![0.0], ..Linear::default() },
        free: None,
        loss: f64::INFINITY,
    };
    restructure(data, &mut spec, false, 6);
    spec
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// `n` samples of a first-order process behind a sound valve.
    pub fn first_order(n: usize) -> Data {
        let op: Vec<f64> =
            (0..n).map(|k| 50.0 + (0.21 * k as f64).sin() + (0.047 * k as f64).cos()).collect();
        let mut pv = vec![0.0; n];
        for k in 2..n {
            pv[k] = 0.8 * pv[k - 1] + 0.3 * (op[k - 2] - 50.0) + 0.05 * (1.7 * (k * k) as f64).sin();
        }
        posed(&op, pv)
    }

    /// An OP of two waves about 50.
    pub fn waves(n: usize) -> Vec<f64> {
        (0..n).map(|k| 50.0 + 4.0 * (0.11 * k as f64).sin() + 1.5 * (0.041 * k as f64).cos()).collect()
    }

    /// Normal numbers of variance 1.
    pub fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed));
        move || noise.next().unwrap_or(0.0)
    }

    /// A first-order process with this pole and a gain of 1 behind `valve`, whose f is in units of OP here; `error` is added to PV.
    pub fn behind_valve(op: &[f64], valve: Element, pole: f64, mut error: impl FnMut(usize) -> f64) -> Data {
        // The start that the pose will choose comes from OP alone.
        let start = posed(op, op.to_vec()).start;
        let (mut z, mut dir) = (Vec::new(), Vec::new());
        valve.run(op, start, op.len(), &mut z, &mut dir);
        let mut x = 0.0;
        let pv = (0..op.len()).map(|k| {
            x = pole * x + (1.0 - pole) * (z[k.saturating_sub(2)] - 50.0);
            x + error(k)
        });
        posed(op, pv.collect())
    }

    fn posed(op: &[f64], pv: Vec<f64>) -> Data {
        let op = op.to_vec();
        pose(&Window { t0: 0.0, ts: 1.0, op, pv, sp: None, mv: None, tags: Vec::new() }).expect("long enough")
    }
}
