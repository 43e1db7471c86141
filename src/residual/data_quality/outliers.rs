//! Outliers: single wrong samples of PV. They do not count, and are interpolated.
//!
//! ```text
//! wrong  with probability m/N:      y[k] uniform over PV's range R
//! right  with probability 1 - m/N:  y[k] = what the high-order ARX predicts + e[k],   e of Student's t
//! ```
//!
//! The mixture decides which of the N samples are the m wrong ones. Taking a sample for wrong has a penalty of `ln(N/m) + ln R`, and
//! loses the likelihood of that sample. It gains the likelihood of the next sixteen samples, whose lags the sample spoils. Two other
//! causes look alike. A shock to the process spoils no later sample, and these are predicted worse from an interpolated one. Noise in
//! bursts makes many samples look wrong, all at the same time. So each wrong sample must be likelier than a right one, and all
//! together must be likelier than none, than shocks and than bursts.
//!
//! Sources: Box & Tiao, Biometrika 1968, 55, 119; Chang, Tiao & Chen, Technometrics 1988, 30, 193.

use super::fact::{Fact, TOLD, bridge, log_density, posterior};
use super::quantised::error_of;
use crate::residual::findings::{Described, Kind};
use crate::signal::told;
use crate::sysid::arx::{Arx, ArxFit, LAGS_X, LAGS_Y};
use crate::sysid::criterion::{REGULAR, log_sum, score};
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::stats::{mean, range};
use crate::sysid::student::{self, FREEDOM};
use std::ops::Range;

/// Distance from both neighbours, in scales of PV's changes, from which a sample is left out of the first fit. A few right samples
/// are so far away, and a fit can spare them.
const FAR: f64 = 4.0;
/// Rows with one scale of the noise, where it comes in bursts: enough to estimate it, and no more than a burst lasts.
const BLOCK: usize = 2 * LONGEST_LAG;
/// Most rounds of choosing samples and fitting: the choice mostly settles in three.
const ROUNDS: usize = 6;

/// Finds wrong samples, interpolates them, and takes them out. `stem`: the likeliest stem of a record; `step`: the quantum of PV as
/// recorded.
pub fn assess(data: &mut IdData, stem: &dyn Fn(&IdData) -> Vec<f64>, step: f64) -> Option<Fact> {
    let x = stem(data);
    let (at, log_odds) = wrong(data, &x, step)?;
    let posterior = posterior(log_odds);
    if posterior < TOLD {
        return None;
    }
    let described = describe(data, &at);
    take_out(data, &at);
    Some(Fact { kind: Kind::Outliers, posterior, described })
}

fn describe(data: &IdData, at: &[usize]) -> Described {
    let off = |k: usize| (data.y[k] - data.y[k - 1]).abs().min((data.y[k] - data.y[k + 1]).abs());
    let size = mean(&at.iter().map(|k| off(*k)).collect::<Vec<f64>>()) * data.units.y;
    let said = match at.len() {
        1 => format!("1 sample of PV is off by {}", told(size)),
        several => format!("{several} samples of PV are off by {} on average", told(size)),
    };
    Described::new(said)
        .with("count", at.len() as f64, "-")
        .with("share", at.len() as f64 / data.len() as f64, "-")
        .with("size", size, "PV")
}

/// Interpolates these samples, and sets their weights to 0.
fn take_out(data: &mut IdData, at: &[usize]) {
    for &k in at {
        bridge(&mut data.y, k, k + 1);
        data.weight[k] = 0.0;
    }
}

/// Logarithm of the probability of one choice of `m` wrong samples out of `n`: `m ln(m/n) + (n - m) ln(1 - m/n)`.
fn choice(m: f64, n: f64) -> f64 {
    let part = |m: f64| if m > 0.0 { m * (m / n).ln() } else { 0.0 };
    part(m) + part(n - m)
}

/// Samples far beyond both their neighbours: they are left out of the first fit. The controller answers a wrong sample, so that a fit
/// to it would explain it by OP.
fn peaks(data: &IdData, step: f64) -> Vec<usize> {
    let y = &data.y;
    let changes: Vec<f64> = y.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let ones = vec![1.0; changes.len()];
    let far =
        FAR * student::scale(&changes, &ones, student::first_scale(&changes, &ones), FREEDOM, error_of(step));
    let beyond = |k: &usize| {
        let (before, after) = (y[*k] - y[k - 1], y[*k] - y[k + 1]);
        before * after > 0.0 && before.abs().min(after.abs()) > far && data.weight[*k] > 0.0
    };
    (data.start.index + LAGS_Y..y.len() - 1).filter(beyond).collect()
}

