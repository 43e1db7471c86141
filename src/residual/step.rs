//! One step of the selection: what the effects propose, fitted, judged and compared.

use super::candidate::{Candidate, Sought, tune, with_friction};
use super::climb::{CLIMBS, climb};
use super::effects::{ALL, Context};
use super::evidence::Judge;
use super::fit::minimise;
use super::free::{DOUBTLESS, likelier, not_beyond};
use super::model::{Data, Element, Spec};
use super::proposals::{BANDS, Rated, SHAPED, cost, loads, others};
use super::regress::{Quick, all_errors, restructure};
use super::run::held_out;
use super::search::even;
use super::{Kind, Settings};
use std::cell::OnceCell;

/// Candidates fitted in full at each step, those of them that may be of one kind, and fitted with friction scanned anew.
const FULL: usize = 18;
const FEW: usize = 3;
const FINAL: usize = 5;
/// Gain of the long ARX below which a proposal is not pursued (-).
const HOPELESS: f64 = -30.0;
/// The same of those whose gain is already known, and which they are.
const LITTLE: f64 = -4.0;
const EXACT: [Kind; 4] =
    [Kind::OscillatingLoad, Kind::MeasuredDisturbance, Kind::Drift, Kind::StaticNonlinearity];
/// Evidence below which an effect is none, below which another friction does not make it one, and how far behind the best it is
/// not worth trying (-).
const LOST: f64 = 1.0;
const PROMISING: f64 = 3.0;
const FAR_BEHIND: f64 = 20.0;
/// Evidence with dynamics of its own below which no other friction is sought for an effect, nor its valve offered; of a stem below
/// which none are estimated for it (-).
pub const PAST_SAVING: f64 = -5.0;
/// Gain of the long ARX, and evidence once fitted, from which a load that is a wave or a tag is tried before anything else is
/// sought (-).
const CLEAR_LOAD: f64 = 100.0;
/// Effects that no valve that is off looks like; a clip is not among them.
const UNLIKE_A_VALVE: [Kind; 5] = [
    Kind::StaticNonlinearity,
    Kind::GainChange,
    Kind::DeadTimeChange,
    Kind::AsymmetricFriction,
    Kind::FrictionDrift,
];
/// Evidence that the others need more where there is friction (-).
const STICKY: f64 = 5.0;
/// Effects between the stem and the process that a delay, a gain or a curve makes.
const ON_THE_WAY: [Kind; 3] = [Kind::StaticNonlinearity, Kind::GainChange, Kind::DeadTimeChange];
/// Effects that the held-out samples see only as what was fitted goes on: its rate, level or time may be off a little.
const LATER: [Kind; 5] =
    [Kind::LoadStep, Kind::Drift, Kind::GainChange, Kind::DeadTimeChange, Kind::FrictionDrift];
/// Evidence more that others need where held-out samples are less likely with them, although they run free nearer (-).
const DISAGREES: f64 = 8.0;
/// Evidence less that is needed where the held-out samples leave no doubt and run free nearer than this share (-).
const CLEAR: (f64, f64) = (4.0, 0.75);
/// Evidence, in parts of what is needed, for which any gain on the held-out samples is enough.
const OVERWHELMING: f64 = 3.0;
/// The same where they are hardly more likely (-).
const UNDECIDED: f64 = 3.0;
/// Evidence that a free run nearer by a factor of e is worth: when effects are accepted, and when they are compared (-).
const NEARER: f64 = 3.0;
const AHEAD: f64 = 10.0;
/// Gain of likelihood on the held-out samples, or held-out free-run error as a share of that without, that is no chance (-).
const LEAST_HELD: f64 = 2.0;
const LEAST_NEARER: f64 = 0.98;
/// Evidence by which a change of gain, which comes with a step of its own, must be ahead, and as a share of a step's: a stem
/// that is off looks like a change of gain beside one.
const NESTED: f64 = 10.0;
const OF_STEP: f64 = 0.5;
/// Evidence by which another valve takes the place of the one there is (-).
const OTHER_VALVE: f64 = 20.0;

/// An effect on trial, against the model without it.
pub struct Trial {
    /// The model with it.
    pub candidate: Candidate,
    /// Its kind.
    pub kind: Kind,
    /// Twice the log-likelihood gained over all samples, less what its numbers and the search for them cost.
    pub evidence: f64,
    /// Decrease of the penalised AIC on the fitted samples.
    gain: f64,
    /// Gain of likelihood on the held-out samples (-).
    held: f64,
    /// Held-out free-run error as a share of that without the effect, and of the declared model's.
    nearer: f64,
    of_start: f64,
}

