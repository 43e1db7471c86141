//! Forward selection, one step: every kind of effect that may be added next is fitted, with friction and without.
//!
//! A hypothesis that was searched for less well than its rival loses wrongly. So whatever one of them finds is offered to the
//! others: dynamics, change times, valves, effects.
//!
//! 1. Every kind is screened, and its best proposals are fitted.
//! 2. Changes are moved to their best times, and each change is offered the times of the others.
//! 3. The valve is searched for again beside the leading kinds, and every valve is offered to every leading kind.
//! 4. The best of each leading kind is fitted to the end.

use super::findings::Kind;
use super::fit::{Fitted, NEAR, arx, fit_anew, fit_base, fit_near, fit_quick, refine, retime, scored};
use super::hypotheses::{ALL, variants};
use super::hypothesis::Hypothesis;
use super::posterior::{Table, friction_class};
use super::screening::Screen;
use super::valve_search::{Effort, Found, search};
use crate::sysid::armax::Armax;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Expected score behind the best of its kind up to which a proposal is fitted; a score twice as far behind the best of all ends
/// its fit (-).
const REACH: f64 = 25.0;
/// Score behind the best up to which a kind leads and is fitted to the end: beyond it its posterior is below 1e-5 (-).
pub const CLOSE: f64 = 12.0;
/// Leading kinds beside which the valve is searched for again.
const SEARCHED: usize = 3;
/// Valves beside which effects are screened.
const SCREENED: usize = 2;
/// Proposals of one kind that are fitted, with friction and without.
pub const FITTED: usize = 5;
/// Times of other changes that are fitted to the end for each change.
const OFFERED: usize = 2;
/// Iterations after which the proposals of a kind, or the times of a change, are compared.
const BEGUN: usize = 2;
/// Proposals of a kind that are fitted further after that.
const GO_ON: usize = 1;

/// A hypothesis that the screening proposes.
struct Screened {
    /// Its score, if its gain is what the score test says (-).
    expected: f64,
    /// Number of the hypothesis beside which it was screened.
    base: usize,
    /// Kind of its last effect.
    kind: Kind,
    /// The hypothesis.
    hypothesis: Hypothesis,
}

/// A proposal after its first iterations.
#[derive(Clone)]
struct Begun {
    /// Kind of its last effect, and whether it has friction.
    key: (Kind, bool),
    /// Number of the hypothesis beside which it was screened.
    base: usize,
    /// The fit.
    fitted: Fitted,
}

/// The comparison of hypotheses with at most one effect more than all of them share: one step, up to where valves of other steps
/// join it. So it can be ended with several sets of valves.
#[derive(Clone)]
pub struct Comparison<'a> {
    data: &'a IdData,
    /// Number of effects that all hypotheses share.
    count: usize,
    /// The hypotheses. The first one has no friction and no further effect.
    fitted: Vec<Fitted>,
    /// The valves that were found beside the effects that all share.
    pub valves: Vec<ValveModel>,
    /// The proposals without friction, after their first iterations.
    without_friction: Vec<Begun>,
    /// A kind that is known to be there: it is searched for more thoroughly.
    known_kind: Option<Kind>,
    /// Whether the valve is taken to be sound: then no hypothesis has friction.
    sound: bool,
}

impl<'a> Comparison<'a> {
    /// Compares the hypotheses with at most one effect more than `effects` has.
    ///
    /// * `effects`: its valve is not used.
    /// * `valves`: the valves that were found beside these effects.
    /// * `known_kind`: a kind that is known to be there.
    /// * `sound`: whether the valve is taken to be sound; then no valve is searched for.
    pub fn new(
        data: &'a IdData,
        effects: &Hypothesis,
        valves: &[Found],
        known_kind: Option<Kind>,
        sound: bool,
    ) -> Self {
        let mut fitted = vec![fit_base(data, effects.with_valve(None))];
        fitted.extend(
            valves
                .iter()
                .map(|found| fit_anew(data, effects.with_valve(Some(found.valve)), Some(&found.fit))),
        );
        let (count, valves) = (effects.effects.len(), valves.iter().map(|found| found.valve).collect());
        let mut own = Self { data, count, fitted, valves, without_friction: Vec::new(), known_kind, sound };
        own.propose();
        own
    }

