//! The dead time changes at some time: `z[k - d]` from t on (or until t, where it becomes shorter), time and change [s].

use super::load_step::{ALIKE, MARGIN};
use super::{Context, Proposal, Recognise, best};
use crate::residual::evidence::spread;
use crate::residual::model::{Data, Knob, Linear, Term};
use crate::residual::regress::{LONG_Y, Quick};
use crate::residual::{Kind, Parameter};
use std::ops::Range;

/// Longest change (samples).
const LONGEST: i32 = 8;
/// Shares of the fitted samples that may know one delay only.
const PARTS: [f64; 2] = [0.35, 0.6];
/// Lags of the stem about the model's delay.
const BEFORE: usize = 5;
const AFTER: usize = 7;
/// Changes sought once more with the dynamics estimated with them, and how many samples earlier than those the delay may be.
const CLOSER: usize = 3;
const EARLIER: i32 = 3;
/// Changes rated with the dynamics estimated anew.
const MOST: usize = 8;
/// Least change that counts (samples).
const LEAST: f64 = 1.5;

pub struct DeadTimeChange;

#[derive(Clone, Debug)]
struct Change {
    at: f64,
    /// Samples more from `at` on; negative: less.
    more: f64,
    bounds: (f64, f64),
}

impl Term for Change {
    fn kind(&self) -> Kind {
        Kind::DeadTimeChange
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![
            Knob { value: self.at, step: 4.0, smooth: false, bounds: self.bounds },
            Knob { value: self.more, step: 1.0, smooth: false, bounds: (-20.0, 20.0) },
        ]
    }
    fn set(&mut self, at: usize, value: f64) {
        if at == 0 {
            self.at = value.round();
        } else {
            self.more = value;
        }
    }
    fn changes_stem(&self) -> bool {
        true
    }
    fn delays(&self) -> Option<(usize, [usize; 2])> {
        let by = self.more.abs().round() as usize;
        Some((self.at as usize, if self.more >= 0.0 { [0, by] } else { [by, 0] }))
    }
    fn stem(&self, _data: &Data, z: &mut [f64]) {
        let at = (self.at as usize).min(z.len());
        // The shorter of the two delays is the linear part's own: a longer one can be added, not taken away.
        let (range, by) = if self.more >= 0.0 { (at..z.len(), self.more) } else { (0..at, -self.more) };
        let (whole, part) = (by.floor() as usize, by.fract());
        let old = z.to_vec();
        for k in range {
            let (a, b) = (old[k.saturating_sub(whole)], old[k.saturating_sub(whole + 1)]);
            z[k] = a + part * (b - a);
        }
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let time = data.scale.t0 + self.at * data.scale.ts;
        let change = self.more * data.scale.ts;
        let parameters = vec![
            Parameter { name: "time_s", value: time, unit: "s" },
            Parameter { name: "change_s", value: change, unit: "s" },
        ];
        (parameters, format!("from {time:.1} s on the dead time is {change:.4} s longer"))
    }
}