/// A candidate fitted with its friction as it is: what it promises, and whether the valve is the model's own.
type Promised = (f64, bool, Candidate);

/// What one effect is chosen by.
struct Step<'a> {
    data: &'a Data,
    settings: &'a Settings,
    base: &'a Candidate,
    /// The declared model with its held-out errors, and those of `base`.
    declared: (&'a Spec, (f64, f64)),
    judged: (f64, f64),
    judge: &'a Judge,
    likely: Element,
    /// The valve of one band that explains most, sought as closely as those of which it grows, and what it gains.
    even: OnceCell<(f64, Element)>,
}

/// The best effect to add, if any earns its place; and the valve of one on trial, if the model without that effect is far
/// better with it. `quiet`: loss of the long ARX at which bands that differ or grow promised nothing.
pub fn step(
    data: &Data,
    settings: &Settings,
    base: &Candidate,
    declared: (&Spec, (f64, f64)),
    (quiet, tried): (&mut Option<f64>, &mut usize),
) -> (Option<Trial>, Option<Element>) {
    let (stage, e) = all_errors(data, &base.spec);
    let quick = Quick::long_arx(data, &stage, base.spec.orders.nk);
    let context = Context::new(data, (&base.spec, base.likely), (&stage, &e), &quick, settings);
    let (judge, likely) = (context.judge(), context.likely);
    let judged = held_out(data, &base.spec);
    let step = Step { data, settings, base, declared, judged, judge, likely, even: OnceCell::new() };
    let (mut full, mut finals) = (Vec::new(), Vec::new());
    let (clear, mut proposed): (Vec<Rated>, _) =
        loads(&context).into_iter().partition(|(rated, _)| *rated > CLEAR_LOAD && settings.only.is_none());
    if !clear.is_empty() {
        step.fitted(clear, &mut full, tried);
        if let Some(trial) = step.clear_load(&mut full, tried) {
            if trial.worth(settings.least_gain) {
                return step.choice(vec![trial]);
            }
            finals.push(trial);
        }
    }
    proposed.extend(others(&context, quiet));
    step.fitted(proposed, &mut full, tried);
    step.with_their_friction(full, &mut finals, tried);
    if settings.only.is_some() {
        return (finals.into_iter().max_by(|a, b| a.gain.total_cmp(&b.gain)), None);
    }
    step.choice(finals)
}

/// What tells apart the terms that are fitted: a ramp from the start and one from some time on go on differently.
fn key(spec: &Spec) -> Option<(Kind, usize)> {
    spec.terms.last().map(|t| (t.kind(), t.knobs().len()))
}