/// The wrong samples, and the log odds that there are any; `None` where there are none. `x`: the stem.
fn wrong(data: &IdData, x: &[f64], step: f64) -> Option<(Vec<usize>, f64)> {
    let fit = |data: &IdData| {
        let mut fit = Arx::new(data, &data.y, &[]).fit(x, None);
        // The scale is no less than that of rounding PV to its quantum.
        let own = &data.weight[data.rows()];
        // The degrees of freedom are fixed: with estimated ones, wrong samples would make heavy tails, and hide in them.
        fit.scale = student::scale(&fit.e, own, fit.scale, FREEDOM, error_of(step));
        let weight = &data.weight[data.rows()];
        fit.log_likelihood = student::log_likelihood(&fit.e, weight, fit.scale, FREEDOM);
        fit
    };
    let plain = fit(data);
    let (low, high) = range(&data.y);
    let density = -(high - low).ln();
    let without = |at: &[usize]| {
        let mut repaired = data.clone();
        take_out(&mut repaired, at);
        repaired
    };
    let mut at = peaks(data, step);
    let mut best = if at.is_empty() { plain.clone() } else { fit(&without(&at)) };
    for _ in 0..ROUNDS {
        let next = Samples { data, x, fit: &best, density }.choose(&at);
        if next == at {
            break;
        }
        at = next;
        best = fit(&without(&at));
    }
    let rows = data.rows();
    let m = at.iter().filter(|k| rows.contains(k)).count() as f64;
    if m == 0.0 {
        return None;
    }
    // A rival, shocks: the same samples do not count, but the next samples are predicted from their measured values.
    let shocks = IdData { y: data.y.clone(), ..without(&at) };
    let n = data.counted();
    let apart = |fit: &ArxFit| score(fit.log_likelihood + m * density + choice(m, n), REGULAR, 1.0, n);
    let of_bursts = bursts(&plain, &data.weight[rows]);
    let rivals =
        [score(plain.log_likelihood, 0.0, 1.0, n), apart(&fit(&shocks)), score(of_bursts, REGULAR, 1.0, n)];
    Some((at, apart(&best) - log_sum(rivals.into_iter())))
}

/// Log-likelihood of noise in bursts: each block of rows has one of two scales (-).
fn bursts(fit: &ArxFit, weight: &[f64]) -> f64 {
    let blocks: Vec<(&[f64], &[f64])> = fit.e.chunks(BLOCK).zip(weight.chunks(BLOCK)).collect();
    let rated =
        |(e, weight): &(&[f64], &[f64]), scale: f64| student::log_likelihood(e, weight, scale, FREEDOM);
    let mut scales = [0.5, 2.0].map(|by| by * fit.scale);
    for _ in 0..ROUNDS {
        let small = |block: &&(&[f64], &[f64])| rated(block, scales[0]) > rated(block, scales[1]);
        let (quiet, loud): (Vec<_>, Vec<_>) = blocks.iter().partition(small);
        let own = |of: &[&(&[f64], &[f64])], scale: f64| {
            let e: Vec<f64> = of.iter().flat_map(|block| block.0).copied().collect();
            let weight: Vec<f64> = of.iter().flat_map(|block| block.1).copied().collect();
            if e.is_empty() { scale } else { student::scale(&e, &weight, scale, FREEDOM, 0.0) }
        };
        scales = [own(&quiet, scales[0]), own(&loud, scales[1])];
    }
    let each = blocks.iter().map(|block| rated(block, scales[0]).max(rated(block, scales[1])));
    each.sum::<f64>() - blocks.len() as f64 * 2f64.ln()
}

/// The samples of a record under one model.
struct Samples<'a> {
    data: &'a IdData,
    x: &'a [f64],
    fit: &'a ArxFit,
    /// Log-density of a wrong sample.
    density: f64,
}

