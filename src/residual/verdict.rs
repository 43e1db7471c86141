//! The verdict on friction beside the effects, its sentence, and the bound on f that it leaves possible.
//!
//! The verdict is stiction where all of these are true: f is above its threshold, its interval excludes 0, its evidence is above
//! its threshold, and PV follows the stem. It is never stiction where the diagnosis sees that PV does not answer OP. It is no
//! stiction only where no friction is at least as likely as friction, or where the likeliest friction is too small to matter;
//! between the two it is undecided. Where the held-out samples are likelier without the effects, the verdict of the diagnosis
//! stands; but it does not deny friction that the fitted samples make likelier than not, which is undecided, too.

use super::findings::Friction;
use super::fit::{Fitted, has_positive_feedback};
use super::interval::interval;
use super::posterior::probability;
use super::response::pv_follows_stem;
use super::settings::Settings;
use crate::diagnosis::verdict::{Thresholds, bare_reason, could_be_hidden};
use crate::diagnosis::{Diagnosis, NotIdentifiable, Verdict};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::largest_move;

/// Share of the largest f from which a bound excludes nothing: the values of f that are tried do not meet the largest exactly.
const EXCLUDES_NOTHING: f64 = 0.98;

/// What the verdict depends on.
pub struct Question<'a> {
    /// The record with wrong samples repaired.
    pub data: &'a IdData,
    /// The likeliest hypothesis.
    pub best: &'a Fitted,
    /// Logarithm of the odds for friction (-); minus infinity where friction was not tested, because the stem reverses too seldom.
    pub log_odds: f64,
    /// The diagnosis without effects.
    pub diagnosis: &'a Diagnosis,
    /// Thresholds, and the span of OP.
    pub settings: &'a Settings,
}

/// The verdict with its reason.
#[derive(Debug)]
pub struct Answer {
    /// Friction (OP unit).
    pub friction: Friction,
    /// The verdict.
    pub verdict: Verdict,
    /// The sentence that operators read; [`Answer::bound`] appends which f it leaves possible.
    pub reason: String,
    /// Whether tracing decided; otherwise the diagnosis stands.
    pub by_tracing: bool,
    /// Whether tracing tested friction at all.
    pub asked: bool,
    /// Whether OP tells of PV beyond its samples.
    pub unrecorded: bool,
}

/// The clause that ends the reason of a verdict which tracing contested, and the held-out samples upheld.
pub fn overruled() -> &'static str {
    "tracing gives another verdict, but its model predicts the last fifth of the samples worse"
}

