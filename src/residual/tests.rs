//! What is traced at all, and what is published of friction that is not told.

use super::fit::{Fitted, fit_anew};
use super::hypothesis::Hypothesis;
use super::interval::interval;
use super::verdict::{Answer, Question};
use super::*;
use crate::diagnosis::rivals::Rival;
use crate::diagnosis::verdict::could_be_hidden;
use crate::diagnosis::verdict::tests::estimate;
use crate::diagnosis::{
    Acquisition, Estimate, HistoryFound, HistoryKind, NotIdentifiable, Preparation, Verdict, diagnose,
    diagnose_gated,
};
use crate::signal::{Role, Sample};
use crate::sim::scenarios::table2_loop;
use crate::sim::{LoopSpec, SensorSpec, simulate};
use crate::sysid::armax::Armax;
use crate::sysid::iddata::{IdData, Units};
use crate::sysid::stats::quantile;
use crate::sysid::valve::{Start, ValveModel};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// The paper's level loop whose valve sticks, of so many samples, so long apart (s).
pub(super) fn sticking(n: usize, ts: f64) -> Record {
    let friction = crate::sim::Friction::Choudhury { s: 5.0, j: 1.5, resolution: 0.005 };
    let spec = LoopSpec { sensor: SensorSpec::noisy(0.02), ..table2_loop(true, friction) };
    let run = simulate(&spec, 1000 + n, 1).expect("can be simulated").after(1000);
    let series = |v: &[f64]| v.iter().enumerate().map(|(k, v)| Sample::good(k as f64 * ts, *v)).collect();
    Record { op: series(&run.op), pv: series(&run.pv), op_span: Some(100.0), ..Record::default() }
}

#[test]
fn rows_that_repeat_a_reading_are_not_traced() {
    let record = sticking(600, 3.0);
    let traced = |ts: Option<f64>| {
        let settings = diagnosis::Settings { ts, ..diagnosis::Settings::default() };
        assert!(gate(&record, &settings).is_ok(), "the gate lets {ts:?} pass");
        let found = match ts {
            Some(_) => diagnose(&record, &settings),
            None => Diagnosis::bare(Verdict::NoStiction, "made for a test"),
        };
        let refused = matches!(&found.verdict, Verdict::NotIdentifiable(NotIdentifiable::TsTooShort { .. }));
        (refused, window(&record, &found, &settings).is_some(), found)
    };
    let (refused, is_traced, found) = traced(Some(1.0));
    assert_eq!((refused, is_traced), (true, false), "{}", found.reason);
    let settings = diagnosis::Settings { ts: Some(1.0), ..diagnosis::Settings::default() };
    assert_eq!(trace_record(&record, &found, &settings, &Settings::default()), None);
    let (refused, is_traced, _) = traced(None);
    assert_eq!((refused, is_traced), (false, true));
}

#[test]
fn what_the_gate_said_is_not_asked_again() {
    let (record, settings) = (sticking(600, 1.0), diagnosis::Settings::default());
    let tracing = Settings::default();
    let gated = gate(&record, &settings);
    let found = diagnose_gated(&record, &gated, &settings);
    assert_eq!(found.reason, diagnose(&record, &settings).reason);
    let whole = window_of(&gated, &found).expect("it is traced");
    assert_eq!(Some(whole), window(&record, &found, &settings));
    let why = NotIdentifiable::NoTimeBase;
    let refused: Gated = Err(Box::new((why.clone(), Preparation::default())));
    assert_eq!(diagnose_gated(&record, &refused, &settings).verdict, Verdict::NotIdentifiable(why));
    assert_eq!(trace_gated(&record, &refused, &found, &settings, &tracing), None);
    assert_eq!(confirm_gated(&record, &refused, &settings, &tracing, &Structure::default()), None);
}

