//! The spectra of all loops on common grids of time, with the coherence of two loops in a band.
//!
//! ```text
//! S_ij = sum over the band of X_i[f] conj(X_j[f])      gamma² = |S_ij|² / (S_ii S_jj)
//! ```
//!
//! X_i: spectrum of PV of loop i without its trend; gamma²: coherence (-). By Parseval's theorem S_ij is the mean product of the two
//! band-passed signals. So two loops stay coherent where their period varies in the same way, and two loops that oscillate
//! independently do not. Harmonics and different sampling leave it as it is: PV is interpolated, which keeps oscillations of four
//! samples and more, and low-passed where a loop is sampled much faster than the grid.
//!
//! A grid has at most 8,192 steps. Where most loops are sampled faster than its steps, it compares periods of at least five steps, of
//! a low-passed PV. Shorter periods are compared on a second grid with the steps of the samples, over the latest time that 8,192 of
//! them cover.
//!
//! Source: Bendat & Piersol, Random Data, 2010, section 5.2 (coherence).

use super::PlantLoop;
use super::window::points::{Grid, THINNED, low_passed};
use crate::signal::Window;
use crate::sysid::spectrum::Transforms;
use crate::sysid::stats::{mean, median};
use nalgebra::Complex;
use std::f64::consts::PI;
use std::ops::{Range, RangeInclusive};

/// Fewest samples of a loop.
const LEAST: usize = 60;
/// Most steps of a grid.
const MOST: f64 = 8192.0;
/// Steps in the shortest period that is compared on a grid coarser than the samples: the low-pass filter keeps nine tenths of the
/// amplitude from five steps on.
const FASTEST: f64 = 5.0;
/// Samples per step up to which a loop is interpolated and not low-passed, on a grid with the steps of most loops. The rates in
/// `docs/plantwide.md` were measured so, with 2 and 4 samples per step.
const INTERPOLATED: f64 = 4.0;
/// Ratio of the limits of a band to its middle.
const NARROW: f64 = 1.15;
/// Share of a signal that is tapered at either end.
const TAPER: f64 = 0.05;
/// Share of the time of a grid that a record may lack at either end.
const LACKS: f64 = 0.1;
/// Most grids: each costs another pass over all loops.
const MOST_GRIDS: usize = 4;

/// The time that a window covers, and its sample period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Time of the first sample (s).
    t0: f64,
    /// Sample period (s).
    ts: f64,
    samples: usize,
    /// Whether it has enough samples, and all of them are finite.
    usable: bool,
}

impl Span {
    /// The span of a window's PV.
    pub fn of(w: &Window) -> Self {
        let usable =
            w.ts > 0.0 && w.pv.len() > LEAST && w.pv.iter().all(|x| x.is_finite()) && w.t0.is_finite();
        Self { t0: w.t0, ts: w.ts, samples: w.pv.len(), usable }
    }

    fn length(&self) -> f64 {
        self.ts * (self.samples as f64 - 1.0)
    }

    fn end(&self) -> f64 {
        self.t0 + self.length()
    }
}

/// The spectrum of one loop, in single precision, because those of all loops are kept at once.
struct Bins {
    x: Vec<Complex<f32>>,
    /// Sum of the squares of all bins but the first.
    power: f64,
}

/// The spectra of all loops.
pub struct Spectra {
    /// Period of the grid (s).
    pub ts: f64,
    /// Samples of the grid.
    pub n: usize,
    /// Beginning of the grid (s).
    from: f64,
    /// End of the grid (s).
    to: f64,
    /// Median sample period of the loops for which it was made (s).
    sampling: f64,
    /// Periods that are compared on it (s).
    periods: Range<f64>,
    /// Length of the transforms; 0 where no loop can be used.
    m: usize,
    of: Vec<Option<Bins>>,
}

