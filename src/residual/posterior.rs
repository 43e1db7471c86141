//! The posterior of friction and of each kind of effect, from one table of scores.
//!
//! ```text
//! P(kind) ~ prior(kind) sum over h of that kind of exp(score(h)),   prior: none 1/2, any other kind 1/(2 n), n = hypotheses asked
//! P(friction) : P(no friction) = sum over all h of prior(kind of h) exp(score(h)), with friction : without
//! ```
//!
//! Such a posterior says which hypothesis is likeliest; it takes for granted that one of them is true. The posterior that is
//! published of an effect is therefore a share counted on simulated loops: how often an effect with as much [`Evidence`] was
//! there ([`Evidence::posterior`]).

use super::findings::{Evidence, Kind};
use super::fit::Fitted;
use super::hypotheses::ALL;
use super::hypothesis::Hypothesis;
use crate::sysid::criterion::log_sum;

/// Logarithm of the prior odds of a number of effects against none (-): `-effects ln n`, n = kinds of hypotheses asked.
pub fn log_prior(effects: usize) -> f64 {
    -(effects as f64) * (ALL.len() as f64).ln()
}

/// The probability (0..1) that has this logarithm of its odds.
pub fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// Logarithm of odds from which an effect counts as likely: 150 to 1.
const LIKELY: f64 = 5.0;
/// Standard deviations from which held-out samples speak for an effect, or against it.
const SPEAKS: f64 = 1.0;
/// Logarithm of the odds against none from which a change beside friction counts as likely: below it, 13 of 101 were there. The
/// odds against all else do not tell, because changes of the load and of the gain are each other's rivals (`calibrate posterior`
/// tries other limits).
const LIKELY_CHANGE: f64 = 10.0;
/// How many changes at a time were there, of how many, where held-out samples speak against them, say nothing, speak for them:
/// without friction (however likely), then beside it, unlikely and likely. A valve that is not quite that of the model leaves a
/// rest, and from some time on a change explains part of it.
/// Loops of generators B and C, as many with nothing hidden as with an effect (`tracing_rates --evidence`, `calibrate posterior`).
const CHANGES: [[[u16; 2]; 3]; 3] =
    [[[2, 11], [17, 24], [40, 52]], [[9, 66], [4, 35], [4, 35]], [[13, 58], [13, 24], [45, 51]]];
/// The same of other effects that are not likely, without friction and beside it: samples that say nothing and samples that speak
/// for them count together.
const UNLIKELY: [[[u16; 2]; 3]; 2] = [[[2, 10], [25, 26], [25, 26]], [[9, 28], [19, 43], [19, 43]]];
/// The same of other effects that are likely, with and without friction.
const OTHERS: [[u16; 2]; 3] = [[21, 30], [188, 191], [188, 191]];
/// The same of a gain that depends on PV or OP, unlikely and likely; counted on generator D as well, because loads that swing
/// imitate it. Samples that say nothing count with those against it where it is unlikely, else with those for it.
const BENDS: [[[u16; 2]; 3]; 2] = [[[18, 52], [18, 52], [19, 27]], [[13, 18], [92, 113], [92, 113]]];
/// The same of a valve's stop, without friction, then beside it, however likely; counted on generator D as well. A stem that sticks
/// stands still as one at its stop does, and where friction is not quite that of the model a stop explains the rest.
const STOPS: [[[u16; 2]; 3]; 2] = [[[0, 1], [13, 14], [13, 14]], [[17, 53]; 3]];
/// The same of slip jumps, unlikely and likely: held-out samples hardly tell one J from another.
const SLIP_JUMPS: [[u16; 2]; 2] = [[25, 33], [325, 359]];

impl Evidence {
    /// The posterior of an effect (0..1): the share of simulated effects of this kind, with as much evidence, that were there; at
    /// most what the odds alone say.
    pub fn posterior(&self, kind: Kind) -> f64 {
        // The odds of two likelihoods of 0 are not a number: they are no evidence.
        if self.log_odds.is_nan() {
            return 0.0;
        }
        let likely = self.log_odds >= LIKELY;
        let held_out = match self.held_out {
            z if z >= SPEAKS => 2,
            z if z >= -SPEAKS => 1,
            // A comparison that is not a number counts against the effect, too.
            _ => 0,
        };
        let beside = usize::from(self.beside_friction);
        let [there, of] = match kind {
            Kind::SlipJump => SLIP_JUMPS[usize::from(likely)],
            Kind::StaticNonlinearity => BENDS[usize::from(likely)][held_out],
            Kind::ValveSaturation => STOPS[beside][held_out],
            _ if kind.is_change() && !self.beside_friction => CHANGES[0][held_out],
            _ if kind.is_change() => CHANGES[1 + usize::from(self.over_none >= LIKELY_CHANGE)][held_out],
            _ if likely => OTHERS[held_out],
            _ => UNLIKELY[beside][held_out],
        };
        (f64::from(there) / f64::from(of)).min(probability(self.log_odds))
    }
}