#[test]
fn an_oscillation_that_is_too_fast_for_the_samples_is_not_traced() {
    let noise = |k: usize| (1.3 * (k * k) as f64).sin();
    let wave = |level: f64, phase: f64| -> Vec<Sample> {
        let value = |k: usize| level + (TAU * k as f64 / 2.2 + phase).sin() + 0.1 * noise(k);
        (0..600).map(|k| Sample::good(k as f64, value(k))).collect()
    };
    let record = Record { op: wave(50.0, 0.0), pv: wave(20.0, 1.0), ..Record::default() };
    let settings = diagnosis::Settings::default();
    let found = diagnose(&record, &settings);
    let refused = matches!(found.verdict, Verdict::NotIdentifiable(NotIdentifiable::Undersampled { .. }));
    assert!(refused && gate(&record, &settings).is_ok(), "{}", found.reason);
    assert!(window(&record, &found, &settings).is_none());
}

/// A lag behind a dead band of 2 whose OP swings slowly by ±5, with a load that enters its equation.
pub(super) fn behind_dead_band(n: usize, load: impl Fn(usize) -> f64) -> IdData {
    let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(3));
    let mut next = || -> f64 { draw.next().unwrap_or(0.0) };
    let swing = |k: usize| 3.0 * (0.055 * k as f64).sin() + 2.0 * (0.0215 * k as f64).cos();
    let op: Vec<f64> = (0..n).map(|k| swing(k) + 0.02 * next()).collect();
    let (mut y, mut stem, mut pv) = (0.0, 0.0f64, vec![0.0; n]);
    for k in 1..n {
        stem = stem.clamp(op[k - 1] - 1.0, op[k - 1] + 1.0);
        y = 0.8 * y + 0.2 * stem + load(k);
        pv[k] = y + 0.1 * next();
    }
    let window = Window { t0: 0.0, ts: 1.0, op, pv, ..Window::default() };
    let data = IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough");
    // No controller makes this OP.
    IdData { gain_sign: None, ..data }
}

/// A record behind a dead band without a load, and the model of that valve.
fn dead_band() -> (IdData, Fitted) {
    let data = behind_dead_band(1600, |_| 0.0);
    let valve = ValveModel { s: 2.0 / data.units.u, j: 0.0, ..ValveModel::default() };
    let best = fit_anew(&data, Hypothesis { valve: Some(valve), effects: Vec::new() }, None);
    (data, best)
}

/// What is answered of this model by these odds for friction.
fn answered(data: &IdData, best: &Fitted, log_odds: f64, diagnosis: &Diagnosis, agrees: bool) -> Answer {
    let settings = Settings { op_span: data.units.span, ..Settings::default() };
    Question { data, best, log_odds, diagnosis, settings: &settings }.answer(agrees, || true)
}

/// A diagnosis that was made for a test.
fn made(verdict: Verdict) -> Diagnosis {
    Diagnosis::bare(verdict, "made for a test")
}

#[test]
fn friction_that_is_likelier_than_not_is_never_denied() {
    let (data, best) = dead_band();
    let none = best.hypothesis.with_valve(None);
    let most = interval(&data, &none, None)[1] * data.units.u;
    assert!(most < data.f_max * data.units.u, "the record excludes some friction");
    let sound = made(Verdict::NoStiction);
    // Twice the log odds is the evidence; a verdict needs 20.
    for (log_odds, agrees) in [(0.01, true), (5.0, true), (5.0, false), (10.0, true), (30.0, false)] {
        let answer = answered(&data, &best, log_odds, &sound, agrees);
        let (evidence, most) = ([2.0 * log_odds, 20.0], data.units.along_op(most));
        let undecided =
            NotIdentifiable::Undecided { evidence, contradicted: !agrees, most, unrecorded: false };
        assert_eq!(answer.verdict, Verdict::NotIdentifiable(undecided.clone()), "{log_odds} {agrees}");
        assert_eq!((answer.reason.as_str(), answer.by_tracing), (undecided.to_string().as_str(), true));
        assert!(!answer.agrees_with(&sound), "the next window is to be searched");
    }
    let told = |log_odds: f64| answered(&data, &best, log_odds, &sound, true).verdict;
    assert_eq!([-0.01, 0.0].map(told), [Verdict::NoStiction, Verdict::NoStiction]);
    assert_eq!(told(10.01), Verdict::Stiction);
    // A diagnosis that does not deny friction stands where the held-out samples contradict tracing.
    let sticks = answered(&data, &best, 5.0, &made(Verdict::Stiction), false);
    assert!(sticks.tells_stiction() && !sticks.by_tracing);
    let denied = answered(&data, &best, -5.0, &made(Verdict::NoStiction), false);
    assert_eq!(denied.verdict, Verdict::NoStiction);
}