impl Step<'_> {
    /// Evidence of the signals with the last term.
    fn with_effect(&self, c: &Candidate) -> f64 {
        let base = self.base;
        let (stage, counts) = c.spec.stage(self.data);
        // Of two delays the linear part has the shorter one.
        let twofold = c.spec.terms.last().is_some_and(|t| t.kind() == Kind::DeadTimeChange);
        let nk = if twofold { base.spec.orders.nk.min(c.spec.orders.nk) } else { base.spec.orders.nk };
        let columns = counts.last().map_or(0.0, |n| *n as f64);
        self.judge.gain(self.data, &stage, nk) - 2.0 * columns - (c.paid - base.paid)
    }

    /// Evidence of another valve alone.
    fn with_valve(&self, element: Element) -> f64 {
        let valve = Spec { element, ..self.base.spec.clone() };
        self.judge.gain(self.data, &valve.stage(self.data).0, self.base.spec.orders.nk)
    }

    fn even(&self) -> (f64, Element) {
        *self.even.get_or_init(|| {
            let start = (f64::NEG_INFINITY, self.likely);
            let next = |element| {
                let next = even(self.data, &Spec { element, ..self.base.spec.clone() }).into_iter();
                next.map(|element| (self.with_valve(element), element)).max_by(|a, b| a.0.total_cmp(&b.0))
            };
            climb(start, 1 + CLIMBS, next).last().copied().unwrap_or(start)
        })
    }

    /// Evidence of the effect: the valve that was found with it may be the whole gain, or one as closely sought without it.
    fn evidence(&self, c: &Candidate) -> f64 {
        let gain = self.with_effect(c);
        if gain < LOST || c.spec.element == self.base.spec.element {
            return gain;
        }
        let bands = c.spec.terms.last().is_some_and(|t| BANDS.contains(&t.kind()));
        let even = if bands { self.even().0 } else { 0.0 };
        gain - self.with_valve(c.spec.element).max(even).max(0.0)
    }

    /// The proposals fitted with their friction as it is, the best of each sort, into `full`, best first.
    fn fitted(&self, mut proposals: Vec<Rated>, full: &mut Vec<Promised>, tried: &mut usize) {
        let Self { data, settings, base, .. } = *self;
        proposals.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (rated, p) in proposals {
            let own_valve = p.element.is_none();
            let own_key = Some((p.term.kind(), p.term.knobs().len()));
            let alike =
                full.iter().filter(|(_, own, c)| *own == own_valve && key(&c.spec) == own_key).count();
            let twice = alike >= if full.len() < FEW { 2 } else { 1 };
            let hopeless = if EXACT.contains(&p.term.kind()) { LITTLE } else { HOPELESS };
            let hopeless = rated < hopeless && !full.is_empty() && settings.only.is_none();
            if full.len() == FULL || twice || hopeless {
                continue;
            }
            let paid = base.paid + cost(settings, &p);
            let on_the_band = BANDS.contains(&p.term.kind());
            let mut spec = base.spec.clone();
            spec.terms.push(p.term);
            spec.element = p.element.unwrap_or(spec.element);
            if !own_valve && on_the_band {
                // A valve judged by the long model needs dynamics of its own before its lag may move.
                spec.loss = f64::INFINITY;
                restructure(data, &mut spec, false, 2);
            }
            minimise(data, &mut spec, true, 8);
            if spec.terms.last().is_some_and(|t| t.kind() == Kind::DeadTimeChange) {
                // Its delay is one of two now.
                restructure(data, &mut spec, true, 2);
            }
            tune(data, &mut spec, tried);
            *tried += 1;
            let candidate = Candidate::new(data, spec, paid);
            let promised = self.evidence(&candidate);
            // What another valve gains is no effect's.
            let promised = if own_valve { promised.max(base.aic - candidate.aic) } else { promised };
            full.push((promised, own_valve, candidate));
        }
        full.sort_by(|a, b| b.0.total_cmp(&a.0));
    }

    /// The load that a wave or a tag explains beyond doubt, with friction estimated anew: bands, gains and delays that are sought
    /// under it are blurred, and sought again once it is there. Taken out of `full`.
    fn clear_load(&self, full: &mut Vec<Promised>, tried: &mut usize) -> Option<Trial> {
        let (promised, _, best) = full.first()?;
        let shaped = best.spec.terms.last().is_some_and(|term| SHAPED.contains(&term.kind()));
        if !shaped || *promised < CLEAR_LOAD {
            return None;
        }
        let (.., candidate) = full.remove(0);
        self.on_trial(candidate, tried)
    }

    /// The best of the fitted with friction estimated anew, against the model without, into `finals`.
    fn with_their_friction(&self, full: Vec<Promised>, finals: &mut Vec<Trial>, tried: &mut usize) {
        let settings = self.settings;
        let mut done = Vec::new();
        for (promised, own_valve, candidate) in full {
            // Another friction does not save what is lost, nor does it let what is far behind catch up.
            let ahead =
                finals.iter().filter(|t| t.worth(settings.least_gain)).map(Trial::rank).fold(0.0, f64::max);
            if (promised < PROMISING || promised + FAR_BEHIND < ahead) && settings.only.is_none() {
                break;
            }
            let own_key = (own_valve, key(&candidate.spec));
            if finals.len() == FINAL || done.contains(&own_key) {
                continue;
            }
            let trial = self.on_trial(candidate, tried);
            // One that does not hold leaves its place to the next.
            if trial.as_ref().is_some_and(|trial| trial.worth(settings.least_gain)) {
                done.push(own_key);
            }
            finals.extend(trial);
        }
    }

    /// One of them; `None` where it is no such effect any more.
    fn on_trial(&self, mut candidate: Candidate, tried: &mut usize) -> Option<Trial> {
        let Self { data, declared, judged, .. } = *self;
        restructure(data, &mut candidate.spec, true, 3);
        let plain = candidate;
        let without_scan = self.with_effect(&plain);
        if without_scan < PAST_SAVING && self.settings.only.is_none() {
            return None;
        }
        // On its way to the process another kind of valve may go with it.
        let on_the_way = plain.spec.terms.last().is_some_and(|term| ON_THE_WAY.contains(&term.kind()));
        let sought = if on_the_way { Sought::Any { slips: false, paths: true } } else { Sought::Kept };
        let mut candidate = with_friction(data, plain.clone(), sought, tried);
        // What friction wins on the fitted samples it must win on all.
        if candidate.spec.element != plain.spec.element && self.with_effect(&candidate) < without_scan {
            candidate = Candidate { likely: candidate.likely, ..plain };
        }
        tune(data, &mut candidate.spec, tried);
        let term = candidate.spec.terms.last()?;
        if !ALL.iter().all(|effect| effect.plausible(term.as_ref())) {
            return None;
        }
        let kind = term.kind();
        candidate.spec.free = None;
        candidate =
            Candidate { likely: candidate.likely, ..Candidate::new(data, candidate.spec, candidate.paid) };
        let evidence = self.evidence(&candidate);
        let error = if evidence > self.settings.least_gain {
            let (spec, error) = not_beyond(
                data,
                candidate.spec,
                declared,
                judged,
                held_needed(evidence, self.settings.least_gain),
            );
            candidate.spec = spec;
            error
        } else {
            held_out(data, &candidate.spec)
        };
        let of_start = error.1 / declared.1.1;
        // Dynamics that ran free worse than the declared ones are no measure.
        let nearer = of_start.max(error.1 / judged.1);
        let gain = self.base.aic - candidate.aic;
        let held = likelier(data, judged.0, error.0);
        Some(Trial { candidate, kind, evidence, gain, held, nearer, of_start })
    }

    /// The best that is worth it; and another valve where that gains more.
    fn choice(&self, mut finals: Vec<Trial>) -> (Option<Trial>, Option<Element>) {
        let valves = finals.iter().map(|t| t.candidate.spec.element);
        let valves = valves.filter(|element| element.f > 0.0 && *element != self.base.spec.element);
        let valves = valves.map(|element| (self.with_valve(element), element));
        // Where bands gained anything it was sought to compare them with: it may be what the model lacks though they are no better.
        let even = self.even.get().copied();
        let valve = valves.chain(even).max_by(|a, b| a.0.total_cmp(&b.0));
        finals.retain(|t| t.worth(self.settings.least_gain));
        let steps = finals.iter().filter(|t| t.kind == Kind::LoadStep).map(|t| t.evidence);
        let of_step = OF_STEP * steps.fold(0.0, f64::max);
        let rank = |t: &Trial| t.rank() - if t.kind == Kind::GainChange { of_step } else { 0.0 };
        let best = finals.into_iter().max_by(|a, b| rank(a).total_cmp(&rank(b)));
        let least = best.as_ref().map_or(OTHER_VALVE, |best| best.evidence.max(OTHER_VALVE));
        (best, valve.filter(|valve| valve.0 > least).map(|valve| valve.1))
    }
}

