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
use crate::diagnosis::{Diagnosis, NotIdentifiable, Verdict};
use crate::signal::told;
use crate::sysid::iddata::IdData;

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
pub struct Answer {
    /// Friction (OP unit).
    pub friction: Friction,
    /// The verdict.
    pub verdict: Verdict,
    /// One sentence.
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
        let mut reason = self.diagnosis.reason.clone();
        if asked {
            reason += "; the model with effects gives another verdict, but it predicts the last fifth of the \
                       samples worse";
        }
        let verdict = self.diagnosis.verdict.clone();
        let mut answer =
            Answer { friction: friction_before(self.diagnosis), verdict, reason, by_tracing: false, asked };
        if answer.tells_stiction() && !followed() {
            answer.cannot_tell(NotIdentifiable::StemNotFollowed);
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
        let acquisition = diagnosis.preparation.acquisition.as_ref();
        let unseen = apart.is_some() || acquisition.is_some_and(|found| found.unseen_scans());
        let fast = unseen.then_some(diagnosis.preparation.reading.fast);
        let within = interval(data, &best.hypothesis, fast).map(|f| f * unit);
        let sticks = f > settings.f_threshold && evidence > settings.evidence_threshold && within[0] > 0.0;
        let verdict = match &diagnosis.verdict {
            // A stem that PV is not seen to answer may be any signal that happens to look like PV's load.
            unanswered @ Verdict::NotIdentifiable(NotIdentifiable::NoResponse) => unanswered.clone(),
            _ if sticks && follows(data, best) => Verdict::Stiction,
            _ if sticks => Verdict::NotIdentifiable(NotIdentifiable::StemNotFollowed),
            Verdict::NotIdentifiable(why) => Verdict::NotIdentifiable(why.clone()),
            _ if has_positive_feedback(data, &best.model) => {
                Verdict::NotIdentifiable(NotIdentifiable::NoResponse)
            }
            _ => apart.map_or(Verdict::NoStiction, Verdict::NotIdentifiable),
        };
        let sticks = verdict == Verdict::Stiction;
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
        let (per, unit) = self.settings.op_span.map_or((1.0, ""), |span| (100.0 / span, " % OP"));
        let [f, low, high] = [f, within[0], within[1]].map(|f| told(per * f));
        match verdict {
            Verdict::Stiction => format!("f = {f}{unit} [{low}, {high}], evidence {evidence:.0}"),
            Verdict::NoStiction if evidence > self.settings.evidence_threshold => {
                let why = match within[0] > 0.0 {
                    true => format!("its f of {f}{unit} is too small to matter"),
                    false => format!("f may be 0 as well as {high}{unit}"),
                };
                format!("friction predicts PV better, evidence {evidence:.0}, but {why}")
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
            self.cannot_tell(NotIdentifiable::HiddenFriction { reversal: data.units.along_op(2.0 * most) });
        } else if self.by_tracing {
            self.reason += &format!("; f up to {} could be hidden", data.units.along_op(bound));
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