#[test]
fn friction_is_denied_where_it_is_too_small_to_matter() {
    let (data, best) = dead_band();
    let f = best.hypothesis.valve.expect("it has one").f() * data.units.u;
    let of = |best: &Fitted, log_odds: f64, f_threshold: f64| {
        let settings = Settings { f_threshold, ..Settings::default() };
        let (data, diagnosis) = (&data, made(Verdict::NoStiction));
        Question { data, best, log_odds, diagnosis: &diagnosis, settings: &settings }.answer(true, || true)
    };
    assert_eq!(of(&best, 12.0, 0.99 * f).verdict, Verdict::Stiction);
    // So it is with too little evidence: whatever friction is there does not matter.
    for log_odds in [12.0, 5.0] {
        let answer = of(&best, log_odds, 1.01 * f);
        assert_eq!(answer.verdict, Verdict::NoStiction);
        assert!(answer.reason.ends_with("is too small to matter"), "{}", answer.reason);
    }
    // The odds are summed over all hypotheses, of which the likeliest may have no friction: then no f is known to be small.
    let none = fit_anew(&data, best.hypothesis.with_valve(None), None);
    let answer = of(&none, 12.0, 1.01 * f);
    let reason = &answer.reason;
    assert!(answer.verdict.is_undecided() && reason.contains("evidence 24, but f may be 0"), "{reason}");
}

#[test]
fn a_bound_that_excludes_nothing_is_no_verdict_whatever_would_have_shown() {
    let data = of_op(vec![0.0, 5.0, 2.0, 12.0, 11.0], Start { index: 1, is_max: true }, 1.5);
    let bounded = |high: f64, detectable: Option<f64>| {
        let mut answer = standing(&data, &declared(high));
        let published = answer.bound(&data, detectable);
        let hidden =
            matches!(answer.verdict, Verdict::NotIdentifiable(NotIdentifiable::HiddenFriction { .. }));
        assert_ne!(hidden, answer.reason.contains("; f up to"), "{}", answer.reason);
        assert!(answer.friction.f_ci95[1] <= 1.5, "{answer:?}");
        (hidden, published)
    };
    // The interval reaches the largest f of 1.5, or nearly, although a small f would have shown.
    assert_eq!(bounded(1.5, Some(0.2)), (true, None));
    assert_eq!(bounded(1.48, Some(0.2)), (true, None));
    // What would have shown is beyond the largest f.
    assert_eq!(bounded(0.4, Some(1.6)), (true, None));
    assert_eq!(bounded(1.4, Some(0.2)), (false, Some(1.4)));
    // No f would have shown by enough evidence for a verdict. The likelihood excludes what is beyond its interval all the same.
    assert_eq!(bounded(0.4, None), (false, None));
}