    /// The same where the valve is taken to be sound. What does not depend on friction is not fitted again.
    pub fn without_friction(&self) -> Self {
        let bases: Vec<Fitted> = self.fitted.iter().take(1).cloned().collect();
        let (fitted, begun) = (bases.clone(), self.without_friction.clone());
        let mut own = Self { fitted, valves: Vec::new(), sound: true, ..self.clone() };
        own.go_on(&bases, begun);
        own
    }

    /// The comparison beside other effects, with the valves that are found from those in the `pool`.
    pub fn beside(&self, effects: &Hypothesis, pool: &[ValveModel]) -> Self {
        let found = if self.sound { Vec::new() } else { search(self.data, effects, pool, Effort::Near) };
        Self::new(self.data, effects, &found, self.known_kind, self.sound)
    }

    /// All hypotheses of the step, fitted.
    ///
    /// * `pool`: valves that were found earlier; they are offered to all hypotheses, and those found here are added.
    pub fn finish(&self, pool: &mut Vec<ValveModel>) -> Vec<Fitted> {
        add_new(pool, self.valves.iter().copied());
        let mut own = self.clone();
        if !own.sound {
            own.search_beside(pool);
            own.offer_valves(pool);
            own.end();
        }
        own.fitted
    }

    /// The kind of the effect that a hypothesis has beyond those that all share.
    fn kind(&self, fitted: &Fitted) -> Option<Kind> {
        fitted.kind().filter(|_| fitted.hypothesis.effects.len() > self.count)
    }