impl Recognise for DeadTimeChange {
    fn plausible(&self, term: &dyn Term) -> bool {
        // A change of about one sample is what any error in the dynamics looks like.
        term.kind() != Kind::DeadTimeChange || term.knobs()[1].value.abs() >= LEAST
    }
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let margin = MARGIN.max((c.data.split - c.data.first) / 12);
        let (from, to) = (c.data.first + margin, c.data.split.saturating_sub(margin));
        let tried = f64::from(2 * LONGEST) * to.saturating_sub(from) as f64 / ALIKE;
        let bounds = (from as f64, to as f64);
        let rate = |(at, more): (usize, i32)| -> (f64, Quick, Change) {
            let term = Change { at: at as f64, more: f64::from(more), bounds };
            let mut trial = c.spec.clone();
            trial.terms.push(term.boxed());
            let (stage, _) = trial.stage(c.data);
            // The model's delay lies anywhere between the two there are.
            let nk = c.spec.orders.nk;
            let short = nk.saturating_sub(more.unsigned_abs() as usize).max(1);
            let mut delays = vec![short, nk.midpoint(short)];
            delays.dedup();
            let others = delays.into_iter().filter(|delay| *delay != nk);
            let mut best = Quick::long_arx(c.data, &stage, nk);
            for other in others.map(|nk| Quick::long_arx(c.data, &stage, nk)) {
                if other.loss < best.loss {
                    best = other;
                }
            }
            (best.loss, best, term)
        };
        let mut rated: Vec<_> = changes(c, from..to).into_iter().map(rate).collect();
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        rated.truncate(CLOSER);
        let closer: Vec<_> =
            rated.iter().filter_map(|(_, fit, _)| closer(c, fit, from..to)).map(rate).collect();
        rated.extend(closer);
        let proposal = |(loss, _, term)| Proposal {
            term: Box::<Change>::new(term),
            loss,
            parameters: 2.0,
            tried,
            element: None,
        };
        best(rated.into_iter().map(proposal).collect(), 2)
    }
    fn on_the_stem(&self) -> bool {
        true
    }
}

/// The time and change that suit best once the dynamics are estimated with nearly the right ones.
fn closer(c: &Context<'_>, fit: &Quick, times: Range<usize>) -> Option<(usize, i32)> {
    let (first, split) = (c.data.first, c.data.split);
    let scale = spread(&fit.residual());
    let held = Held::new(c, &fit.theta, &fit.z_lags);
    let shifts: Vec<i32> = (-EARLIER..=LONGEST).collect();
    let sums: Vec<Vec<f64>> = shifts
        .iter()
        .map(|shift| {
            let e = held.errors(*shift);
            let mut sum = 0.0;
            let weighted = e.iter().zip(&c.stage.weight[first..split]);
            weighted
                .map(|(e, w)| {
                    sum += w * rho(*e, scale);
                    sum
                })
                .collect()
        })
        .collect();
    let mut found: Option<(f64, usize, i32)> = None;
    for (before, own) in shifts.iter().zip(&sums) {
        for (after, next) in shifts.iter().zip(&sums) {
            if before == after || (before - after).abs() > LONGEST {
                continue;
            }
            let total = next.last().copied().unwrap_or(0.0);
            for at in times.clone() {
                let loss = own[at - 1 - first] + total - next[at - 1 - first];
                if found.is_none_or(|best| loss < best.0) {
                    found = Some((loss, at, after - before));
                }
            }
        }
    }
    found.map(|(_, at, more)| (at, more))
}

/// What a single error costs: t distribution of three degrees.
fn rho(e: f64, scale: f64) -> f64 {
    (1.0 + e * e / (3.0 * scale * scale)).ln()
}