#[test]
fn friction_that_is_not_believed_bounds_nothing_by_its_own_interval() {
    let (data, best) = dead_band();
    let end = |hypothesis: &Hypothesis| interval(&data, hypothesis, None)[1] * data.units.u;
    let (own, hidden) = (end(&best.hypothesis), end(&best.hypothesis.with_valve(None)));
    assert!(own < hidden, "{own} {hidden}: nothing is told by this record");
    let mut answer = answered(&data, &best, -1.0, &made(Verdict::NoStiction), true);
    assert_eq!((&answer.verdict, answer.friction.f_ci95), (&Verdict::NoStiction, [0.0, hidden]));
    // Whatever is published, the sentence has the same number.
    let detectable = 0.5 * hidden / data.units.u;
    let published = answer.bound(&data, Some(detectable)).expect("it is known");
    assert_eq!((published, answer.friction.f_ci95[1]), (hidden, hidden));
    let bound = could_be_hidden(hidden, None);
    assert_eq!(answer.reason, format!("nothing speaks for friction, evidence 0{bound}"));
}

#[test]
fn where_the_held_out_samples_overrule_tracing_no_effect_is_spoken_of() {
    let (data, best) = dead_band();
    let answer = answered(&data, &best, 5.0, &made(Verdict::Stiction), false);
    let overruled =
        "tracing gives another verdict, but its model predicts the last fifth of the samples worse";
    assert_eq!(answer.reason, format!("made for a test; {overruled}"));
    assert!(answer.tells_stiction() && !answer.by_tracing);
    // A diagnosis that has no reason of its own yet leaves no empty clause.
    let answer = answered(&data, &best, 5.0, &Diagnosis::bare(Verdict::Stiction, ""), false);
    assert_eq!(answer.reason, overruled);
}

/// A record of which nothing but OP is looked at.
fn of_op(u: Vec<f64>, start: Start, f_max: f64) -> IdData {
    let units = Units { u: 1.0, span: Some(100.0), ..Units::default() };
    IdData { u, start, f_max, units, ..IdData::default() }
}

/// A diagnosis that sees no sticking, of data that an archive held.
fn declared(f_high: f64) -> Diagnosis {
    let history = HistoryFound { kind: HistoryKind::Held, role: Role::Pv, evidence: [1.0, 5.0] };
    let estimate = Estimate { f_ci95: [0.0, f_high], ..estimate(3.0, Rival::Linear, 2.0) };
    let bound = could_be_hidden(f_high, Some(100.0));
    Diagnosis {
        preparation: Preparation { history: Some(Box::new(history)), ..Preparation::default() },
        estimate: Some(estimate),
        ..Diagnosis::bare(
            Verdict::NoStiction,
            format!("too little speaks for friction, evidence 3 of 20{bound}"),
        )
    }
}

/// What is answered where tracing asked of no friction, so that the diagnosis stands.
fn standing(data: &IdData, diagnosis: &Diagnosis) -> Answer {
    let best = Fitted { hypothesis: Hypothesis::default(), model: Armax::default(), score: 0.0 };
    let settings = Settings { op_span: data.units.span, ..Settings::default() };
    let question =
        Question { data, best: &best, log_odds: f64::NEG_INFINITY, diagnosis, settings: &settings };
    question.answer(true, || true)
}

#[test]
fn a_diagnosis_that_stands_is_said_with_the_bound_that_is_published() {
    let (data, diagnosis) = (of_op(Vec::new(), Start::default(), 5.0), declared(0.5));
    for (detectable, high) in [(1.2, 1.2), (0.2, 0.5)] {
        let mut answer = standing(&data, &diagnosis);
        assert_eq!(answer.bound(&data, Some(detectable)), Some(high));
        assert_eq!(answer.friction.f_ci95, [0.0, high]);
        let bound = could_be_hidden(high, Some(100.0));
        assert_eq!(answer.reason, format!("too little speaks for friction, evidence 3 of 20{bound}"));
    }
}

