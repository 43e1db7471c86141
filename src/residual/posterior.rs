//! The posterior of friction and of each kind of effect, from one table of scores.
//!
//! ```text
//! P(kind) ~ prior(kind) sum over h of that kind of exp(score(h)),   prior: none 1/2, any other kind 1/(2 n), n = hypotheses asked
//! P(friction) : P(no friction) = sum over all h of prior(kind of h) exp(score(h)), with friction : without
//! ```
//!
//! Such a posterior says which hypothesis is likeliest, not that one of them is true.
//! What is published of an effect is therefore how often one with the same [`Evidence`] is there.

use super::Kind;
use super::findings::Evidence;
use super::fit::Fitted;
use super::hypotheses::ALL;
use super::hypothesis::Hypothesis;
use crate::sysid::criterion::log_sum;

/// Logarithm of the prior odds of so many effects against none: 1/n for each, n = hypotheses asked.
pub fn log_prior(effects: usize) -> f64 {
    -(effects as f64) * (ALL.len() as f64).ln()
}

/// A probability from the logarithm of its odds.
pub fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// Logarithm of odds from which an effect counts as likely: 150 to 1.
const LIKELY: f64 = 5.0;
/// Standard deviations from which held-out samples speak for an effect, or against it.
const SPEAKS: f64 = 1.0;
/// How many changes at a time were there, of how many, where held-out samples speak against them, say nothing, speak for them;
/// however likely, because whatever the hypotheses lack has a time from which on a change explains some of it.
/// Loops of generators B and C, as many with nothing hidden as with an effect (`tracing_rates --evidence`, `calibrate posterior`).
const CHANGES: [[u16; 2]; 3] = [[7, 84], [22, 42], [52, 65]];
/// The same of other effects that are not likely: samples that say nothing and samples that speak for them count together.
const UNLIKELY: [[u16; 2]; 3] = [[8, 33], [22, 38], [22, 38]];
/// The same of other effects that are likely.
const OTHERS: [[u16; 2]; 3] = [[16, 25], [129, 130], [129, 130]];
/// The same of a gain that depends on PV or OP, unlikely and likely; counted on generator D as well, because loads that swing
/// imitate it. Samples that say nothing count with those against it where it is unlikely, else with those for it.
const BENDS: [[[u16; 2]; 3]; 2] = [[[18, 52], [18, 52], [19, 27]], [[13, 18], [92, 113], [92, 113]]];
/// The same of a valve's stop, without friction, then beside it, however likely; counted on generator D as well. A stem that sticks
/// stands still as one at its stop does, and where friction is not quite that of the model a stop explains the rest.
const STOPS: [[[u16; 2]; 3]; 2] = [[[0, 1], [13, 14], [13, 14]], [[17, 53]; 3]];
/// The same of slip jumps, unlikely and likely: held-out samples hardly tell one J from another.
const SLIP_JUMPS: [[u16; 2]; 2] = [[25, 36], [245, 298]];

impl Evidence {
    /// The share of effects of this kind with as much evidence that were there; no more than the odds alone say.
    pub fn posterior(&self, kind: Kind) -> f64 {
        // A ratio of two likelihoods that are 0 speaks for nothing.
        if self.log_odds.is_nan() {
            return 0.0;
        }
        let likely = self.log_odds >= LIKELY;
        let said = match self.held_out {
            z if z >= SPEAKS => 2,
            z if z >= -SPEAKS => 1,
            // What cannot be compared speaks against the effect, too.
            _ => 0,
        };
        let [there, of] = match kind {
            Kind::SlipJump => SLIP_JUMPS[usize::from(likely)],
            Kind::StaticNonlinearity => BENDS[usize::from(likely)][said],
            Kind::ValveSaturation => STOPS[usize::from(self.beside_friction)][said],
            _ if kind.is_change() => CHANGES[said],
            _ if likely => OTHERS[said],
            _ => UNLIKELY[said],
        };
        (f64::from(there) / f64::from(of)).min(probability(self.log_odds))
    }
}

/// Friction as the hypotheses of one kind are told apart: none, J = S, J free.
pub fn class(hypothesis: &Hypothesis) -> usize {
    hypothesis.valve.map_or(0, |valve| if valve.j == valve.s { 1 } else { 2 })
}

/// Hypotheses with their logarithms of prior times evidence.
#[derive(Debug)]
pub struct Table<'a> {
    rows: Vec<(&'a Fitted, Option<Kind>, f64)>,
}