impl Samples<'_> {
    /// The samples that are likelier wrong than right. Those in `at` are taken for wrong first. The others follow in the order of their
    /// gains, because a wrong sample spoils the errors of its neighbours until it is interpolated.
    fn choose(&self, at: &[usize]) -> Vec<usize> {
        let mut y = self.data.y.clone();
        at.iter().for_each(|k| bridge(&mut y, *k, k + 1));
        let mut at = at.to_vec();
        let n = self.data.counted();
        let log_prior = |m: usize| choice(m as f64 + 1.0, n) - choice(m as f64, n) + self.density;
        let all = self.data.start.index + LAGS_Y..y.len() - 1;
        let mut gains: Vec<f64> = vec![f64::NEG_INFINITY; y.len()];
        all.clone().for_each(|k| gains[k] = self.gain(&y, k));
        loop {
            let free = |k: &usize| !at.contains(k);
            let most = all.clone().filter(free).max_by(|a, b| gains[*a].total_cmp(&gains[*b]));
            let Some(k) = most.filter(|k| gains[*k] + log_prior(at.len()) > 0.0) else { break };
            at.push(k);
            bridge(&mut y, k, k + 1);
            let near = k.saturating_sub(LAGS_Y + 1).max(all.start)..(k + LAGS_Y + 2).min(all.end);
            near.for_each(|k| gains[k] = self.gain(&y, k));
        }
        // A sample that seemed wrong beside the others may be right now.
        let mut kept = at.clone();
        for k in at {
            y[k] = self.data.y[k];
            if self.gain(&y, k) + log_prior(kept.len() - 1) > 0.0 {
                bridge(&mut y, k, k + 1);
            } else {
                kept.retain(|other| *other != k);
            }
        }
        kept.sort_unstable();
        kept
    }

    /// Log-likelihood gained where sample `k` of `y` is taken for wrong: it does not count, and is interpolated (-).
    fn gain(&self, y: &[f64], k: usize) -> f64 {
        let peak = (y[k] - y[k - 1]) * (y[k] - y[k + 1]) > 0.0;
        if !peak || self.data.weight[k] == 0.0 {
            return f64::NEG_INFINITY;
        }
        let own = self.log_density_of(self.error(y, k));
        let off = y[k] - 0.5 * (y[k - 1] + y[k + 1]);
        let next = 1..(LAGS_Y + 1).min(y.len() - k);
        let after: f64 = next
            .map(|lag| {
                let e = self.error(y, k + lag);
                let bridged = e + self.fit.theta[lag - 1] * off;
                self.data.weight[k + lag] * (self.log_density_of(bridged) - self.log_density_of(e))
            })
            .sum();
        after - own
    }

    /// Logarithm of the density of an error.
    fn log_density_of(&self, e: f64) -> f64 {
        log_density(e, self.fit.scale)
    }

    /// The one-step error of sample `k`.
    fn error(&self, y: &[f64], k: usize) -> f64 {
        let theta = &self.fit.theta;
        let of = |lags: Range<usize>, theta: &[f64], v: &[f64]| -> f64 {
            lags.zip(theta).map(|(lag, theta)| theta * v[k - lag]).sum()
        };
        y[k] - of(1..LAGS_Y + 1, theta, y) - theta[LAGS_Y] - of(1..LAGS_X + 1, &theta[LAGS_Y + 1..], self.x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Window;
    use crate::sysid::valve::Start;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// PV behind a stem that swings it far beyond its noise of 0.05, and that stem: with wrong samples of PV, shocks, and turns
    /// that the stem takes a sample later than the model's.
    fn loop_of(wrong: impl Fn(usize) -> f64, shock: impl Fn(usize) -> f64, late: bool) -> (IdData, Vec<f64>) {
        let n = 1500;
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(2));
        let op: Vec<f64> = (0..n).map(|k| 5.0 * (0.03 * k as f64).sin() + (0.031 * k as f64).cos()).collect();
        let stem: Vec<f64> = op.iter().map(|u| (u / 2.0).round() * 2.0).collect();
        let mut x = 0.0;
        let pv = |k: usize| {
            let mut draw = || -> f64 { noise.next().unwrap_or(0.0) };
            x = 0.7 * x
                + 0.3 * stem[k.saturating_sub(1 + usize::from(late && k.is_multiple_of(3)))]
                + shock(k)
                + 0.05 * draw();
            x + wrong(k)
        };
        let window = Window { ts: 1.0, pv: (0..n).map(pv).collect(), op, ..Window::default() };
        let data = IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough");
        let stem = stem.iter().map(|x| (x - data.units.u0) / data.units.u).collect();
        (data, stem)
    }

    fn told((mut data, stem): (IdData, Vec<f64>)) -> Vec<usize> {
        assess(&mut data, &|_| stem.clone(), 0.0);
        (0..data.len()).filter(|k| data.weight[*k] == 0.0).collect()
    }

    /// Every 113th sample.
    fn some(k: usize, size: f64) -> f64 {
        if k % 113 == 60 { if k.is_multiple_of(2) { size } else { -size } } else { 0.0 }
    }

    #[test]
    fn wrong_samples_are_told_from_shocks_and_from_late_turns() {
        let none = |_| 0.0;
        // Ten standard deviations of the noise, a twentieth of PV's swing.
        let found = told(loop_of(|k| some(k, 0.5), none, false));
        let right: Vec<usize> = (0..1500).filter(|k| some(*k, 1.0) != 0.0).collect();
        assert_eq!(found, right);
        assert_eq!(told(loop_of(none, none, false)), []);
        assert_eq!(told(loop_of(none, |k| some(k, 0.5), false)), [], "shocks");
        assert_eq!(told(loop_of(none, none, true)), [], "late turns");
    }

    #[test]
    fn wrong_samples_are_bridged_and_described() {
        let (mut data, stem) = loop_of(|k| some(k, 3.0), |_| 0.0, false);
        let fact = assess(&mut data, &|_| stem.clone(), 0.0).expect("plain");
        assert!((data.y[173] - 0.5 * (data.y[172] + data.y[174])).abs() < 1e-12);
        let value = |name| fact.described.parameters.iter().find(|p| p.name == name).map_or(0.0, |p| p.value);
        assert_eq!((value("count"), value("share")), (13.0, 13.0 / 1500.0));
        assert!((value("size") - 3.0).abs() < 0.3, "{}", value("size"));
    }

    #[test]
    fn a_choice_costs_its_entropy() {
        assert_eq!(choice(0.0, 100.0), 0.0);
        assert!((choice(1.0, 2.0) - 2.0 * 0.5f64.ln()).abs() < 1e-15);
    }
}
