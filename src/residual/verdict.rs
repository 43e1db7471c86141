//! The verdict after effects, and what it leaves possible.
//!
//! Stiction is told where f is above its threshold, its interval excludes 0, its evidence is enough, and PV is seen to follow the
//! stem. A valve whose OP the diagnosis sees PV not to answer is never told to stick. Where held-out samples disagree with the effects, the diagnosis without them stands.

use super::Settings;
use super::findings::Friction;
use super::fit::{Fitted, has_positive_feedback};
use super::interval::interval;
use super::posterior::probability;
use super::response::follows;
use crate::diagnosis::verdict::{bare_reason, could_be_hidden, not_told};
use crate::diagnosis::{Diagnosis, NotIdentifiable, Verdict};
use crate::signal::told;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::largest_move;

/// Share of the largest f from which a bound excludes nothing.
const EXCLUDES_NOTHING: f64 = 0.98;

/// What a verdict is made of.
pub struct Question<'a> {
    /// The record with its samples put right.
    pub data: &'a IdData,
    /// The best hypothesis.
    pub best: &'a Fitted,
    /// Logarithm of the odds for friction; minus infinity where nothing was asked of it, because the valve reverses too seldom.
    pub log_odds: f64,
    /// The diagnosis without effects.
    pub diagnosis: &'a Diagnosis,
    /// Thresholds.
    pub settings: &'a Settings,
}

/// The verdict, and why.
#[derive(Debug)]
pub struct Answer {
    /// Friction (OP unit).
    pub friction: Friction,
    /// The verdict.
    pub verdict: Verdict,
    /// One sentence; once it is bounded ([`Answer::bound`]), with what it leaves possible.
    pub reason: String,
    /// Whether tracing decided, or the diagnosis stands.
    pub by_tracing: bool,
    /// Whether tracing asked of friction at all.
    pub asked: bool,
}

impl Question<'_> {
    /// The verdict; `agrees`: held-out samples are predicted no worse with the effects, `followed`: PV follows the declared stem.
    pub fn answer(&self, agrees: bool, followed: impl Fn() -> bool) -> Answer {
        let asked = self.log_odds > f64::NEG_INFINITY;
        if asked {
            let (friction, verdict, reason) = self.traced();
            if agrees || verdict == self.diagnosis.verdict {
                return Answer { friction, verdict, reason, by_tracing: true, asked };
            }
        }
        let overruled =
            "tracing gives another verdict, but its model predicts the last fifth of the samples worse";
        let own = bare_reason(self.diagnosis, self.settings.op_span);
        let clauses = [Some(own), asked.then_some(overruled)];
        let clauses = clauses.into_iter().flatten().filter(|clause| !clause.is_empty());
        let reason = clauses.collect::<Vec<_>>().join("; ");
        let verdict = self.diagnosis.verdict.clone();
        let mut answer =
            Answer { friction: friction_before(self.diagnosis), verdict, reason, by_tracing: false, asked };
        if answer.tells_stiction() && !followed() {
            answer.cannot_tell(NotIdentifiable::StemNotFollowed);
        }
        if answer.verdict == Verdict::NoStiction && self.settings.compensated > 0.0 {
            answer.cannot_tell(NotIdentifiable::Compensated);
        }
        answer
    }

    /// Friction beside the effects, and what it means.
    fn traced(&self) -> (Friction, Verdict, String) {
        let Self { data, best, log_odds, diagnosis, settings } = *self;
        let unit = data.units.u;
        let evidence = 2.0 * log_odds;
        let f = best.hypothesis.valve.map_or(0.0, |valve| valve.f() * unit);
        let apart = diagnosis.preparation.apart();
        let fast = diagnosis.preparation.unseen_moves();
        let mut within = interval(data, &best.hypothesis, fast).map(|f| f * unit);
        let is_there = evidence > settings.evidence_threshold && within[0] > 0.0;
        let sticks = is_there && f > settings.f_threshold;
        let verdict = match &diagnosis.verdict {
            // A stem that PV is not seen to answer may be any signal that happens to look like PV's load.
            unanswered @ Verdict::NotIdentifiable(NotIdentifiable::NoResponse) => unanswered.clone(),
            _ if sticks && follows(data, best) => Verdict::Stiction,
            _ if sticks => Verdict::NotIdentifiable(NotIdentifiable::StemNotFollowed),
            Verdict::NotIdentifiable(why) => Verdict::NotIdentifiable(why.clone()),
            // A valve that a term moves at once leaves no friction to be seen.
            _ if settings.compensated > 0.0 => Verdict::NotIdentifiable(NotIdentifiable::Compensated),
            _ if has_positive_feedback(data, &best.model) => {
                Verdict::NotIdentifiable(NotIdentifiable::NoResponse)
            }
            _ => apart.map_or(Verdict::NoStiction, Verdict::NotIdentifiable),
        };
        let sticks = verdict == Verdict::Stiction;
        if verdict == Verdict::NoStiction && best.hypothesis.valve.is_some() && !is_there {
            // That interval is of one kind of valve, as if there were one. Where none need be there, whatever the record does not
            // exclude beside none is possible.
            let none = best.hypothesis.with_valve(None);
            within[1] = within[1].max(interval(data, &none, None)[1] * unit);
        }
        let friction = Friction {
            f: if sticks { f } else { 0.0 },
            f_ci95: if sticks { within } else { [0.0, within[1]] },
            lag: best.hypothesis.valve.filter(|_| sticks).map_or(0.0, |valve| valve.lag() * unit),
            delta_aic: evidence.max(0.0),
            posterior: probability(log_odds),
        };
        let reason = self.reason(&verdict, f, within);
        (friction, verdict, reason)
    }

    /// Why, in one sentence; `f` and where it is `within` (OP unit).
    fn reason(&self, verdict: &Verdict, f: f64, within: [f64; 2]) -> String {
        let evidence = 2.0 * self.log_odds;
        let span = self.settings.op_span;
        match verdict {
            Verdict::Stiction => {
                let (per, unit) = span.map_or((1.0, ""), |span| (100.0 / span, " % OP"));
                let [f, low, high] = [f, within[0], within[1]].map(|f| told(per * f));
                format!("f = {f}{unit} [{low}, {high}], evidence {evidence:.0}")
            }
            Verdict::NoStiction if evidence > self.settings.evidence_threshold => {
                not_told(evidence, [f, within[0]], span)
            }
            Verdict::NoStiction => format!("no friction needed, evidence {:.0}", evidence.max(0.0)),
            Verdict::NotIdentifiable(why) => why.to_string(),
        }
    }
}