#[test]
fn the_largest_reversal_is_told_whichever_way_it_goes() {
    // From a maximum OP falls by 3, then rises by 10: beyond half of 3 no stem turns.
    let data = of_op(vec![0.0, 5.0, 2.0, 12.0, 11.0], Start { index: 1, is_max: true }, 1.5);
    let mut answer = standing(&data, &declared(1.5));
    assert_eq!(answer.bound(&data, None), None);
    let [reversal, friction] = ["10.000 % OP", "3.000 % OP"].map(String::from);
    let hidden = NotIdentifiable::HiddenFriction {
        reversal,
        friction: Some(friction),
        excluded: None,
        unrecorded: false,
    };
    assert_eq!(answer.verdict, Verdict::NotIdentifiable(hidden));
    assert_eq!(
        answer.reason,
        "hidden friction: friction of any size that was tried, up to S = 3.000 % OP, could be hidden beside what else moves PV; OP never \
         reverses by more than 10.000 % OP"
    );
    // Of a bound beyond every valve that was tried only these are spoken of, and of none nothing is said.
    for (f_max, said) in [
        (1.5, "friction of any size that was tried, up to S = 3.000 % OP, could be hidden"),
        (0.0, ": friction would not show"),
    ] {
        let data = IdData { f_max, ..data.clone() };
        let mut answer = standing(&data, &declared(f64::INFINITY));
        assert_eq!(answer.bound(&data, None), None);
        assert!(answer.reason.contains(said), "{}", answer.reason);
    }
}

#[test]
fn hidden_friction_is_told_with_what_the_record_excludes_all_the_same() {
    let data = of_op(vec![0.0, 5.0, 2.0, 12.0, 11.0], Start { index: 1, is_max: true }, 1.5);
    let traced = || Answer { by_tracing: true, ..standing(&data, &declared(1.5)) };
    let mut answer = traced();
    assert_eq!(answer.bound(&data, None), None);
    let whole = answer.reason.clone();
    answer.tell_excluded(&data, || None);
    assert_eq!(answer.reason, whole, "nothing is excluded");
    answer.tell_excluded(&data, || Some([0.4, 1.0]));
    assert_eq!(
        answer.reason,
        "hidden friction: friction of S = 0.800 % OP to 2.000 % OP is excluded, but less, or more up to S = 3.000 % OP, could be hidden \
         beside what else moves PV; OP never reverses by more than 10.000 % OP"
    );
    assert!(matches!(
        &answer.verdict,
        Verdict::NotIdentifiable(NotIdentifiable::HiddenFriction { excluded: Some(_), .. })
    ));
    // Another verdict has its bound, and the diagnosis knows of no effects beside which anything would be excluded.
    for mut other in [traced(), standing(&data, &declared(1.5))] {
        if !other.by_tracing {
            other.bound(&data, None);
        }
        let before = other.reason.clone();
        other.tell_excluded(&data, || panic!("it is not asked"));
        assert_eq!(other.reason, before);
    }
}

#[test]
fn a_bound_is_wider_where_the_controller_may_have_acted_unseen() {
    let (data, best) = dead_band();
    let none = best.hypothesis.with_valve(None);
    let fast = Preparation::default().reading.fast;
    let steps: Vec<f64> = data.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let more = quantile(&steps, fast);
    let [seen, unseen] = [None, Some(fast)].map(|fast| interval(&data, &none, fast)[1]);
    assert!(more > 0.0 && (unseen - seen - more).abs() < 1e-9, "{unseen} {seen} {more}");
    // So it is where the likeliest model has a valve that is not believed.
    let acquisition =
        Acquisition { poll_s: Some(1.0), jitter_s: Some(0.05), recovered: false, ..Acquisition::default() };
    let preparation = Preparation { acquisition: Some(Box::new(acquisition)), ..Preparation::default() };
    assert_eq!(preparation.unseen_moves(), Some(fast));
    let diagnosis = Diagnosis { preparation, ..Diagnosis::bare(Verdict::NoStiction, "made for a test") };
    let answer = answered(&data, &best, -1.0, &diagnosis, true);
    assert_eq!(answer.verdict, Verdict::NoStiction);
    let high = answer.friction.f_ci95[1] / data.units.u;
    assert!((high - unseen).abs() < 1e-9, "{high} {unseen}");
}