/// Gain of likelihood on the held-out samples that an effect of so much evidence needs where it runs free no better: any is enough
/// where the evidence is overwhelming.
fn held_needed(evidence: f64, enough: f64) -> f64 {
    if evidence > OVERWHELMING * enough { 0.0 } else { DOUBTLESS }
}

impl Trial {
    /// Whether the effect earns its place: by the evidence of all samples, more of it where friction may be what is wrong, and
    /// less where the free run comes nearer; and by held-out errors that are smaller, one step ahead or run free.
    ///
    /// The free run is never beyond the declared model's.
    fn worth(&self, enough: f64) -> bool {
        let Self { kind, evidence, held, nearer, of_start, .. } = *self;
        let mut needed = enough + NEARER * nearer.clamp(0.2, 2.0).ln();
        let sticky = self.candidate.spec.element.f > 0.0 && !UNLIKE_A_VALVE.contains(&kind);
        let nearby = held > LEAST_HELD && nearer < CLEAR.1;
        if sticky && !nearby {
            needed += STICKY;
        }
        if held < 0.0 && !LATER.contains(&kind) {
            needed = needed.max(enough) + DISAGREES;
        } else if (0.0..LEAST_HELD).contains(&held) {
            needed += UNDECIDED;
        } else if held > DOUBTLESS && nearer < CLEAR.1 && !sticky {
            needed -= CLEAR.0;
        }
        let agrees = held > LEAST_HELD
            || nearer < LEAST_NEARER
            || (held > 0.0 && evidence > 1.5 * needed)
            || (nearer < 1.0 && evidence > OVERWHELMING * needed);
        evidence > needed
            && agrees
            && (of_start < 1.0 || (of_start <= 1.0 && held > held_needed(evidence, enough)))
    }