impl Question<'_> {
    /// The verdict.
    ///
    /// * `agrees`: the held-out samples are no less likely with the effects.
    /// * `followed`: whether PV follows the stem of the declared model; it is asked only where the diagnosis tells stiction.
    pub fn answer(&self, agrees: bool, followed: impl Fn() -> bool) -> Answer {
        let asked = self.log_odds > f64::NEG_INFINITY;
        if asked {
            let (friction, verdict, reason) = self.traced(agrees);
            let stays_open = verdict.is_undecided() && self.diagnosis.verdict == Verdict::NoStiction;
            if agrees || verdict == self.diagnosis.verdict || stays_open {
                return Answer { friction, verdict, reason, by_tracing: true, asked, unrecorded: false };
            }
        }
        let own = bare_reason(self.diagnosis, self.settings.op_span);
        let clauses = [Some(own), asked.then(overruled)];
        let clauses = clauses.into_iter().flatten().filter(|clause| !clause.is_empty());
        let reason = clauses.collect::<Vec<_>>().join("; ");
        let verdict = self.diagnosis.verdict.clone();
        let friction = friction_before(self.diagnosis);
        let mut answer = Answer { friction, verdict, reason, by_tracing: false, asked, unrecorded: false };
        if answer.tells_stiction() && !followed() {
            answer.cannot_tell(NotIdentifiable::StemNotFollowed);
        }
        if answer.verdict == Verdict::NoStiction && self.settings.compensated > 0.0 {
            answer.cannot_tell(NotIdentifiable::Compensated);
        }
        if let Some(apart) = self.apart().filter(|_| answer.verdict == Verdict::NoStiction) {
            answer.cannot_tell(apart);
        }
        answer
    }

    /// The reason why the record cannot say no, where OP and PV of a row are not of one time.
    ///
    /// Where a late PV was moved back here, the moved record tells whether OP still answers a later PV.
    pub fn apart(&self) -> Option<NotIdentifiable> {
        let prepared = &self.diagnosis.preparation;
        let Some(moved) = self.data.pv_moved else { return prepared.apart() };
        let still_late = NotIdentifiable::PvLate { share: 1.0, late_s: moved.late_s };
        prepared.apart_by_stamps().or((!moved.is_right).then_some(still_late))
    }

    /// Whether a late PV was the reason, and it was moved back here.
    fn is_repaired(&self, why: &NotIdentifiable) -> bool {
        matches!(why, NotIdentifiable::PvLate { .. })
            && self.data.pv_moved.is_some_and(|moved| moved.is_right)
    }

    /// Friction beside the effects, the verdict on it, and its sentence. `agrees` as in [`Question::answer`].
    fn traced(&self, agrees: bool) -> (Friction, Verdict, String) {
        let Self { data, best, log_odds, diagnosis, settings } = *self;
        let unit = data.units.u;
        let evidence = 2.0 * log_odds;
        let f = best.hypothesis.valve.map_or(0.0, |valve| valve.f() * unit);
        let apart = self.apart();
        let fast = diagnosis.preparation.unseen_moves();
        let mut within = interval(data, &best.hypothesis, fast).map(|f| f * unit);
        let is_significant = evidence > settings.evidence_threshold && within[0] > 0.0;
        let sticks = is_significant && f > settings.f_threshold;
        let mut verdict = match &diagnosis.verdict {
            // Where PV does not answer OP, a stem may be any signal that happens to resemble PV's load.
            unanswered @ Verdict::NotIdentifiable(NotIdentifiable::NoResponse) => unanswered.clone(),
            _ if sticks && pv_follows_stem(data, best) => Verdict::Stiction,
            _ if sticks => Verdict::NotIdentifiable(NotIdentifiable::StemNotFollowed),
            Verdict::NotIdentifiable(why) if !self.is_repaired(why) => Verdict::NotIdentifiable(why.clone()),
            // A term of write-back moves the valve at once, so that its friction does not show.
            _ if settings.compensated > 0.0 => Verdict::NotIdentifiable(NotIdentifiable::Compensated),
            _ if has_positive_feedback(data, &best.model) => {
                Verdict::NotIdentifiable(NotIdentifiable::NoResponse)
            }
            _ => apart.map_or(Verdict::NoStiction, Verdict::NotIdentifiable),
        };
        // Where the fitted samples speak for friction and the held-out ones against it, neither denies it.
        let contradicted = !agrees && diagnosis.verdict == Verdict::NoStiction && settings.compensated == 0.0;
        let is_open = match verdict {
            Verdict::Stiction | Verdict::NotIdentifiable(NotIdentifiable::StemNotFollowed) => contradicted,
            // Friction that is there may be too small to matter.
            Verdict::NoStiction => best.hypothesis.valve.is_none() || f > settings.f_threshold,
            Verdict::NotIdentifiable(_) => false,
        };
        let is_open = is_open && log_odds > 0.0;
        let believed = is_significant && !is_open;
        if (is_open || verdict == Verdict::NoStiction) && best.hypothesis.valve.is_some() && !believed {
            // That interval takes friction for granted, with one stop rule. Without significant friction, every f that the record
            // does not exclude against none is possible.
            let none = best.hypothesis.with_valve(None);
            within[1] = within[1].max(interval(data, &none, fast)[1] * unit);
        }
        if is_open {
            // No valve is tried beyond the largest f.
            let most = data.units.along_op(within[1].min(data.f_max * unit));
            let evidence = [evidence, settings.evidence_threshold];
            let undecided = NotIdentifiable::Undecided { evidence, contradicted, most, unrecorded: false };
            verdict = Verdict::NotIdentifiable(undecided);
        }
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

    /// The reason in one sentence. `f` and its 95 % interval `within` (OP unit).
    fn reason(&self, verdict: &Verdict, f: f64, within: [f64; 2]) -> String {
        let evidence = 2.0 * self.log_odds;
        let span = self.settings.op_span;
        let least = Thresholds { evidence: self.settings.evidence_threshold, f: self.settings.f_threshold };
        match verdict {
            Verdict::Stiction => least.sticks(evidence, f, within, span),
            Verdict::NoStiction if evidence > 0.0 => least.too_small(evidence, f, span),
            Verdict::NoStiction => least.too_little(evidence),
            Verdict::NotIdentifiable(why) => why.to_string(),
        }
    }
}

impl Answer {
    /// Whether the verdict is stiction.
    pub fn tells_stiction(&self) -> bool {
        self.verdict == Verdict::Stiction
    }

    /// Whether tracing and diagnosis agree: both tell stiction or neither does, the record is not undecided, the held-out samples did
    /// not overrule tracing, and no term of write-back was in force in the window.
    pub fn agrees_with(&self, diagnosis: &Diagnosis) -> bool {
        let sticks = diagnosis.verdict == Verdict::Stiction;
        (self.by_tracing || !self.asked)
            && sticks == self.tells_stiction()
            && !self.verdict.is_undecided()
            && diagnosis.preparation.compensated == 0.0
    }

