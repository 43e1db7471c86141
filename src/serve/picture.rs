//! What is drawn behind a verdict: the stem that the friction implies, the stick-band over PV and OP, and what the
//! residual looks like: its spectrum and its correlations.

use crate::diagnosis::{friction, region};
use crate::results::{Judged, Residuals};
use crate::signal::Window;
use crate::sysid::spectrum;
use crate::sysid::stats::{mean, median, range, sd};
use std::borrow::Cow;

/// Lags of the correlations (samples).
const LAGS: usize = 40;
/// Longest segment of the averaged spectrum (samples).
const SEGMENT: usize = 256;
/// Longest delay from stem to PV that the band allows for (samples).
const MOST_DELAY: usize = 60;
/// Least correlation of PV with the delayed stem that gives the band a slope (-).
const FOLLOWS: f64 = 0.6;

/// The stick-band over a window: what the fitted element draws in one swing.
///
/// Where the stem turns round it stands while OP comes back by 2f; between its turns it follows OP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Friction parameter, S/2 (OP unit).
    pub f: f64,
    /// OP where the stem turns round, below and above, medians (OP unit).
    pub op: [f64; 2],
    /// The stem there (OP unit): with a kinetic lag it is not OP.
    pub stem: [f64; 2],
    /// PV where the stem turns round (PV unit); `None` where PV does not follow the stem closely enough to tell.
    pub pv: Option<[f64; 2]>,
}

/// The position of the stem (OP unit) that the friction that counts implies, one value per sample of the window.
pub fn stem(judged: &Judged) -> Option<Vec<f64>> {
    let window = judged.diagnosis.shown_window().filter(|window| !window.is_empty())?;
    let (f, ..) = judged.friction()?;
    let declared = judged.diagnosis.estimate.as_ref().is_some_and(|estimate| estimate.f == f);
    let stem = judged.diagnosis.shown_stem().filter(|stem| declared && stem.len() == window.len());
    Some(stem.map_or_else(|| driven(&window.op, f), Cow::into_owned))
}

/// OP through the element with friction f.
fn driven(op: &[f64], f: f64) -> Vec<f64> {
    let found = region::analyse(op);
    let start = region::start_of(&found, op, 0, op.len() / 3);
    let start = start.unwrap_or(friction::Start { index: 0, is_max: true });
    let (mut x, mut dir) = (vec![0.0; op.len()], vec![0.0; op.len()]);
    friction::stick_slip(op, f, 0.0, start, &mut x, &mut dir);
    x
}

/// The stick-band over a window; `None` without friction.
///
/// PV follows the stem x with some delay as `mean(PV) ± sd(PV) / sd(x) (x - mean(x))` where the two are close; where PV
/// integrates, or is driven by something else, it is not.
pub fn band(window: &Window, stem: &[f64], f: f64) -> Option<Band> {
    let n = window.len();
    if f <= 0.0 || stem.len() != n || n < 2 * MOST_DELAY {
        return None;
    }
    let [low, high] = turns(stem, &window.op)?;
    let at = |delay: usize| correlation(&stem[..n - delay], &window.pv[delay..]);
    let closest = (0..=MOST_DELAY).map(at).max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
    let slope = closest.signum() * sd(&window.pv) / sd(stem);
    let follows = closest.abs() > FOLLOWS && slope.is_finite();
    let pv = |x: f64| mean(&window.pv) + slope * (x - mean(stem));
    let pv = follows.then(|| [pv(low.0), pv(high.0)]);
    Some(Band { f, op: [low.1, high.1], stem: [low.0, high.0], pv })
}

/// Stem and OP where the stem turns round: the medians of the lower and of the upper turns.
fn turns(stem: &[f64], op: &[f64]) -> Option<[(f64, f64); 2]> {
    let (mut lower, mut upper) = (Vec::new(), Vec::new());
    let mut last = None;
    for k in (1..stem.len()).filter(|&k| stem[k] != stem[k - 1]) {
        let rises = stem[k] > stem[k - 1];
        match last {
            Some((false, at)) if rises => lower.push(at),
            Some((true, at)) if !rises => upper.push(at),
            _ => {}
        }
        last = Some((rises, k));
    }
    let middle = |at: &[usize], v: &[f64]| median(&at.iter().map(|&k| v[k]).collect::<Vec<_>>());
    let of = |at: &[usize]| (!at.is_empty()).then(|| (middle(at, stem), middle(at, op)));
    Some([of(&lower)?, of(&upper)?])
}