    /// What it is compared by with others that are worth it.
    fn rank(&self) -> f64 {
        let nested = if self.kind == Kind::GainChange { NESTED } else { 0.0 };
        self.evidence - AHEAD * self.nearer.clamp(0.1, 2.0).ln() - nested
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{behind_valve, noise, waves};

    /// A loop whose valve sticks at 1 (OP), under a load, and the declared model of it.
    fn loaded(load: impl Fn(usize) -> f64) -> (Data, Spec) {
        behind(1.0, load)
    }

    /// The same with a valve that sticks at `f`.
    fn behind(f: f64, load: impl Fn(usize) -> f64) -> (Data, Spec) {
        let mut draw = noise(7);
        let valve = Element { f, ..Element::default() };
        let data = behind_valve(&waves(1400), valve, 0.8, |k| load(k) + 0.05 * draw());
        let mut spec = declared(&data, f / data.scale.u);
        minimise(&data, &mut spec, false, 12);
        (data, spec)
    }

    /// What becomes of the best effect of a kind where the load jumps by `size` (PV), and how many models that took.
    fn on_trial(kind: Kind, size: f64) -> (Option<f64>, usize) {
        let (data, spec) = loaded(|k| if k >= 500 { size } else { 0.0 });
        let (stage, e) = all_errors(&data, &spec);
        let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
        let settings = Settings::default();
        let context = Context::new(&data, (&spec, spec.element), (&stage, &e), &quick, &settings);
        let proposed = loads(&context).into_iter().chain(others(&context, &mut None));
        let best = proposed.filter(|(_, p)| p.term.kind() == kind).take(1).collect();
        let judged = held_out(&data, &spec);
        let base = Candidate::new(&data, spec.clone(), 0.0);
        let of = Step {
            data: &data,
            settings: &settings,
            base: &base,
            declared: (&spec, judged),
            judged,
            judge: context.judge(),
            likely: context.likely,
            even: OnceCell::new(),
        };
        let (mut full, mut tried) = (Vec::new(), 0);
        of.fitted(best, &mut full, &mut 0);
        let (.., candidate) = full.pop().expect("one is best");
        let trial = of.on_trial(candidate, &mut tried);
        (trial.map(|trial| trial.evidence), tried)
    }

    #[test]
    fn friction_is_sought_anew_only_for_an_effect_that_the_signals_do_not_speak_against() {
        let (evidence, tried) = on_trial(Kind::LoadStep, 0.4);
        assert!(evidence.is_some_and(|evidence| evidence > 20.0) && tried > 0, "{evidence:?} {tried}");
        assert_eq!(on_trial(Kind::DeadTimeChange, 0.0), (None, 0));
    }

    #[test]
    fn beside_a_load_beyond_doubt_nothing_else_is_sought() {
        let settings = Settings::default();
        let wave = |k: usize| (0.41 * k as f64).sin();
        let jump = |k: usize| if k >= 500 { 1.0 } else { 0.0 };
        let loads: [(f64, &dyn Fn(usize) -> f64, _, _); 3] = [
            (0.5, &wave, Kind::OscillatingLoad, true),
            (0.03, &wave, Kind::OscillatingLoad, false),
            (0.5, &jump, Kind::LoadStep, false),
        ];
        for (size, load, kind, alone) in loads {
            let (data, spec) = loaded(|k| size * load(k));
            let base = Candidate::new(&data, spec.clone(), 0.0);
            let declared = (&spec, held_out(&data, &spec));
            // Bands were quiet at a loss so large that they are sought again.
            let mut quiet = Some(f64::MAX);
            let (found, _) = step(&data, &settings, &base, declared, (&mut quiet, &mut 0));
            assert_eq!(found.map(|found| found.kind), Some(kind), "{size}");
            assert_eq!(quiet == Some(f64::MAX), alone, "{size} {kind}");
        }
    }

    #[test]
    fn beside_a_wave_bands_are_sought_where_friction_is_certain() {
        let settings = Settings::default();
        // A valve that sticks, a sound one, and a sound one that the model takes for one that sticks.
        for (f, doubtful, sought) in [(1.0, 0.0, true), (0.0, 0.0, false), (0.0, 0.2, false)] {
            let (data, spec) = behind(f, |k| 0.5 * (0.41 * k as f64).sin());
            let base = Candidate::new(&data, spec.clone(), 0.0);
            let declared = (&spec, held_out(&data, &spec));
            let (found, _) = step(&data, &settings, &base, declared, (&mut None, &mut 0));
            let mut base = found.expect("the wave").candidate;
            base.spec.element.f = base.spec.element.f.max(doubtful / data.scale.u);
            minimise(&data, &mut base.spec, false, 12);
            // Bands were quiet at a loss so large that they are sought again.
            let mut quiet = Some(f64::MAX);
            step(&data, &settings, &base, declared, (&mut quiet, &mut 0));
            assert_eq!(quiet != Some(f64::MAX), sought, "{f} {doubtful}");
        }
    }
}