    /// The hypothesis with the largest score of a kind, in some classes of friction ([`friction_class`]).
    fn best(&self, kind: Option<Kind>, of_class: impl Fn(usize) -> bool) -> Option<&Fitted> {
        let own =
            self.fitted.iter().filter(|d| self.kind(d) == kind && of_class(friction_class(&d.hypothesis)));
        own.max_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// The kinds whose scores are near the best, the best first; `None` (no further effect) is always among them.
    fn leading(&self) -> Vec<Option<Kind>> {
        let mut kinds: Vec<(Option<Kind>, f64)> = Vec::new();
        for fitted in &self.fitted {
            let kind = self.kind(fitted);
            match kinds.iter_mut().find(|k| k.0 == kind) {
                Some(known) => known.1 = known.1.max(fitted.score),
                None => kinds.push((kind, fitted.score)),
            }
        }
        kinds.sort_by(|a, b| b.1.total_cmp(&a.1));
        let enough = kinds.first().map_or(0.0, |k| k.1) - CLOSE;
        kinds.retain(|k| k.1 >= enough || k.0.is_none());
        kinds.into_iter().map(|k| k.0).collect()
    }

    /// Screens every kind beside no friction and the best valves, and fits the effects with the largest expected scores.
    fn propose(&mut self) {
        let count = 1 + if self.known_kind.is_some() { 8 } else { SCREENED };
        let bases: Vec<Fitted> = self.fitted.iter().take(count).cloned().collect();
        let proposed = self.screened(&bases);
        let begun = self.fit_proposals(&bases, proposed);
        self.without_friction = begun.iter().filter(|begun| !begun.key.1).cloned().collect();
        self.go_on(&bases, begun);
    }

    /// Goes on with the proposals that were begun, up to where valves are searched for. Without friction none is: the step ends.
    fn go_on(&mut self, bases: &[Fitted], begun: Vec<Begun>) {
        self.continue_best(bases, begun);
        self.retime();
        self.offer_effects();
        self.offer_times();
        if self.sound {
            self.end();
        }
    }

    /// Fits the leading hypotheses to the end.
    fn end(&mut self) {
        self.offer_special_cases();
        self.fit_to_the_end();
        self.offer_times();
    }

    /// The hypotheses that the screening proposes beside each of `bases`, those with the largest expected score first.
    fn screened(&self, bases: &[Fitted]) -> Vec<Screened> {
        let mut proposed = Vec::new();
        for (at, base) in bases.iter().enumerate() {
            let mut screen = Screen::new(self.data, base);
            for hypothesis in ALL {
                screen.thorough = self.known_kind == Some(hypothesis.kind());
                let proposals = hypothesis.propose(&screen);
                for proposal in proposals {
                    let other = base.hypothesis.with(proposal.effect);
                    let other = other.with_valve(proposal.valve.or(base.hypothesis.valve));
                    let expected = scored(self.data, &other, base.model.log_likelihood + proposal.gain);
                    proposed.push(Screened {
                        expected,
                        base: at,
                        kind: hypothesis.kind(),
                        hypothesis: other,
                    });
                }
            }
        }
        proposed.retain(|own| !self.sound || own.hypothesis.valve.is_none());
        proposed.sort_by(|a, b| b.expected.total_cmp(&a.expected));
        proposed
    }

    /// The best proposals of each kind, with friction and without, fitted for a few iterations.
    fn fit_proposals(&self, bases: &[Fitted], proposed: Vec<Screened>) -> Vec<Begun> {
        let mut taken: Vec<((Kind, bool), f64)> = Vec::new();
        let mut begun: Vec<Begun> = Vec::new();
        for Screened { expected, base, kind, hypothesis } in proposed {
            let key = (kind, hypothesis.valve.is_some());
            let of_kind: Vec<f64> =
                taken.iter().filter(|taken| taken.0 == key).map(|taken| taken.1).collect();
            let is_known = self.known_kind == Some(kind);
            // Expected scores are compared within one kind only: a score test knows no bounds of parameters.
            let enough = of_kind.first().map_or(f64::NEG_INFINITY, |first| first - REACH);
            if of_kind.len() < if is_known { 60 } else { FITTED } && (is_known || expected >= enough) {
                taken.push((key, expected));
                let fitted = fit_near(self.data, hypothesis, &bases[base].model, BEGUN);
                begun.push(Begun { key, base, fitted });
            }
        }
        begun.sort_by(|a, b| b.fitted.score.total_cmp(&a.fitted.score));
        begun
    }

    /// Fits the best of each kind further, with friction and without; all of them join the comparison.
    fn continue_best(&mut self, bases: &[Fitted], begun: Vec<Begun>) {
        let most = self.fitted.iter().chain(begun.iter().map(|begun| &begun.fitted)).map(|d| d.score);
        let enough = most.fold(f64::NEG_INFINITY, f64::max) - 2.0 * REACH;
        let mut continued: Vec<(Kind, bool)> = Vec::new();
        for Begun { key, base, fitted } in begun {
            let is_known = self.known_kind == Some(key.0);
            let before = continued.iter().filter(|other| **other == key).count();
            if is_known || before < GO_ON && fitted.score >= enough {
                continued.push(key);
                self.fitted.push(fit_quick(self.data, fitted.hypothesis, &bases[base].model));
            } else {
                self.fitted.push(fitted);
            }
        }
    }

    /// The best hypothesis of each leading kind of lasting change, with friction and without.
    fn with_change_times(&self) -> Vec<Fitted> {
        let timed =
            |d: &&Fitted| d.hypothesis.effects.last().is_some_and(|effect| effect.change_time().is_some());
        let each = |kind| [false, true].map(|friction| self.best(kind, |class| (class > 0) == friction));
        let leading = self.leading().into_iter().filter(Option::is_some);
        leading.flat_map(each).flatten().filter(timed).cloned().collect()
    }

    /// Moves each change to its best time.
    fn retime(&mut self) {
        let moved: Vec<Fitted> =
            self.with_change_times().into_iter().map(|best| retime(self.data, best)).collect();
        self.fitted.extend(moved);
    }

    /// Offers the time of every change to the others, also one dead time earlier and later: PV shows a change of the stem one dead
    /// time after a change of a load.
    fn offer_times(&mut self) {
        let at = |d: &Fitted| d.hypothesis.effects.last().and_then(|effect| effect.change_time());
        let found = self.with_change_times();
        for own in &found {
            let mut others = own.hypothesis.clone();
            let Some(last) = others.effects.pop() else { continue };
            let nk = own.model.nk;
            let apart = |time: usize| [time, time + nk, time.saturating_sub(nk)];
            let mut times: Vec<usize> = found.iter().filter_map(at).flat_map(apart).collect();
            times.retain(|time| (self.data.first..self.data.split).contains(time));
            times.sort_unstable();
            times.dedup();
            let offered = times.into_iter().flat_map(|time| variants(last.with_change_time(time).as_ref()));
            let mut begun: Vec<Fitted> =
                offered.map(|effect| fit_near(self.data, others.with(effect), &own.model, BEGUN)).collect();
            begun.sort_by(|a, b| b.score.total_cmp(&a.score));
            let best = begun.into_iter().take(OFFERED);
            self.fitted.extend(best.map(|d| fit_near(self.data, d.hypothesis, &d.model, NEAR)));
        }
    }

    /// Fits the special cases of the leading changes: a change of gain by a ratio of 1 is a load step.
    fn offer_special_cases(&mut self) {
        let mut offered = Vec::new();
        for own in self.with_change_times() {
            let mut other = own.hypothesis.clone();
            let special = other.effects.pop().and_then(|last| last.special_case());
            offered.extend(
                special.map(|effect| {
                    retime(self.data, fit_near(self.data, other.with(effect), &own.model, NEAR))
                }),
            );
        }
        self.fitted.extend(offered);
    }

    /// Offers the effects that were found beside friction to the hypothesis without friction, and the other way round.
    fn offer_effects(&mut self) {
        for friction in [false, true] {
            let other = self.best(None, |class| (class > 0) != friction).cloned();
            let least = self.best(None, |class| (class > 0) == friction).map(|none| none.score);
            let (Some(other), Some(least)) = (other, least) else { continue };
            let all = ALL.iter().filter_map(|kind| self.best(Some(kind.kind()), |c| (c > 0) == friction));
            // An effect that does not raise the score where it was found is not worth a fit.
            let effects = all.filter(|found| found.score > least).filter_map(|f| f.hypothesis.effects.last());
            let hypotheses: Vec<Hypothesis> =
                effects.map(|effect| other.hypothesis.with(effect.boxed())).collect();
            self.fitted.extend(hypotheses.into_iter().map(|h| fit_near(self.data, h, &other.model, NEAR)));
        }
    }

    /// Searches for the valve again beside the leading effects.
    fn search_beside(&mut self, pool: &mut Vec<ValveModel>) {
        for kind in self.leading().into_iter().filter(Option::is_some).take(SEARCHED) {
            let Some(best) = self.best(kind, |_| true).cloned() else { continue };
            let mut starts = pool.clone();
            starts.truncate(SCREENED);
            starts.extend(self.best(kind, |class| class > 0).and_then(|d| d.hypothesis.valve));
            let found = search(self.data, &best.hypothesis, &starts, Effort::Near);
            add_new(pool, found.iter().map(|found| found.valve));
            for found in found.iter().take(2) {
                let hypothesis = best.hypothesis.with_valve(Some(found.valve));
                self.fitted.push(fit_quick(self.data, hypothesis, &best.model));
            }
        }
    }

    /// Offers every valve that was found to every leading kind: they are ranked by the high-order ARX, and the best is fitted.
    fn offer_valves(&mut self, pool: &[ValveModel]) {
        for kind in self.leading() {
            let Some(best) = self.best(kind, |class| class > 0).or_else(|| self.best(kind, |_| true)) else {
                continue;
            };
            let best = best.clone();
            let near = arx(self.data, &best.hypothesis, None);
            let rate = |valve: &ValveModel| {
                let other = best.hypothesis.with_valve(Some(*valve));
                let fit = arx(self.data, &other, Some(&near));
                (scored(self.data, &other, fit.log_likelihood), other)
            };
            let others = pool.iter().filter(|valve| Some(**valve) != best.hypothesis.valve).map(rate);
            let other = others.max_by(|a, b| a.0.total_cmp(&b.0));
            self.fitted.extend(other.map(|(_, other)| fit_quick(self.data, other, &best.model)));
        }
    }

    /// Fits the best of each leading kind and class of friction (none, J = S, J free) to the end, from several starts: from nothing,
    /// and from the best dynamics of each class of friction.
    fn fit_to_the_end(&mut self) {
        let of_class = |of: usize| {
            let own = self.fitted.iter().filter(|d| friction_class(&d.hypothesis) == of);
            own.max_by(|a, b| a.score.total_cmp(&b.score)).map(|d| d.model.clone())
        };
        let leaders: Vec<Armax> = (0..3).filter_map(of_class).collect();
        let mut settled = Vec::new();
        let most = self.fitted.iter().map(|d| d.score).fold(f64::NEG_INFINITY, f64::max);
        for kind in self.leading() {
            for of in 0..3 {
                let Some(best) = self.best(kind, |class| class == of).filter(|d| d.score > most - CLOSE)
                else {
                    continue;
                };
                // The first hypothesis was fitted anew already. Where it has no smooth parameters, its start is the same.
                let again = kind.is_none() && of == 0 && best.hypothesis.smooth().is_empty();
                let anew = (!again).then(|| fit_anew(self.data, best.hypothesis.clone(), None));
                let begun = anew.filter(|anew| anew.score > best.score).unwrap_or_else(|| best.clone());
                let offered =
                    leaders.iter().map(|model| fit_near(self.data, best.hypothesis.clone(), model, NEAR));
                let best = offered.fold(begun, |a, b| if b.score > a.score { b } else { a });
                settled.push(if kind.is_some() { refine(self.data, best) } else { best });
            }
        }
        self.fitted.extend(settled);
    }
}

/// Adds the valves that differ from all in the pool.
fn add_new(pool: &mut Vec<ValveModel>, valves: impl Iterator<Item = ValveModel>) {
    for valve in valves {
        let same = |other: &ValveModel| {
            other.rule == valve.rule
                && (other.s / valve.s - 1.0).abs() < 2e-3
                && (other.j - valve.j).abs() < 0.02 * valve.s
        };
        if !pool.iter().any(same) {
            pool.push(valve);
        }
    }
}

/// The posterior of the kinds of next effect.
pub fn table<'a>(fitted: &'a [Fitted], effects: &Hypothesis) -> Table<'a> {
    Table::new(fitted, effects.effects.len(), ALL.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::tests::behind_dead_band;

    /// A load that steps beside a dead band.
    fn record() -> IdData {
        behind_dead_band(700, |k| if k < 300 { 0.0 } else { 0.1 })
    }

    fn told(fitted: &[Fitted]) -> Vec<String> {
        fitted.iter().map(|fitted| format!("{fitted:?}")).collect()
    }

    #[test]
    fn what_is_shared_with_friction_is_what_is_fitted_without_it_to_the_last_bit() {
        let (data, none) = (record(), Hypothesis::default());
        let found = search(&data, &none, &[], Effort::Grid);
        for known_kind in [None, Some(Kind::LoadStep)] {
            let beside_friction = Comparison::new(&data, &none, &found, known_kind, false);
            let sticks = |d: &Fitted| d.hypothesis.valve.is_some();
            assert!(
                beside_friction.fitted.iter().any(sticks) && !beside_friction.without_friction.is_empty()
            );
            let [shared, alone] =
                [beside_friction.without_friction(), Comparison::new(&data, &none, &[], known_kind, true)]
                    .map(|own| told(&own.finish(&mut Vec::new())));
            assert_eq!(shared, alone);
        }
    }

    #[test]
    fn a_step_that_is_repeated_with_other_valves_is_that_step_done_anew() {
        let (data, none) = (record(), Hypothesis::default());
        let found = search(&data, &none, &[], Effort::Grid);
        let first = Comparison::new(&data, &none, &found, None, false);
        let base = fit_anew(&data, first.fitted[0].hypothesis.clone(), None);
        assert_eq!(told(&[base]), told(&first.fitted[..1]), "the first one is fitted only once");
        let other = ValveModel { s: 0.7, j: 0.2, ..ValveModel::default() };
        let mut pools = [vec![], vec![other]];
        let [_, repeated] = pools.each_mut().map(|pool| told(&first.finish(pool)));
        // A valve of the effects that all share is not used.
        let anew = Comparison::new(&data, &none.with_valve(Some(other)), &found, None, false);
        let mut pool = vec![other];
        assert_eq!(repeated, told(&anew.finish(&mut pool)));
        assert_eq!(pools[1], pool);
        assert_ne!(pools[0], pool);
    }
}