/// The corners of the band as (OP, PV), from the lower turn on: the stem stands from the first to the second and from the
/// third to the fourth. Where PV does not tell, an upright band as wide, over all of PV.
pub fn corners(band: &Band, pv: &[f64]) -> [[f64; 2]; 4] {
    let ([low, high], wide) = (band.op, 2.0 * band.f);
    match band.pv {
        Some([y_low, y_high]) => [[low, y_low], [low + wide, y_low], [high, y_high], [high - wide, y_high]],
        None => {
            let (least, most) = range(pv);
            let (left, right) = (0.5 * (low + high) - band.f, 0.5 * (low + high) + band.f);
            [[left, least], [right, least], [right, most], [left, most]]
        }
    }
}

/// What is in the residual, before and after the effects.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inside {
    /// Periods of the spectrum (s), from long to short.
    pub period: Vec<f64>,
    /// Power at each period [PV unit²], before and after.
    pub power: [Vec<f64>; 2],
    /// Correlation with itself that many samples earlier, from lag 1 on (-), before and after.
    pub with_itself: [Vec<f64>; 2],
    /// Correlation with OP that many samples earlier, from lag 0 on (-), before and after.
    pub with_op: [Vec<f64>; 2],
    /// Correlations of white noise stay within ± this, 99 of 100 (-).
    pub limit: f64,
}

/// Spectrum and correlations of the residuals; `window` as the diagnosis had it.
pub fn inside(residuals: &Residuals, window: Option<&Window>) -> Inside {
    let e = [residuals.before.values(), residuals.after.values()];
    within(&e, [residuals.t0, residuals.ts], window)
}

/// The same of residuals before and after, which begin at `t0` and have a sample every `ts` (s).
fn within(e: &[Vec<f64>; 2], [t0, ts]: [f64; 2], window: Option<&Window>) -> Inside {
    let with_op = match window {
        Some(window) => [crossed(&e[0], [t0, ts], window), crossed(&e[1], [t0, ts], window)],
        None => [vec![], vec![]],
    };
    let segment = SEGMENT.min(e[0].len());
    let periods = (1..=segment / 2).map(|k| segment as f64 * ts / k as f64);
    Inside {
        period: periods.collect(),
        power: [spectrum(&e[0], segment), spectrum(&e[1], segment)],
        with_itself: [correlations(&e[0], &e[0], 1), correlations(&e[1], &e[1], 1)],
        with_op,
        limit: 2.576 / (e[0].len().max(1) as f64).sqrt(),
    }
}

/// The residual against past OP over the samples that both have.
fn crossed(e: &[f64], [t0, ts]: [f64; 2], window: &Window) -> Vec<f64> {
    let ahead = (window.t0 - t0) / ts;
    if !(ahead.is_finite() && (window.ts / ts - 1.0).abs() < 1e-6) {
        return Vec::new();
    }
    let ahead = ahead.round();
    let (skip_e, skip_op) = (ahead.max(0.0) as usize, (-ahead).max(0.0) as usize);
    let n = e.len().saturating_sub(skip_e).min(window.len().saturating_sub(skip_op));
    if n <= LAGS {
        return Vec::new();
    }
    correlations(&e[skip_e..skip_e + n], &window.op[skip_op..skip_op + n], 0)
}

/// Correlation of a with b some samples earlier, by lag from `first` on.
fn correlations(a: &[f64], b: &[f64], first: usize) -> Vec<f64> {
    let n = a.len();
    if n <= LAGS {
        return Vec::new();
    }
    let (ma, mb, scale) = (mean(a), mean(b), sd(a) * sd(b) * n as f64);
    let at = |lag: usize| {
        let sum: f64 = (lag..n).map(|k| (a[k] - ma) * (b[k - lag] - mb)).sum();
        if scale > 0.0 { sum / scale } else { 0.0 }
    };
    (first..=LAGS).map(at).collect()
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (ma, mb, scale) = (mean(a), mean(b), sd(a) * sd(b) * a.len() as f64);
    let sum: f64 = a.iter().zip(b).map(|(x, y)| (x - ma) * (y - mb)).sum();
    if scale > 0.0 { sum / scale } else { 0.0 }
}