#[test]
fn what_an_archive_did_is_said_once_of_what_was_traced_and_which_stretch_that_is() {
    let record = sticking(700, 1.0);
    let settings = diagnosis::Settings::default();
    let mut found = diagnose(&record, &settings);
    found.preparation.history = declared(1.0).preparation.history;
    let traced = trace_record(&record, &found, &settings, &Settings::default()).expect("long enough");
    let archive = "; the data is not raw (held): f reads low, and sticking may go unseen";
    let said = traced.reason.matches("not raw").count();
    assert!(said == 1 && traced.reason.ends_with(archive), "{}", traced.reason);
    let whole = window(&record, &found, &settings).expect("it is traced");
    let end = whole.t0 + (whole.len() - 1) as f64 * whole.ts;
    assert_eq!(traced.traced, Traced { start: whole.t0, end, n: whole.len() });
}

#[test]
fn where_a_term_of_write_back_acted_no_valve_is_told_to_be_sound() {
    let (data, best) = dead_band();
    let settings = Settings { op_span: data.units.span, compensated: 0.1, ..Settings::default() };
    for (verdict, agrees) in
        [(Verdict::Stiction, true), (Verdict::NoStiction, true), (Verdict::NoStiction, false)]
    {
        let diagnosis = Diagnosis::bare(verdict, "made for a test");
        let (data, best, diagnosis, settings) = (&data, &best, &diagnosis, &settings);
        let answer = Question { data, best, log_odds: 5.0, diagnosis, settings }.answer(agrees, || true);
        assert_eq!(answer.verdict, Verdict::NotIdentifiable(NotIdentifiable::Compensated), "{answer:?}");
        // Friction with enough evidence is told all the same, unless the held-out samples contradict it.
        let answer = Question { data, best, log_odds: 30.0, diagnosis, settings }.answer(agrees, || true);
        assert_eq!(answer.tells_stiction(), agrees, "{answer:?}");
    }
}

#[test]
fn a_term_counts_that_acted_outside_of_the_diagnosed_window() {
    let mut record = sticking(1500, 1.0);
    record.term = Some(vec![Sample::good(200.0, 2.0), Sample::good(300.0, 0.0)]);
    let whole = Window { ts: 1.0, op: vec![0.0; 1500], pv: vec![0.0; 1500], ..Window::default() };
    let (covered, diagnosed) = (whole.slice(1000, 1500), diagnosis::Settings::default());
    let settings = settings_of(&record, [&whole, &covered], &diagnosed, &Settings::default());
    assert_eq!(settings.compensated, 100.0 / 1500.0);
}

#[test]
fn nothing_is_named_on_a_record_whose_rows_do_not_belong_together() {
    let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(11));
    let mut next = || -> f64 { draw.next().unwrap_or(0.0) };
    let op: Vec<f64> = (0..1500).map(|k| 3.0 * (0.055 * f64::from(k)).sin() + 0.3 * next()).collect();
    let (mut y, mut pv) = (0.0, vec![0.0; 1500]);
    for k in 1..1500 {
        y = 0.8 * y + 0.2 * op[k - 1] + if k > 700 { 0.5 } else { 0.0 };
        pv[k] = y + 0.05 * next();
    }
    let window = Window { ts: 1.0, op, pv, ..Window::default() };
    let named =
        |diagnosis: &Diagnosis| trace(&window, diagnosis, &Settings::default()).expect("it is traced");
    let told = named(&Diagnosis::bare(Verdict::NoStiction, "made for a test"));
    assert!(!told.effects.is_empty());
    let why = NotIdentifiable::ReadApart { share: 0.6 };
    let refused = named(&Diagnosis::bare(Verdict::NotIdentifiable(why.clone()), "made for a test"));
    assert_eq!(refused.verdict, Verdict::NotIdentifiable(why));
    assert!(refused.effects.is_empty() && refused.rejected.is_empty() && refused.candidates.is_empty());
    assert_eq!(refused.structure, None);
}
