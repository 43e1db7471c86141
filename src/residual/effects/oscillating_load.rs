//! A periodic load: `sum over h of s_h sin(h w k) + c_h cos(h w k)`, period [s], amplitude [PV].
//!
//! Recognised by the lines of the residual's and PV's spectra; the frequency is then estimated with everything else.

use super::{Context, Proposal, Recognise, best};
use crate::residual::model::{Data, Knob, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};
use crate::sysid::spectrum;
use multiversion::multiversion;
use std::f64::consts::TAU;

/// Harmonics tried.
const HARMONICS: [&[usize]; 3] = [&[1], &[1, 2, 3], &[1, 3, 5, 7, 9]];

/// Samples of one block of a wave.
const BLOCK: usize = 32;

pub struct OscillatingLoad;

/// Angular frequency up to which a harmonic is taken (rad/sample).
const HIGHEST: f64 = 0.9 * TAU / 2.0;

#[derive(Clone, Debug)]
struct Load {
    /// Angular frequency (rad/sample).
    w: f64,
    harmonics: &'static [usize],
    step: f64,
}

impl Load {
    fn shapes(&self, n: usize) -> Vec<Vec<f64>> {
        self.waves().into_iter().flat_map(|w| wave(w, n)).collect()
    }
}

/// `sin(w k)` and `cos(w k)`: a block turned on and on by the angle of a block.
#[multiversion(targets("x86_64+avx2"))]
pub fn wave(w: f64, n: usize) -> [Vec<f64>; 2] {
    let turn = |(s, c): (f64, f64), (by_s, by_c): (f64, f64)| (s * by_c + c * by_s, c * by_c - s * by_s);
    let (mut of_s, mut of_c) = ([0.0; BLOCK], [1.0; BLOCK]);
    let one = w.sin_cos();
    for k in 1..BLOCK {
        (of_s[k], of_c[k]) = turn((of_s[k - 1], of_c[k - 1]), one);
    }
    let (mut sines, mut cosines) = (vec![0.0; n], vec![0.0; n]);
    let (mut at, by) = ((0.0, 1.0), (w * BLOCK as f64).sin_cos());
    for (sines, cosines) in sines.chunks_mut(BLOCK).zip(cosines.chunks_mut(BLOCK)) {
        let (s, c) = at;
        let turned = |of: &mut [f64], by_c: f64, by_s: f64| {
            of.iter_mut().zip(of_c.iter().zip(&of_s)).for_each(|(of, (c, s))| *of = by_c * c + by_s * s);
        };
        turned(sines, s, c);
        turned(cosines, c, -s);
        at = turn(at, by);
    }
    [sines, cosines]
}

impl Term for Load {
    fn kind(&self) -> Kind {
        Kind::OscillatingLoad
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        // The harmonics in use stay in use and the others out, or the columns would change under the fit.
        let edge = |h: &usize| HIGHEST / *h as f64;
        let (inside, outside): (Vec<f64>, Vec<f64>) =
            self.harmonics.iter().map(edge).partition(|edge| self.w < *edge);
        let lowest = outside.into_iter().fold(1e-4, f64::max);
        let highest = inside.into_iter().fold(TAU / 2.0, f64::min) * (1.0 - 1e-9);
        vec![Knob { value: self.w, step: self.step, smooth: true, bounds: (lowest, highest) }]
    }
    fn set(&mut self, _at: usize, value: f64) {
        self.w = value;
    }
    fn waves(&self) -> Vec<f64> {
        let harmonics = self.harmonics.iter().map(|h| *h as f64).filter(|h| self.w < HIGHEST / h);
        harmonics.map(|h| self.w * h).collect()
    }
    fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
        out.extend(self.shapes(data.len()));
    }
    fn slope(&self, _at: usize, gamma: &[f64], shapes: &[Vec<f64>]) -> Option<Vec<f64>> {
        // d/dw (s sin(h w k) + c cos(h w k)) = h k (s cos(h w k) - c sin(h w k)).
        let mut sum = vec![0.0; shapes.first()?.len()];
        let pairs = gamma.as_chunks::<2>().0.iter().zip(shapes.as_chunks::<2>().0);
        for (([s, c], [sine, cosine]), h) in pairs.zip(self.harmonics) {
            let (s, c) = (*h as f64 * s, *h as f64 * c);
            sum.iter_mut()
                .zip(sine.iter().zip(cosine))
                .for_each(|(sum, (sine, cosine))| *sum += s * cosine - c * sine);
        }
        sum.iter_mut().enumerate().for_each(|(k, sum)| *sum *= k as f64);
        Some(sum)
    }
    fn describe(&self, data: &Data, gamma: &[f64], linear: &Linear) -> (Vec<Parameter>, String) {
        let period = TAU / self.w * data.scale.ts;
        let own = gamma.iter().take(2).map(|g| g * g).sum::<f64>().sqrt();
        let [in_pv, in_op] = linear.of_wave(self.w);
        let (amplitude, in_op) = (own * in_pv * data.scale.y, own * in_op * data.scale.u);
        let parameters = vec![
            Parameter { name: "period_s", value: period, unit: "s" },
            Parameter { name: "amplitude", value: amplitude, unit: "PV" },
            Parameter { name: "amplitude_op", value: in_op, unit: "OP" },
            Parameter { name: "harmonics", value: self.harmonics.len() as f64, unit: "-" },
        ];
        let explanation = format!(
            "a load with a period of {period:.4} s drives PV, by {amplitude:.3} if nothing controlled it, whatever the valve does"
        );
        (parameters, explanation)
    }
}