impl Spectra {
    /// The grid of the median sample period over the time that most loops share; the loops are added one after the other.
    pub fn new(spans: &[Span]) -> Self {
        let usable: Vec<&Span> = spans.iter().filter(|span| span.usable).collect();
        let of = |f: &dyn Fn(&Span) -> f64| median(&usable.iter().map(|span| f(span)).collect::<Vec<f64>>());
        let time = (of(&|span| span.t0), of(&Span::end));
        Self::between(time, of(&|span| span.ts), 0.0..f64::INFINITY)
    }

    /// A grid over a time (s), in steps of `sampling` (s) and not too many of them.
    fn between((from, to): (f64, f64), sampling: f64, periods: Range<f64>) -> Self {
        let ts = sampling.max((to - from) / MOST);
        let n = if ts > 0.0 { ((to - from) / ts) as usize + 1 } else { 0 };
        Self { ts, n, from, to, sampling, periods, m: 0, of: Vec::new() }
    }

    /// Whether its steps are longer than the time between two samples.
    fn is_coarse(&self) -> bool {
        self.ts > THINNED * self.sampling
    }

    /// The grid for the periods that are too fast for this one, which then compares the others only; none where this grid has the steps
    /// of the samples.
    fn refined(&mut self) -> Option<Self> {
        self.is_coarse().then(|| {
            let border = FASTEST * self.ts;
            self.periods = border..f64::INFINITY;
            Self::between((self.to - MOST * self.sampling, self.to), self.sampling, 0.0..border)
        })
    }

    /// Whether a period (s) is compared on it.
    pub fn compares(&self, period_s: f64) -> bool {
        self.periods.contains(&period_s)
    }

    /// The time that every loop on the grid covers.
    pub fn covered(&self) -> (f64, f64) {
        let lacks = LACKS * (self.to - self.from);
        (self.from + lacks, self.to - lacks)
    }

    /// Whether a record of this span has a place on the grid: it must cover the time of the grid.
    fn is_covered_by(&self, span: &Span) -> bool {
        let (from, to) = self.covered();
        span.usable && span.t0 <= from && span.end() + span.ts >= to
    }

    /// Brings the next loop to the grid. Its window may have moved on since `span` was taken.
    pub fn add(&mut self, span: &Span, w: &Window, transforms: &mut Transforms) {
        let still = self.is_covered_by(span) && self.n > LEAST && Span::of(w).usable;
        let x = if still { self.prepared(w) } else { Vec::new() };
        let bins = (!x.is_empty()).then(|| {
            let spectrum = transforms.spectrum(&x);
            self.m = spectrum.m;
            let power = power(&spectrum.bins[1..]);
            let narrow = |x: &Complex<f64>| Complex::new(x.re as f32, x.im as f32);
            Bins { x: spectrum.bins.iter().map(narrow).collect(), power }
        });
        self.of.push(bins);
    }

    /// PV on the grid, without its trend, in standard deviations, its ends tapered; empty where it does not move.
    fn prepared(&self, w: &Window) -> Vec<f64> {
        let mut x = self.on_grid(w);
        let n = self.n;
        let (middle, level) = (0.5 * (n - 1) as f64, mean(&x));
        let square: f64 = (0..n).map(|k| (k as f64 - middle).powi(2)).sum();
        let slope =
            x.iter().enumerate().map(|(k, x)| (k as f64 - middle) * (x - level)).sum::<f64>() / square;
        x.iter_mut().enumerate().for_each(|(k, x)| *x -= level + slope * (k as f64 - middle));
        let spread = (x.iter().map(|x| x * x).sum::<f64>() / n as f64).sqrt();
        if !(spread.is_finite() && spread > 1e-12 * level.abs().max(f64::MIN_POSITIVE)) {
            return Vec::new();
        }
        let edge = ((TAPER * n as f64) as usize).max(1);
        for (k, x) in x.iter_mut().enumerate() {
            let near = k.min(n - 1 - k);
            let weight =
                if near < edge { 0.5 - 0.5 * (PI * (near as f64 + 0.5) / edge as f64).cos() } else { 1.0 };
            *x *= weight / spread;
        }
        x
    }