impl<'a> Table<'a> {
    /// Of hypotheses that end in at most one effect more than the `count` that all share; `asked`: n, how many hypotheses were asked (two of them
    /// may be of one kind).
    pub fn new(fitted: &'a [Fitted], count: usize, asked: usize) -> Self {
        let prior = -(2.0 * asked.max(1) as f64).ln();
        let mut rows: Vec<(&Fitted, Option<Kind>, f64)> = Vec::new();
        for fitted in fitted.iter().filter(|fitted| fitted.score.is_finite()) {
            let kind = fitted.kind().filter(|_| fitted.hypothesis.effects.len() > count);
            let log = fitted.score + if kind.is_some() { prior } else { -(2.0f64).ln() };
            let class = class(&fitted.hypothesis);
            let same = |row: &&mut (&Fitted, Option<Kind>, f64)| {
                row.1 == kind && self::class(&row.0.hypothesis) == class
            };
            // Parameters are integrated by their rates: of hypotheses that differ in those alone the best stands for all.
            match rows.iter_mut().find(same) {
                Some(row) if row.2 < log => *row = (fitted, kind, log),
                Some(_) => {}
                None => rows.push((fitted, kind, log)),
            }
        }
        Self { rows }
    }

    /// The table without these kinds.
    pub fn without(&self, kinds: &[Kind]) -> Self {
        let left = self.rows.iter().filter(|row| row.1.is_none_or(|kind| !kinds.contains(&kind)));
        Self { rows: left.copied().collect() }
    }

    fn log(&self, which: impl Fn(&Fitted, Option<Kind>) -> bool) -> f64 {
        let logs: Vec<f64> =
            self.rows.iter().filter(|(d, kind, _)| which(d, *kind)).map(|row| row.2).collect();
        log_sum(logs.iter().copied())
    }

    /// The posterior of every kind in the table, `None` among them, the likeliest first.
    pub fn kinds(&self) -> Vec<(Option<Kind>, f64)> {
        let all = self.log(|_, _| true);
        let mut kinds: Vec<Option<Kind>> = self.rows.iter().map(|row| row.1).collect();
        kinds.sort();
        kinds.dedup();
        let mut out: Vec<(Option<Kind>, f64)> =
            kinds.into_iter().map(|kind| (kind, (self.log(|_, k| k == kind) - all).exp())).collect();
        out.sort_by(|a, b| b.1.total_cmp(&a.1));
        out
    }

    /// The logarithm of the odds for a kind.
    pub fn log_odds_of(&self, kind: Option<Kind>) -> f64 {
        self.log(|_, own| own == kind) - self.log(|_, own| own != kind)
    }

    /// The hypotheses that stand for their kinds.
    pub fn fitted(&self) -> impl Iterator<Item = &'a Fitted> {
        self.rows.iter().map(|row| row.0)
    }

    /// The logarithm of the odds for a property of hypotheses.
    pub fn log_odds(&self, which: impl Fn(&Fitted) -> bool) -> f64 {
        self.log(|d, _| which(d)) - self.log(|d, _| !which(d))
    }

    /// The same among the hypotheses with another property.
    pub fn log_odds_within(&self, within: impl Fn(&Fitted) -> bool, which: impl Fn(&Fitted) -> bool) -> f64 {
        self.log(|d, _| within(d) && which(d)) - self.log(|d, _| within(d) && !which(d))
    }

    /// The best hypothesis of a kind.
    pub fn best(&self, kind: Option<Kind>) -> Option<&'a Fitted> {
        let own = self.rows.iter().filter(|row| row.1 == kind);
        own.max_by(|a, b| a.2.total_cmp(&b.2)).map(|row| row.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_posterior_follows_from_odds_and_held_out_samples() {
        let of = |kind, log_odds, held_out, beside_friction| {
            Evidence { log_odds, held_out, beside_friction }.posterior(kind)
        };
        let posterior = |kind, log_odds, held_out| of(kind, log_odds, held_out, true);
        assert_eq!(posterior(Kind::Drift, 5.0, 1.0), 129.0 / 130.0);
        assert_eq!(posterior(Kind::Drift, 4.9, 1.0), 22.0 / 38.0);
        assert_eq!(posterior(Kind::LoadStep, 40.0, -1.1), 7.0 / 84.0);
        assert_eq!(posterior(Kind::StaticNonlinearity, 5.0, 1.0), 92.0 / 113.0);
        assert_eq!(posterior(Kind::SlipJump, 9.0, -40.0), 245.0 / 298.0);
        assert!(posterior(Kind::Drift, -1.0, 3.0) < 0.27, "less likely than not by the odds alone");
        assert_eq!(of(Kind::ValveSaturation, 40.0, 3.0, false), 13.0 / 14.0);
        assert!(posterior(Kind::ValveSaturation, 40.0, 3.0) < 0.5, "a stem that sticks stands still, too");
        for kind in Kind::ALL {
            for log_odds in [0.2, 2.0, 5.0, f64::INFINITY] {
                // What more speaks for is never less likely.
                let by_held_out = [-40.0, -1.0, 0.99, 1.0, 40.0].map(|z| of(kind, log_odds, z, false));
                assert!(by_held_out.is_sorted(), "{kind} {log_odds}: {by_held_out:?}");
                // Loads imitate a bend that is not likely more often than it is there.
                let imitated = kind == Kind::StaticNonlinearity && log_odds < LIKELY;
                assert_eq!(by_held_out[1] > 0.5, !imitated, "{kind} {log_odds}");
            }
        }
    }
}