/// Welch's spectrum: half-overlapping segments under a Hann window, averaged; scaled so that it sums to the variance.
fn spectrum(e: &[f64], segment: usize) -> Vec<f64> {
    if segment < 16 {
        return Vec::new();
    }
    let centre = mean(e);
    let hann: Vec<f64> = (0..segment)
        .map(|k| (std::f64::consts::PI * (k as f64 + 0.5) / segment as f64).sin().powi(2))
        .collect();
    let weight: f64 = hann.iter().map(|w| w * w).sum();
    let mut power = vec![0.0; segment / 2];
    let mut count = 0.0;
    for from in (0..=e.len() - segment).step_by(segment / 2) {
        let mut part: Vec<f64> =
            e[from..from + segment].iter().zip(&hann).map(|(e, w)| (e - centre) * w).collect();
        for (power, bin) in power.iter_mut().zip(&spectrum::power(&mut part)[1..]) {
            *power += bin;
        }
        count += 1.0;
    }
    // Two sides of the spectrum, one of them stored.
    power.iter().map(|p| 2.0 * p / (count * weight * segment as f64)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stem_of_friction_stands_on_a_reversal_until_op_came_back_by_2f() {
        let op: Vec<f64> = (0..400).map(|k| 50.0 + 5.0 * (0.1 * f64::from(k)).sin()).collect();
        let x = driven(&op, 1.0);
        let lag = |k: usize| (x[k] - op[k]).abs();
        assert!((200..400).map(lag).fold(0.0, f64::max) <= 2.0 + 1e-9, "never further behind than 2f");
        assert!((200..400).map(lag).fold(0.0, f64::max) > 1.9, "and nearly that far at every reversal");
    }

    #[test]
    fn the_band_is_what_the_element_draws() {
        let op: Vec<f64> = (0..600).map(|k| 50.0 + 5.0 * (0.1 * f64::from(k)).sin()).collect();
        let stem = driven(&op, 1.0);
        let pv: Vec<f64> = (0..600).map(|k: usize| 7.0 - 3.0 * stem[k.saturating_sub(4)]).collect();
        let window = Window { ts: 1.0, op: op.clone(), pv, ..Window::default() };
        let found = band(&window, &stem, 1.0).expect("friction has a band");
        // The sine's tops are met to within one sample: 5 (1 - cos 0.05) = 0.006.
        assert!((found.op[0] - 45.0).abs() < 0.01 && (found.op[1] - 55.0).abs() < 0.01, "{found:?}");
        assert_eq!(found.op, found.stem, "without a lag they are the same");
        // The delay costs four samples of 600 at one end.
        let [low, high] = found.pv.expect("it follows");
        assert!((low - (7.0 - 135.0)).abs() < 0.3 && (high - (7.0 - 165.0)).abs() < 0.3, "{found:?}");
        let [a, b, c, d] = corners(&found, &window.pv);
        assert!((b[0] - a[0] - 2.0).abs() < 1e-9 && (c[0] - d[0] - 2.0).abs() < 1e-9, "2f wide");
        let other: Vec<f64> = (0..600).map(|k| (0.77 * f64::from(k)).cos()).collect();
        let window = Window { pv: other, ..window };
        let upright = band(&window, &stem, 1.0).expect("friction has a band");
        assert_eq!(upright.pv, None);
        let [a, b, c, _] = corners(&upright, &window.pv);
        assert!((b[0] - a[0] - 2.0).abs() < 1e-9 && b[0] == c[0], "as wide, upright");
        assert_eq!(band(&window, &stem, 0.0), None);
        assert_eq!(band(&window, &[50.0; 600], 1.0), None, "a stem that never turns has no band");
    }

    #[test]
    fn a_line_in_the_residual_stands_at_its_period_and_its_power() {
        let wave = |k: usize| 2.0 * (2.0 * std::f64::consts::PI * k as f64 / 32.0).sin();
        let found = within(&[(0..1024).map(wave).collect(), vec![0.0; 1024]], [0.0, 2.0], None);
        let at = (0..found.period.len()).max_by(|a, b| found.power[0][*a].total_cmp(&found.power[0][*b]));
        assert_eq!(found.period[at.expect("a spectrum")], 64.0);
        // A sine of height 2 has variance 2; the Hann window spreads it over three bins, exactly.
        assert!((found.power[0].iter().sum::<f64>() - 2.0).abs() < 1e-6);
        assert!(found.power[1].iter().all(|p| *p == 0.0));
        // Half a period later it is its own opposite; the sum has 16 terms fewer than the variance.
        assert!((found.with_itself[0][15] + 1008.0 / 1024.0).abs() < 1e-6, "{:?}", found.with_itself[0]);
        assert!(found.with_op[0].is_empty(), "there is no window to compare with");
    }
}