    /// PV at the steps of the grid: interpolated, or low-passed.
    fn on_grid(&self, w: &Window) -> Vec<f64> {
        if self.ts > w.ts * if self.is_coarse() { THINNED } else { INTERPOLATED } {
            let points = w.pv.iter().enumerate().map(|(k, x)| (w.t0 + k as f64 * w.ts, *x));
            let grid = Grid { from: self.from, ts: self.ts, rows: 0..self.n };
            return low_passed(&points.collect::<Vec<(f64, f64)>>(), &grid, w.ts);
        }
        let last = (w.pv.len() - 1) as f64;
        let at = |k: usize| {
            let x = ((self.from + k as f64 * self.ts - w.t0) / w.ts).clamp(0.0, last);
            let (before, part) = (x as usize, x.fract());
            w.pv[before] + part * (w.pv[(before + 1).min(w.pv.len() - 1)] - w.pv[before])
        };
        (0..self.n).map(at).collect()
    }

    /// The spectra of a few loops at once, over the shortest time that two of them have in common and in which a period (s) is
    /// compared.
    pub fn of(plant: &[PlantLoop], period_s: f64) -> Self {
        let spans: Vec<Span> = plant.iter().map(|of| Span::of(&of.window)).collect();
        let shortest = grids(&spans).into_iter().rev().find(|grid| grid.compares(period_s));
        let (mut own, mut transforms) = (shortest.unwrap_or_else(|| Self::new(&spans)), Transforms::new());
        spans.iter().zip(plant).for_each(|(span, of)| own.add(span, &of.window, &mut transforms));
        own
    }

    /// Length of the transforms; 0 where no loop can be used.
    pub fn m(&self) -> usize {
        self.m
    }

    /// The bins of the band around a period (s).
    pub fn band(&self, period_s: f64) -> RangeInclusive<usize> {
        let m = self.m() as f64;
        let f = self.ts / period_s;
        let last = (0.5 * m) as usize;
        ((m * f / NARROW) as usize).clamp(1, last.max(1))..=((m * f * NARROW).ceil() as usize).min(last)
    }

    /// The spectrum of a loop in a band; none where the loop cannot be used.
    pub fn inside(&self, of: usize, band: &RangeInclusive<usize>) -> Option<&[Complex<f32>]> {
        self.of[of].as_ref()?.x.get(band.clone())
    }

    /// Share of a loop's variance in a band (0..1).
    pub fn share(&self, of: usize, band: &RangeInclusive<usize>) -> f64 {
        let Some(own) = &self.of[of] else { return 0.0 };
        power(own.x.get(band.clone()).unwrap_or_default()) / own.power.max(f64::MIN_POSITIVE)
    }

    /// The power spectrum of a loop: (period (s), share of the variance per bin) from slow to fast.
    pub fn power(&self, of: usize) -> Vec<(f64, f64)> {
        let Some(own) = &self.of[of] else { return Vec::new() };
        let period = |j: usize| self.m as f64 * self.ts / j as f64;
        let share = |x: &Complex<f32>| wide(*x).norm_sqr() / own.power;
        own.x.iter().enumerate().skip(1).map(|(j, x)| (period(j), share(x))).collect()
    }

    /// Whole spectrum of a loop.
    pub fn spectrum(&self, of: usize) -> Option<&[Complex<f32>]> {
        self.of[of].as_ref().map(|own| own.x.as_slice())
    }
}

