//! Forward selection: the likeliest effect is added, then all is asked again beside it.

use super::Kind;
use super::fit::{Fitted, NEAR, arx, fit_anew, fit_base, fit_near, fit_quick, refine, retime, scored};
use super::hypotheses::ALL;
use super::hypothesis::Hypothesis;
use super::posterior::{Table, class};
use super::screening::Screen;
use super::valve_search::{Effort, Found, search};
use crate::sysid::armax::Armax;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Promise behind the best of its kind up to which a proposal is fitted; twice this behind the best score it is left (-).
const REACH: f64 = 25.0;
/// Score behind the best up to which a kind leads and is fitted to the end: beyond it its posterior is none (-).
pub const CLOSE: f64 = 12.0;
/// Kinds beside which friction is searched again.
const SEARCHED: usize = 3;
/// Valves beside which effects are screened.
const SCREENED: usize = 2;
/// Proposals of one kind that are fitted, with friction and without.
pub const FITTED: usize = 5;
/// Times of other changes that are fitted to the end for each change.
const OFFERED: usize = 2;
/// Iterations after which proposals of a kind (or times of a change) are compared.
const BEGUN: usize = 2;
/// Proposals of a kind that go on after that.
const GO_ON: usize = 1;

/// The hypotheses with at most one effect more than the `count` that all share.
pub struct Comparison<'a> {
    data: &'a IdData,
    count: usize,
    /// The hypotheses.
    pub fitted: Vec<Fitted>,
    /// A kind that is known to be there: it is searched more thoroughly.
    told: Option<Kind>,
    /// Whether the valve is taken to be sound: then no valve competes.
    sound: bool,
}