/// The class of a hypothesis' friction: 0 for none, 1 for J = S, 2 for J free.
pub fn friction_class(hypothesis: &Hypothesis) -> usize {
    hypothesis.valve.map_or(0, |valve| if valve.j == valve.s { 1 } else { 2 })
}

/// The best hypothesis of every kind and class of friction, with the logarithm of prior times marginal likelihood.
#[derive(Debug)]
pub struct Table<'a> {
    /// Hypothesis, kind of its next effect (`None` for no further effect), and `score + ln prior`.
    rows: Vec<(&'a Fitted, Option<Kind>, f64)>,
}

impl<'a> Table<'a> {
    /// The table of these hypotheses.
    ///
    /// * `fitted`: hypotheses with at most one effect more than all of them share.
    /// * `count`: number of effects that all of them share.
    /// * `asked`: n, how many hypotheses of a next effect were asked; two of them may be of one kind.
    pub fn new(fitted: &'a [Fitted], count: usize, asked: usize) -> Self {
        let prior = -(2.0 * asked.max(1) as f64).ln();
        let mut rows: Vec<(&Fitted, Option<Kind>, f64)> = Vec::new();
        for fitted in fitted.iter().filter(|fitted| fitted.score.is_finite()) {
            let kind = fitted.kind().filter(|_| fitted.hypothesis.effects.len() > count);
            let log = fitted.score + if kind.is_some() { prior } else { -(2.0f64).ln() };
            let class = friction_class(&fitted.hypothesis);
            let same = |row: &&mut (&Fitted, Option<Kind>, f64)| {
                row.1 == kind && friction_class(&row.0.hypothesis) == class
            };
            // The rates integrate over the parameters: of hypotheses that differ in parameters alone, the best stands for all.
            match rows.iter_mut().find(same) {
                Some(row) if row.2 < log => *row = (fitted, kind, log),
                Some(_) => {}
                None => rows.push((fitted, kind, log)),
            }
        }
        Self { rows }
    }

    /// The table without the hypotheses of these kinds.
    pub fn without(&self, kinds: &[Kind]) -> Self {
        let left = self.rows.iter().filter(|row| row.1.is_none_or(|kind| !kinds.contains(&kind)));
        Self { rows: left.copied().collect() }
    }

    /// Logarithm of the sum of prior times marginal likelihood, over some hypotheses.
    fn log(&self, which: impl Fn(&Fitted, Option<Kind>) -> bool) -> f64 {
        let logs: Vec<f64> =
            self.rows.iter().filter(|(d, kind, _)| which(d, *kind)).map(|row| row.2).collect();
        log_sum(logs.iter().copied())
    }

    /// The posterior (0..1) of every kind in the table, with `None` for no further effect, the likeliest first.
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

    /// The logarithm of the odds for a kind against all others (-).
    pub fn log_odds_of(&self, kind: Option<Kind>) -> f64 {
        self.log(|_, own| own == kind) - self.log(|_, own| own != kind)
    }

    /// The hypotheses of the table: the best of every kind and class of friction.
    pub fn fitted(&self) -> impl Iterator<Item = &'a Fitted> {
        self.rows.iter().map(|row| row.0)
    }

    /// The logarithm of the odds for the hypotheses that have a property, against those that do not (-).
    pub fn log_odds(&self, which: impl Fn(&Fitted) -> bool) -> f64 {
        self.log(|d, _| which(d)) - self.log(|d, _| !which(d))
    }

    /// The same odds among the hypotheses that have the property `within`.
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
            Evidence { log_odds, over_none: log_odds, held_out, beside_friction }.posterior(kind)
        };
        let posterior = |kind, log_odds, held_out| of(kind, log_odds, held_out, true);
        assert_eq!(posterior(Kind::Drift, 5.0, 1.0), 188.0 / 191.0);
        assert_eq!(of(Kind::Drift, 4.9, 1.0, false), 25.0 / 26.0);
        assert!(
            posterior(Kind::Drift, 4.9, 40.0) < 0.5,
            "a drift that is not likely explains what the valve lacks"
        );
        assert_eq!(of(Kind::LoadStep, 40.0, 0.0, false), 17.0 / 24.0);
        assert_eq!(posterior(Kind::LoadStep, 10.0, 0.0), 13.0 / 24.0);
        assert_eq!(posterior(Kind::LoadStep, 40.0, -1.1), 13.0 / 58.0);
        assert!(
            posterior(Kind::LoadStep, 9.9, 40.0) < 0.5,
            "a change that is not likely explains what the valve lacks"
        );
        let rivalled = Evidence { log_odds: 2.0, over_none: 40.0, held_out: 1.0, beside_friction: true };
        let alone = probability(2.0);
        assert!(
            alone < 45.0 / 51.0 && rivalled.posterior(Kind::LoadStep) == alone,
            "two changes that are alike"
        );
        assert_eq!(posterior(Kind::StaticNonlinearity, 5.0, 1.0), 92.0 / 113.0);
        assert_eq!(posterior(Kind::SlipJump, 9.0, -40.0), 325.0 / 359.0);
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