/// The grids, without spectra yet, the one for the longest records first. Every loop that can be compared with another has a place on
/// one of them.
///
/// On a single grid, loops with shorter records than most would have no place, and of loops with longer ones a part would be lost.
/// So the first grid is made for the records at least half as long as the longest, the next for such records among those without a
/// place, and so on. Longer records have a place on the later grids, too.
pub fn grids(spans: &[Span]) -> Vec<Spectra> {
    let mut left: Vec<Span> = spans.iter().filter(|span| span.usable).copied().collect();
    let mut grids = Vec::new();
    while !left.is_empty() && grids.len() < MOST_GRIDS {
        let half = 0.5 * left.iter().map(Span::length).fold(0.0, f64::max);
        let class: Vec<Span> = left.iter().filter(|span| span.length() >= half).copied().collect();
        let mut grid = Spectra::new(&class);
        let before = left.len();
        left.retain(|span| !grid.is_covered_by(span));
        if left.len() == before {
            // These records have no common time: they get no grid.
            left.retain(|span| span.length() < half);
        } else if spans.iter().filter(|span| grid.is_covered_by(span)).count() > 1 {
            let fine = grid.refined();
            grids.push(grid);
            grids.extend(fine);
        }
    }
    grids
}

/// A bin in double precision, in which all sums are computed.
pub(super) fn wide<T: Copy + Into<f64>>(x: Complex<T>) -> Complex<f64> {
    Complex::new(x.re.into(), x.im.into())
}

/// Sum of the squares.
pub fn power<T: Copy + Into<f64>>(x: &[Complex<T>]) -> f64 {
    x.iter().map(|x| wide(*x).norm_sqr()).sum()
}