    /// Whether it denies friction, or leaves it undecided. Friction that is shown and too small to matter is neither: it holds against
    /// whatever OP tells.
    ///
    /// * `evidence`: twice the log odds that a verdict asks for (-).
    pub fn is_open(&self, evidence: f64) -> bool {
        self.verdict.is_undecided()
            || self.verdict == Verdict::NoStiction && self.friction.delta_aic <= evidence
    }

    /// Whether the bound on f excludes friction of some size.
    ///
    /// * `detectable`: as in [`Answer::bound`]; the bound of an undecided record does not have it.
    pub fn excludes(&self, data: &IdData, detectable: Option<f64>) -> bool {
        let least = detectable.filter(|_| !self.verdict.is_undecided()).unwrap_or(0.0);
        let bound = self.friction.f_ci95[1].max(least * data.units.u);
        bound < EXCLUDES_NOTHING * data.f_max * data.units.u
    }

    /// Raises the upper end of the interval of f to this f (standard deviations of OP), which the record does not exclude once a model
    /// of a valve knows what OP tells of PV beyond its samples.
    pub fn hides_beyond_samples(&mut self, data: &IdData, f: f64) {
        let before = self.friction.f_ci95[1];
        let raised = before.max(f * data.units.u);
        self.friction.f_ci95[1] = raised;
        self.unrecorded = true;
        if let Verdict::NotIdentifiable(NotIdentifiable::Undecided { evidence, contradicted, .. }) =
            self.verdict
        {
            let most = data.units.along_op(raised.min(data.f_max * data.units.u));
            let unrecorded = raised > before;
            self.cannot_tell(NotIdentifiable::Undecided { evidence, contradicted, most, unrecorded });
        }
    }

    /// Bounds f from above where the verdict is no stiction. The bound is the larger of two: the end of the interval of f, and
    /// `detectable`, the least f that the record would have shown (standard deviations of OP). Where the bound excludes nothing, the
    /// verdict becomes hidden friction, so that no published bound is beyond the largest f that was tried. Returns the published
    /// least f that would have shown (OP unit).
    pub fn bound(&mut self, data: &IdData, detectable: Option<f64>) -> Option<f64> {
        let detectable = detectable.map(|f| f * data.units.u);
        if self.verdict != Verdict::NoStiction {
            return detectable;
        }
        let most = data.f_max * data.units.u;
        let bound = self.friction.f_ci95[1].max(detectable.unwrap_or(0.0));
        if bound < EXCLUDES_NOTHING * most {
            self.friction.f_ci95[1] = bound;
            // This is the only place that writes the bound into the sentence.
            self.reason += &could_be_hidden(bound, data.units.span);
            return detectable.map(|_| bound);
        }
        self.friction.f_ci95[1] = bound.min(most);
        let reversal = 2.0 * largest_move(&data.u, data.start.index) * data.units.u;
        let s = 2.0 * most;
        let friction = (s.is_finite() && s > 0.0).then(|| data.units.along_op(s));
        let reversal = data.units.along_op(reversal);
        let unrecorded = self.unrecorded;
        self.cannot_tell(NotIdentifiable::HiddenFriction { reversal, friction, excluded: None, unrecorded });
        None
    }

    /// Adds to hidden friction which friction the record excludes all the same, where tracing decided.
    ///
    /// * `excluded`: finds the least and the largest f of it (standard deviations of OP). It is asked only where friction is hidden,
    ///   because it fits many valves.
    pub fn tell_excluded(&mut self, data: &IdData, excluded: impl FnOnce() -> Option<[f64; 2]>) {
        let Verdict::NotIdentifiable(NotIdentifiable::HiddenFriction { reversal, friction, .. }) =
            &self.verdict
        else {
            return;
        };
        let (reversal, friction) = (reversal.clone(), friction.clone());
        if let Some(f) = self.by_tracing.then(excluded).flatten() {
            let excluded = Some(f.map(|f| data.units.along_op(2.0 * f * data.units.u)));
            let unrecorded = self.unrecorded;
            self.cannot_tell(NotIdentifiable::HiddenFriction { reversal, friction, excluded, unrecorded });
        }
    }

    /// Makes the verdict `not_identifiable`.
    fn cannot_tell(&mut self, why: NotIdentifiable) {
        self.reason = why.to_string();
        self.verdict = Verdict::NotIdentifiable(why);
    }
}

/// Friction by the diagnosis, without effects.
pub fn friction_before(diagnosis: &Diagnosis) -> Friction {
    diagnosis.estimate.as_ref().map_or_else(Friction::default, |e| Friction {
        f: e.f,
        f_ci95: e.f_ci95,
        lag: 0.0,
        delta_aic: e.delta_aic,
        posterior: f64::NAN,
    })
}