/// Times of a change and samples more from there on that explain most, as `B` of one part of the samples alone has it.
///
/// ```text
/// e_s[k] = y - sum a_i y[k-i] - sum b_j z[k-s-j] - c0,   gain(t, s) = sum over the other side of t of rho(e_0) - rho(e_s)
/// ```
fn changes(c: &Context<'_>, times: Range<usize>) -> Vec<(usize, i32)> {
    let (first, split) = (c.data.first, c.data.split);
    let nk = c.spec.orders.nk;
    let lags: Vec<usize> = (nk.saturating_sub(BEFORE).max(1)..=nk + AFTER).collect();
    let y_lags: Vec<usize> = (1..=LONG_Y).collect();
    let mut found: Vec<(f64, usize, i32)> = Vec::new();
    // Before the change with the dynamics of the first samples, after it with those of the last.
    for (share, late) in PARTS.into_iter().flat_map(|share| [(share, false), (share, true)]) {
        let part = (share * (split - first) as f64) as usize;
        let own = if late { split - part..split } else { first..first + part };
        let mut stage = c.stage.clone();
        stage.weight.iter_mut().enumerate().filter(|(k, _)| !own.contains(k)).for_each(|(_, w)| *w = 0.0);
        let theta = Quick::new(c.data, &stage, &y_lags, &lags).theta;
        let held = Held::new(c, &theta, &lags);
        let still = held.errors(0);
        let scale = spread(&still[own.start - first..own.end - first]);
        let still: Vec<f64> = still.into_iter().map(|e| rho(e, scale)).collect();
        for more in (-LONGEST..=LONGEST).filter(|s| *s != 0) {
            let shifted = held.errors(more);
            let gains = (first..split)
                .map(|k| c.stage.weight[k] * (still[k - first] - rho(shifted[k - first], scale)));
            let mut sum = 0.0;
            let sums: Vec<f64> = gains
                .map(|g| {
                    sum += g;
                    sum
                })
                .collect();
            let gain = |at: usize| if late { sums[at - 1 - first] } else { sum - sums[at - 1 - first] };
            if let Some(at) = times.clone().max_by(|a, b| gain(*a).total_cmp(&gain(*b))) {
                found.push((gain(at), at, if late { -more } else { more }));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(MOST);
    found.into_iter().map(|(_, at, more)| (at, more)).collect()
}

/// What the stem is to explain of the fitted samples by a long ARX, and how it does.
struct Held<'a> {
    data: &'a Data,
    z: &'a [f64],
    left: Vec<f64>,
    lags: &'a [usize],
    b: &'a [f64],
}

impl<'a> Held<'a> {
    fn new(c: &'a Context<'_>, theta: &'a [f64], lags: &'a [usize]) -> Self {
        let (first, split) = (c.data.first, c.data.split);
        let (b, rest) = theta[LONG_Y..].split_at(lags.len());
        let mut left: Vec<f64> = c.stage.y[first..split].iter().map(|y| y - rest[0]).collect();
        for (i, a) in theta[..LONG_Y].iter().enumerate() {
            take(&mut left, *a, &c.stage.y[first - 1 - i..split - 1 - i]);
        }
        for (gamma, column) in rest[1..].iter().zip(&c.stage.columns) {
            take(&mut left, *gamma, &column[first..split]);
        }
        Self { data: c.data, z: &c.stage.z, left, lags, b }
    }

    /// The errors with the stem `shift` samples later.
    fn errors(&self, shift: i32) -> Vec<f64> {
        let (first, split) = (self.data.first, self.data.split);
        let mut e = self.left.clone();
        for (lag, b) in self.lags.iter().zip(self.b) {
            let lag = (*lag as i32 + shift).clamp(0, first as i32) as usize;
            take(&mut e, *b, &self.z[first - lag..split - lag]);
        }
        e
    }
}

fn take(from: &mut [f64], gain: f64, v: &[f64]) {
    from.iter_mut().zip(v).for_each(|(left, v)| *left -= gain * v);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::Settings;
    use crate::residual::pose::{declared, tests::first_order};
    use crate::residual::regress::all_errors;

    /// The errors of a stem that comes later are those of the long ARX with it in the place of the other.
    #[test]
    fn a_shifted_stem_leaves_the_errors_of_one_that_was_shifted() {
        let data = first_order(500);
        let spec = declared(&data, 0.0);
        let (mut stage, e) = all_errors(&data, &spec);
        stage.columns.push((0..data.len()).map(|k| (0.7 * k as f64).cos()).collect());
        let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
        let settings = Settings::default();
        let context = Context::new(&data, (&spec, spec.element), (&stage, &e), &quick, &settings);
        let held = Held::new(&context, &quick.theta, &quick.z_lags);
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(near(&held.errors(0), &quick.residual()));
        let mut later = stage.clone();
        (3..later.z.len()).for_each(|k| later.z[k] = stage.z[k - 3]);
        let y_lags: Vec<usize> = (1..=LONG_Y).collect();
        let mut moved = Quick::new(&data, &later, &y_lags, &quick.z_lags);
        moved.theta.clone_from(&quick.theta);
        assert!(near(&held.errors(3), &moved.residual()) && !near(&held.errors(3), &held.errors(0)));
    }
}