/// The coherence gamma² of two loops in a band (-), and S_ij. `a`, `b`: their bins in the band.
pub fn coherence(a: &[Complex<f32>], b: &[Complex<f32>]) -> (f64, Complex<f64>) {
    let cross: Complex<f64> = a.iter().zip(b).map(|(a, b)| wide(*a) * wide(*b).conj()).sum();
    let both = power(a) * power(b);
    (if both > 0.0 { cross.norm_sqr() / both } else { 0.0 }, cross)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::lag::delay;
    use std::f64::consts::TAU;

    fn loops(signals: &[Vec<f64>], ts: &[f64]) -> Vec<PlantLoop> {
        let of = |(pv, ts): (&Vec<f64>, &f64)| PlantLoop {
            window: Window { ts: *ts, op: pv.clone(), pv: pv.clone(), ..Window::default() },
            ..PlantLoop::default()
        };
        signals.iter().zip(ts).map(of).collect()
    }

    #[test]
    fn a_wave_in_two_samplings_is_coherent_and_its_delay_is_measured() {
        // The period wanders, so that the delay shows in the band's phase.
        let phase = |t: f64| t / 600.0 + 0.2 * (TAU * t / 9000.0).sin();
        let wave = |ts: f64, late: f64| -> Vec<f64> {
            (0..(86_400.0 / ts) as usize).map(|k| (TAU * phase(k as f64 * ts - late)).sin()).collect()
        };
        let plant = loops(&[wave(60.0, 0.0), wave(30.0, 90.0), wave(120.0, 0.0)], &[60.0, 30.0, 120.0]);
        let spectra = Spectra::of(&plant, 600.0);
        let band = spectra.band(600.0);
        let x: Vec<&[Complex<f32>]> = (0..3).filter_map(|i| spectra.inside(i, &band)).collect();
        assert!(coherence(x[0], x[1]).0 > 0.95 && coherence(x[0], x[2]).0 > 0.95);
        let hz = 1.0 / (spectra.ts * spectra.m() as f64);
        let (late, _) = delay(x[0], x[1], hz);
        // Weighted phases of a band that is cut off: a tenth of the delay.
        assert!((late - 90.0).abs() < 20.0, "{late}");
        assert!((0..3).all(|i| spectra.share(i, &band) > 0.8));
    }

    #[test]
    fn every_span_has_a_grid_and_equal_ones_share_it() {
        let span = |end: f64, hours: f64, ts: f64| Span {
            t0: end - 3600.0 * hours,
            ts,
            samples: (3600.0 * hours / ts) as usize + 1,
            usable: true,
        };
        let day = vec![span(1e6, 24.0, 60.0); 30];
        assert_eq!(grids(&day).iter().map(|grid| grid.n).collect::<Vec<usize>>(), [1441]);
        // Rings of as many samples at 10 s and at 1 s, most of them slow.
        let mut mixed = vec![span(1e6, 11.4, 10.0); 100];
        mixed.extend(vec![span(1e6, 1.14, 1.0); 80]);
        let found = grids(&mixed);
        assert_eq!(found.iter().map(|grid| grid.ts).collect::<Vec<f64>>(), [10.0, 1.0]);
        let places = |grid: &Spectra| mixed.iter().filter(|span| grid.is_covered_by(span)).count();
        assert_eq!(found.iter().map(places).collect::<Vec<usize>>(), [100, 180]);
        // Who is alone is compared with nobody, and rubbish has no span.
        assert!(grids(&[span(1e6, 24.0, 60.0), span(1e5, 24.0, 60.0)]).is_empty());
        assert!(grids(&[Span { usable: false, ..span(1e6, 24.0, 60.0) }]).is_empty());
    }

    #[test]
    fn what_is_too_fast_for_a_grid_has_one_of_its_own_and_does_not_fold() {
        // 20,000 samples at 5 s are 8,192 steps of 12.2 s, on which 18 s would fold to 38 s.
        let both = |t: f64| (TAU * t / 18.0).sin() + 0.2 * (TAU * t / 2000.0).sin();
        let wave: Vec<f64> = (0..20_000).map(|k| both(5.0 * f64::from(k))).collect();
        let mut plant = loops(&[wave.clone(), wave], &[5.0, 5.0]);
        let spans: Vec<Span> = plant.iter().map(|of| Span::of(&of.window)).collect();
        let mut found = grids(&spans);
        let mut transforms = Transforms::new();
        for grid in &mut found {
            spans.iter().zip(&plant).for_each(|(span, of)| grid.add(span, &of.window, &mut transforms));
        }
        let compared = |grid: &Spectra| [18.0, 60.0, 62.0, 2000.0].map(|period| grid.compares(period));
        let [coarse, fine] = &found[..] else { panic!("{} grids", found.len()) };
        assert_eq!(
            (compared(coarse), compared(fine)),
            ([false, false, true, true], [true, true, false, false])
        );
        assert!((coarse.ts - 12.2).abs() < 0.1 && (fine.ts - 5.0).abs() < 1e-9, "{} {}", coarse.ts, fine.ts);
        for (grid, period) in [(coarse, 2000.0), (fine, 18.0)] {
            let share = grid.share(0, &grid.band(period));
            assert!(share > 0.9, "{period}: {share}");
        }
        assert_eq!(Spectra::of(&plant, 18.0).ts, fine.ts);
        assert_eq!(Spectra::of(&plant, 2000.0).ts, coarse.ts);
        // One loop that is much faster than the others: at 1 s, 18 s is a wave of 3.6 steps on their grid.
        let fast: Vec<f64> = (0..5000).map(|k| both(f64::from(k))).collect();
        let slow: Vec<f64> = (0..1000).map(|k| both(5.0 * f64::from(k))).collect();
        plant = loops(&[fast, slow.clone(), slow.clone(), slow], &[1.0, 5.0, 5.0, 5.0]);
        plant[0].window.pv.iter_mut().enumerate().for_each(|(k, x)| *x += (TAU * k as f64 / 5.05).sin());
        let spectra = Spectra::of(&plant, 18.0);
        // 5.05 s would fold to 505 s.
        assert!(spectra.ts == 5.0 && spectra.share(0, &spectra.band(505.0)) < 0.01);
    }

    #[test]
    fn rubbish_is_in_no_spectrum() {
        let plant = loops(&[vec![], vec![1.0; 500], vec![f64::NAN; 500]], &[1.0, 1.0, 1.0]);
        let spectra = Spectra::of(&plant, 10.0);
        assert!((0..3).all(|i| spectra.inside(i, &spectra.band(10.0)).is_none()));
    }
}