impl Answer {
    /// Whether stiction is told.
    pub fn tells_stiction(&self) -> bool {
        self.verdict == Verdict::Stiction
    }

    /// Whether the diagnosis says the same: both tell stiction or neither does, held-out samples did not overrule tracing, and no
    /// term of write-back acted in the window.
    pub fn agrees_with(&self, diagnosis: &Diagnosis) -> bool {
        let sticks = diagnosis.verdict == Verdict::Stiction;
        (self.by_tracing || !self.asked)
            && sticks == self.tells_stiction()
            && diagnosis.preparation.compensated == 0.0
    }

    /// Bounds f where no stiction is told, by `detectable`, the least f that the record would have shown: neither what it would not
    /// have shown nor what its likelihood leaves possible is excluded. Returns what is published of it (OP unit).
    pub fn bound(&mut self, data: &IdData, detectable: Option<f64>) -> Option<f64> {
        let detectable = detectable.map(|f| f * data.units.u);
        if self.verdict != Verdict::NoStiction {
            return detectable;
        }
        let most = data.f_max * data.units.u;
        let bound = self.friction.f_ci95[1].max(detectable.unwrap_or(0.0));
        self.friction.f_ci95[1] = bound;
        if detectable.is_none() && bound >= EXCLUDES_NOTHING * most {
            let reversal = 2.0 * largest_move(&data.u, data.start.index) * data.units.u;
            self.cannot_tell(NotIdentifiable::HiddenFriction { reversal: data.units.along_op(reversal) });
        } else {
            // The one place that says it, whoever decided: the bound that is published.
            self.reason += &could_be_hidden(bound, data.units.span);
        }
        detectable.map(|_| bound)
    }

    fn cannot_tell(&mut self, why: NotIdentifiable) {
        self.reason = why.to_string();
        self.verdict = Verdict::NotIdentifiable(why);
    }
}

/// Friction as the diagnosis has it.
pub fn friction_before(diagnosis: &Diagnosis) -> Friction {
    diagnosis.estimate.as_ref().map_or_else(Friction::default, |e| Friction {
        f: e.f,
        f_ci95: e.f_ci95,
        lag: 0.0,
        delta_aic: e.delta_aic,
        posterior: f64::NAN,
    })
}