impl Recognise for OscillatingLoad {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let n = c.data.split - c.data.first;
        let resolution = TAU / n as f64;
        let mut lines = peaks(&c.quick.residual(), 5);
        lines.extend(peaks(&c.stage.y[c.data.first..c.data.split], 3));
        let mut out: Vec<Proposal> = Vec::new();
        for w in lines {
            let rate = |w: f64, harmonics: &'static [usize]| -> f64 {
                let shapes = Load { w, harmonics, step: 0.0 }.shapes(c.data.len());
                let refs: Vec<&[f64]> = shapes.iter().map(Vec::as_slice).collect();
                c.quick.with(&refs).0
            };
            let (mut at, mut loss, mut step) = (w, rate(w, HARMONICS[0]), 0.25 * resolution);
            for _ in 0..5 {
                for w in [at - step, at + step] {
                    let tried = rate(w, HARMONICS[0]);
                    if tried < loss {
                        (at, loss) = (w, tried);
                    }
                }
                step *= 0.5;
            }
            for harmonics in HARMONICS {
                if at * harmonics[harmonics.len() - 1] as f64 > 0.9 * TAU / 2.0 {
                    continue;
                }
                let parameters = 1.0 + 2.0 * harmonics.len() as f64;
                let raw = if harmonics.len() == 1 { loss } else { rate(at, harmonics) };
                // Ranked with the columns paid for.
                let loss = raw * (2.0 * parameters / c.rows()).exp();
                let term = Load { w: at, harmonics, step: 0.3 * resolution };
                out.push(Proposal {
                    term: Box::new(term),
                    loss,
                    parameters: 1.0,
                    tried: 0.5 * n as f64,
                    element: None,
                });
            }
        }
        best(out, 2)
    }
}

/// The strongest lines (rad/sample) that fit at least three times into the samples.
fn peaks(v: &[f64], most: usize) -> Vec<f64> {
    let n = v.len();
    let size = (2 * n).next_power_of_two();
    let mean = v.iter().sum::<f64>() / n.max(1) as f64;
    let mut padded = vec![0.0; size];
    for (k, (p, v)) in padded.iter_mut().zip(v).enumerate() {
        // Hann: a strong line must not hide its neighbours.
        *p = (v - mean) * (0.5 - 0.5 * (TAU * k as f64 / n as f64).cos());
    }
    let power = spectrum::power(&mut padded);
    let low = 3 * size / n;
    let mut found: Vec<usize> = (low.max(1)..(power.len() - 1) * 9 / 10)
        .filter(|&i| power[i] >= power[i - 1] && power[i] > power[i + 1])
        .collect();
    found.sort_by(|&a, &b| power[b].total_cmp(&power[a]));
    found.truncate(most);
    found.into_iter().map(|i| TAU * i as f64 / size as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wave_is_sine_and_cosine() {
        for (w, n) in [(0.173, 1000), (2.9, 97), (0.004, 31)] {
            let [sines, cosines] = wave(w, n);
            assert_eq!((sines.len(), cosines.len()), (n, n));
            for k in 0..n {
                let (s, c) = (w * k as f64).sin_cos();
                // Rounding of an angle of some hundred turns.
                assert!((sines[k] - s).abs() < 1e-11 && (cosines[k] - c).abs() < 1e-11);
            }
        }
    }
}