impl Comparison<'_> {
    /// The kind of a hypothesis' effect beyond those that all share.
    fn kind(&self, fitted: &Fitted) -> Option<Kind> {
        fitted.kind().filter(|_| fitted.hypothesis.effects.len() > self.count)
    }

    fn best(&self, kind: Option<Kind>, of_class: impl Fn(usize) -> bool) -> Option<&Fitted> {
        let own = self.fitted.iter().filter(|d| self.kind(d) == kind && of_class(class(&d.hypothesis)));
        own.max_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// The kinds that lead, the best first, none always among them.
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

    /// Screens every kind beside no friction and the best valves, and fits what promises most.
    fn propose(&mut self) {
        let bases: Vec<Fitted> =
            self.fitted.iter().take(1 + if self.told.is_some() { 8 } else { SCREENED }).cloned().collect();
        let mut proposed = Vec::new();
        for (at, base) in bases.iter().enumerate() {
            let mut screen = Screen::new(self.data, base);
            for hypothesis in ALL {
                screen.thorough = self.told == Some(hypothesis.kind());
                let proposals = hypothesis.propose(&screen);
                for proposal in proposals {
                    let other = base.hypothesis.with(proposal.effect);
                    let other = other.with_valve(proposal.valve.or(base.hypothesis.valve));
                    let promised = scored(self.data, &other, base.model.log_likelihood + proposal.gain);
                    proposed.push((promised, at, hypothesis.kind(), other));
                }
            }
        }
        proposed.retain(|own| !self.sound || own.3.valve.is_none());
        proposed.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut taken: Vec<((Kind, bool), f64)> = Vec::new();
        let mut begun: Vec<((Kind, bool), usize, Fitted)> = Vec::new();
        for (promised, at, kind, hypothesis) in proposed {
            let key = (kind, hypothesis.valve.is_some());
            let of_kind: Vec<f64> =
                taken.iter().filter(|taken| taken.0 == key).map(|taken| taken.1).collect();
            let told = self.told == Some(kind);
            // What one kind is promised says nothing of another: a score test knows no bounds.
            let enough = of_kind.first().map_or(f64::NEG_INFINITY, |first| first - REACH);
            if of_kind.len() < if told { 60 } else { FITTED } && (told || promised >= enough) {
                taken.push((key, promised));
                begun.push((key, at, fit_near(self.data, hypothesis, &bases[at].model, BEGUN)));
            }
        }
        // The best of each kind goes on.
        begun.sort_by(|a, b| b.2.score.total_cmp(&a.2.score));
        let most = self.fitted.iter().chain(begun.iter().map(|begun| &begun.2)).map(|d| d.score);
        let enough = most.fold(f64::NEG_INFINITY, f64::max) - 2.0 * REACH;
        let mut gone_on: Vec<(Kind, bool)> = Vec::new();
        for (key, at, fitted) in begun {
            let told = self.told == Some(key.0);
            let before = gone_on.iter().filter(|other| **other == key).count();
            if told || before < GO_ON && fitted.score >= enough {
                gone_on.push(key);
                self.fitted.push(fit_quick(self.data, fitted.hypothesis, &bases[at].model));
            } else {
                self.fitted.push(fitted);
            }
        }
    }

    /// The best of each leading kind with a change at a time, with friction and without.
    fn timed(&self) -> Vec<Fitted> {
        let timed = |d: &&Fitted| d.hypothesis.effects.last().is_some_and(|effect| effect.at().is_some());
        let each = |kind| [false, true].map(|friction| self.best(kind, |class| (class > 0) == friction));
        let leading = self.leading().into_iter().filter(Option::is_some);
        leading.flat_map(each).flatten().filter(timed).cloned().collect()
    }

    /// Moves changes to their best times.
    fn retime(&mut self) {
        let moved: Vec<Fitted> = self.timed().into_iter().map(|best| retime(self.data, best)).collect();
        self.fitted.extend(moved);
    }

    /// Offers the time of every change to the others: of a stem's to a load's a delay later, and back.
    fn offer_times(&mut self) {
        let at = |d: &Fitted| d.hypothesis.effects.last().and_then(|effect| effect.at());
        let found = self.timed();
        for own in &found {
            let mut others = own.hypothesis.clone();
            let Some(last) = others.effects.pop() else { continue };
            let nk = own.model.nk;
            let apart = |time: usize| [time, time + nk, time.saturating_sub(nk)];
            let mut times: Vec<usize> = found.iter().filter_map(at).flat_map(apart).collect();
            times.retain(|time| (self.data.first..self.data.split).contains(time));
            times.sort_unstable();
            times.dedup();
            let offered = times.into_iter().flat_map(|time| last.moved(time).variants());
            let mut begun: Vec<Fitted> =
                offered.map(|effect| fit_near(self.data, others.with(effect), &own.model, BEGUN)).collect();
            begun.sort_by(|a, b| b.score.total_cmp(&a.score));
            let best = begun.into_iter().take(OFFERED);
            self.fitted.extend(best.map(|d| fit_near(self.data, d.hypothesis, &d.model, NEAR)));
        }
    }

    /// Fits what the leading effects are at one value of a parameter.
    fn offer_special_cases(&mut self) {
        let mut offered = Vec::new();
        for own in self.timed() {
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

    /// Offers the effects that explain something beside friction to the hypothesis without friction, and back.
    fn offer_effects(&mut self) {
        for friction in [false, true] {
            let other = self.best(None, |class| (class > 0) != friction).cloned();
            let least = self.best(None, |class| (class > 0) == friction).map(|none| none.score);
            let (Some(other), Some(least)) = (other, least) else { continue };
            let all = ALL.iter().filter_map(|kind| self.best(Some(kind.kind()), |c| (c > 0) == friction));
            // What explains nothing beside its own friction is not worth a fit.
            let effects = all.filter(|found| found.score > least).filter_map(|f| f.hypothesis.effects.last());
            let hypotheses: Vec<Hypothesis> =
                effects.map(|effect| other.hypothesis.with(effect.boxed())).collect();
            self.fitted.extend(hypotheses.into_iter().map(|h| fit_near(self.data, h, &other.model, NEAR)));
        }
    }

    /// Searches friction again beside the leading effects.
    fn search_beside(&mut self, pool: &mut Vec<ValveModel>) {
        for kind in self.leading().into_iter().filter(Option::is_some).take(SEARCHED) {
            let Some(best) = self.best(kind, |_| true).cloned() else { continue };
            let mut starts = pool.clone();
            starts.truncate(SCREENED);
            starts.extend(self.best(kind, |class| class > 0).and_then(|d| d.hypothesis.valve));
            let found = search(self.data, &best.hypothesis, &starts, Effort::Near);
            add(pool, found.iter().map(|found| found.valve));
            for found in found.iter().take(2) {
                let hypothesis = best.hypothesis.with_valve(Some(found.valve));
                self.fitted.push(fit_quick(self.data, hypothesis, &best.model));
            }
        }
    }

    /// Offers every valve that was found to every leading kind: ranked by the high-order ARX, the best is fitted.
    fn offer(&mut self, pool: &[ValveModel]) {
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

    /// Fits the best of each leading kind, with friction (J = S and J free) and without, to the end: from nothing and from the
    /// best dynamics that any of them has, with friction and without.
    fn settle(&mut self) {
        let of_class = |of: usize| {
            let own = self.fitted.iter().filter(|d| class(&d.hypothesis) == of);
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
                let anew = fit_anew(self.data, best.hypothesis.clone(), None);
                let offered =
                    leaders.iter().map(|model| fit_near(self.data, best.hypothesis.clone(), model, NEAR));
                let best = offered.fold(if anew.score > best.score { anew } else { best.clone() }, |a, b| {
                    if b.score > a.score { b } else { a }
                });
                settled.push(if kind.is_some() { refine(self.data, best) } else { best });
            }
        }
        self.fitted.extend(settled);
    }
}

/// The hypotheses with at most one effect more than `effects` has, fitted.
///
/// * `valves`: those found beside `effects`.
/// * `pool`: valves found before, which are offered to all and added to.
/// * `sound`: whether the valve is taken to be sound; then no valve is searched for.
pub fn compare(
    data: &IdData,
    effects: &Hypothesis,
    valves: &[Found],
    pool: &mut Vec<ValveModel>,
    told: Option<Kind>,
    sound: bool,
) -> Vec<Fitted> {
    add(pool, valves.iter().map(|found| found.valve));
    let mut fitted = vec![fit_base(data, effects.with_valve(None))];
    fitted.extend(
        valves.iter().map(|found| fit_anew(data, effects.with_valve(Some(found.valve)), Some(&found.fit))),
    );
    let mut comparison = Comparison { data, count: effects.effects.len(), fitted, told, sound };
    comparison.propose();
    comparison.retime();
    comparison.offer_effects();
    comparison.offer_times();
    if !sound {
        comparison.search_beside(pool);
        comparison.offer(pool);
    }
    comparison.offer_special_cases();
    comparison.settle();
    comparison.offer_times();
    comparison.fitted
}

/// Adds valves that are new.
fn add(pool: &mut Vec<ValveModel>, valves: impl Iterator<Item = ValveModel>) {
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

/// The posterior of the next effect.
pub fn table<'a>(fitted: &'a [Fitted], effects: &Hypothesis) -> Table<'a> {
    Table::new(fitted, effects.effects.len(), ALL.len())
}
