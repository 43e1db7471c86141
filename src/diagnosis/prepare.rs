//! From the window of the gate to the one that is fitted: decimation of an over-sampled record behind an anti-alias filter, then
//! the most regular stretch of about a thousand samples.

use super::gate;
use super::preparation::{Denoise, Preparation};
use super::region::{self, Region};
use super::settings::Settings;
use crate::signal::{Row, Window};
use std::f64::consts::PI;

/// Fewest samples in a period that decimation leaves: with fewer, the instants at which the stem slips blur.
const SAMPLES_PER_PERIOD: f64 = 60.0;
/// Number of periods that the window should hold, where the record is long enough: fewer have few slips that share the evidence.
const PERIODS: f64 = 7.0;
/// Largest number of samples that are fitted, as a multiple of the configured window: a fit takes as much longer.
const LONGEST: usize = 4;
/// Number of newest samples to which a longer record is cut: it bounds time and memory.
const MOST_SAMPLES: usize = 200_000;
/// Half-width of the anti-alias filter in output samples: a wider one is sharper, and blurs slips over more of them.
const HALF_WIDTH: usize = 4;

/// Decimates and cuts a window; returns the window that is fitted, with the analysis of its oscillation.
///
/// * `preparation`: receives the decimation, the noise of OP, and the extent of the window.
pub fn prepare(window: Window, settings: &Settings, preparation: &mut Preparation) -> (Window, Region) {
    let n = window.len();
    let mut window = if n > MOST_SAMPLES { window.slice(n - MOST_SAMPLES, n) } else { window };
    let mut region = region::analyse(&window.op);
    let by_period = region.typical_period().map_or(1.0, |p| p / SAMPLES_PER_PERIOD);
    let longest = LONGEST * settings.window_samples.max(1);
    // A record that is short enough keeps every sample, because a filter blurs the instants at which the stem slips.
    let by_length = window.len() as f64 / longest as f64;
    let factor = by_period.min(by_length).floor() as usize;
    if factor > 1 {
        window = decimate(&window, factor);
        region = region::analyse(&window.op);
        preparation.decimation = factor;
    }
    let wanted = region.typical_period().map_or(0.0, |p| PERIODS * p).ceil() as usize;
    let length = wanted.clamp(settings.window_samples, LONGEST * settings.window_samples).min(window.len());
    let from = region.most_regular(window.len(), length);
    if length < window.len() {
        window = window.slice(from, from + length);
        region = region::analyse(&window.op);
    }
    preparation.denoise = Denoise { applied: region.denoised, noise_share: region.noise_share };
    gate::describe(&window, preparation);
    (window, region)
}

/// Every `factor`-th sample of a window, behind a windowed-sinc low pass with its cut-off at 0.4 of the new sampling frequency.
pub fn decimate(w: &Window, factor: usize) -> Window {
    let taps = low_pass(factor);
    let filtered = |v: &Vec<f64>| -> Vec<f64> {
        let reach = taps.len() / 2;
        let last = v.len() as isize - 1;
        (0..v.len() / factor)
            .map(|k| {
                let centre = (k * factor) as isize;
                let at = |j: usize| (centre + j as isize - reach as isize).clamp(0, last) as usize;
                taps.iter().enumerate().map(|(j, tap)| tap * v[at(j)]).sum()
            })
            .collect()
    };
    Window {
        t0: w.t0,
        ts: w.ts * factor as f64,
        op: filtered(&w.op),
        pv: filtered(&w.pv),
        sp: w.sp.as_ref().map(filtered),
        mv: w.mv.as_ref().map(filtered),
        tags: w.tags.iter().map(|(name, v)| (name.clone(), filtered(v))).collect(),
        // The kind of a row is that of most rows about it, because the filter hardly reaches further.
        rows: (0..w.rows.len() / factor).map(|k| majority(about(&w.rows, k * factor, factor))).collect(),
    }
}

/// `factor` rows with row `centre` in the middle; fewer at the ends of the record.
fn about(rows: &[Row], centre: usize, factor: usize) -> &[Row] {
    let from = centre.saturating_sub(factor / 2);
    &rows[from..(centre + factor - factor / 2).min(rows.len())]
}

/// [`Row::Counts`] where more than half of the rows count; else [`Row::Missing`] where any is missing; else [`Row::Silent`].
fn majority(rows: &[Row]) -> Row {
    let count = |worth: Row| rows.iter().filter(|row| **row == worth).count();
    if 2 * count(Row::Counts) > rows.len() {
        Row::Counts
    } else if count(Row::Missing) > 0 {
        Row::Missing
    } else {
        Row::Silent
    }
}

/// Hamming-windowed sinc of unit gain.
fn low_pass(factor: usize) -> Vec<f64> {
    let reach = (HALF_WIDTH * factor) as isize;
    let cutoff = 0.4 / factor as f64;
    let taps: Vec<f64> = (-reach..=reach)
        .map(|j| {
            let t = j as f64;
            let sinc = if j == 0 { 2.0 * cutoff } else { (2.0 * PI * cutoff * t).sin() / (PI * t) };
            sinc * (0.54 + 0.46 * (PI * t / reach as f64).cos())
        })
        .collect();
    let gain: f64 = taps.iter().sum();
    taps.into_iter().map(|tap| tap / gain).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn sine(n: usize, period: f64) -> Vec<f64> {
        (0..n).map(|k| (TAU * k as f64 / period).sin()).collect()
    }

    #[test]
    fn decimation_keeps_the_slow_and_removes_what_would_fold() {
        let slow = sine(4000, 200.0);
        let fast = sine(4000, 7.0);
        let w = Window { ts: 1.0, op: slow.clone(), pv: fast, ..Window::default() };
        let d = decimate(&w, 5);
        assert_eq!((d.len(), d.ts), (800, 5.0));
        for k in 20..780 {
            // The pass band ripple of a Hamming design is 0.2 %; the fast sine lies in its stop band.
            assert!((d.op[k] - slow[5 * k]).abs() < 0.01);
            assert!(d.pv[k].abs() < 0.02);
        }
    }

    #[test]
    fn only_over_sampled_long_records_are_decimated() {
        let prepare_sine = |n: usize, period: f64| {
            let w = Window { ts: 1.0, op: sine(n, period), pv: sine(n, period), ..Window::default() };
            let mut p = Preparation { decimation: 1, ..Preparation::default() };
            let (w, _) = prepare(w, &Settings::default(), &mut p);
            (p.decimation, w.len(), w.ts)
        };
        assert_eq!(prepare_sine(1500, 40.0), (1, 1000, 1.0));
        assert_eq!(prepare_sine(18_000, 250.0), (4, 1000, 4.0));
        assert_eq!(prepare_sine(1500, 250.0), (1, 1500, 1.0));
    }
}
