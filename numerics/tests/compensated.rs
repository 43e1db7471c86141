//! What is said of valves that are compensated: the valve's input is OP and the term that was in force.

use stictiond_numerics::compensation::{Compensator, ConstantReinforcement, CrSettings};
use stictiond_numerics::diagnosis::{Diagnosis, NotIdentifiable, Settings, Verdict, diagnose};
use stictiond_numerics::residual::{self, trace_record};
use stictiond_numerics::signal::{Record, Sample, Series};
use stictiond_numerics::sim::plant::LoopSim;
use stictiond_numerics::sim::{DemoLoop, demo_plant};
use stictiond_numerics::sysid::valve::model_error::without_model_error;

/// Samples before the term, and with it.
const BEFORE: usize = 3000;
const WITH: usize = 2000;
/// Loops that are judged.
const LOOPS: usize = 20;
/// f may be so far off, as a share of it: what is expected of a record without a term too (docs/acquisition.md).
const OFF: f64 = 0.1;

/// A sticking loop of the demo under a term, from its `from`-th sample on.
fn compensated(demo: &DemoLoop, from: usize) -> Record {
    let f = 0.5 * demo.truth.s;
    // As the demo's write-back has it; the gate's rate is faster than a sample.
    let settings = CrSettings { dead_band: 0.05, rest_s: 1.2, size: 4.0, rate: f64::INFINITY };
    let mut cr = ConstantReinforcement::new(f, [0.9 * f, 1.1 * f], settings).expect("a sound amplitude");
    let mut sim = LoopSim::new(&demo.spec, demo.seed).expect("the plant is valid");
    let [mut op, mut pv, mut term] = [Series::new(), Series::new(), Series::new()];
    for k in 0..BEFORE + WITH {
        let mut acts = 0.0;
        let point = sim.step_by(|op| {
            let asked = cr.step(op, demo.spec.ts_s);
            acts = if k < BEFORE { 0.0 } else { asked };
            acts
        });
        if k >= from {
            op.push(Sample::good(point.t, point.op));
            pv.push(Sample::good(point.t, point.pv));
        }
        // Said when it changes, as write-back does.
        if term.last().is_none_or(|last| last.value != acts) {
            term.push(Sample::good(point.t, acts));
        }
    }
    Record { op, pv, term: Some(term), op_span: Some(100.0), ..Record::default() }
}

fn loops() -> Vec<DemoLoop> {
    let sticky = (1..4).flat_map(demo_plant).filter(|demo| demo.truth.sticky);
    sticky.take(LOOPS).collect()
}

/// Whether what is said is true of the valve: its f, or that the term hides it; never that it is sound.
fn is_right(demo: &DemoLoop, found: &Diagnosis) -> bool {
    let f = 0.5 * demo.truth.s;
    match (&found.verdict, &found.estimate) {
        (Verdict::Stiction, Some(estimate)) => {
            // These valves are the models themselves.
            let [low, high] = without_model_error(estimate.f, estimate.f_ci95);
            (estimate.f / f - 1.0).abs() < OFF || (low..=high).contains(&f)
        }
        (Verdict::NotIdentifiable(why), _) => *why == NotIdentifiable::Compensated,
        _ => false,
    }
}

#[test]
fn verdicts_beside_active_terms_are_right() {
    let (mut visible, mut wrong) = (0, Vec::new());
    for demo in loops() {
        let record = compensated(&demo, BEFORE);
        let found = diagnose(&record, &Settings::default());
        let said = format!("{} {}, S/2 {}: {}", demo.id, demo.truth.kind, 0.5 * demo.truth.s, found.reason);
        println!("{said}");
        wrong.extend((!is_right(&demo, &found)).then(|| said.clone()));
        visible += usize::from(found.verdict == Verdict::Stiction);
        if found.preparation.n > 0 {
            assert!(found.preparation.compensated > 0.5, "{said}: {}", found.preparation.compensated);
        }
    }
    println!("friction is still visible in {visible} of {LOOPS}");
    assert!(wrong.is_empty(), "{wrong:#?}");
    // Where friction is seen beside the term it is measured: silence alone would be no merit.
    assert!(visible >= 3, "{visible}");
}

#[test]
fn a_window_half_of_which_a_term_acted_on_is_one_valve() {
    for demo in loops().iter().filter(|demo| demo.truth.kind == "strong stiction").take(3) {
        let found = diagnose(&compensated(demo, BEFORE - WITH), &Settings::default());
        assert!(
            found.verdict == Verdict::Stiction && is_right(demo, &found),
            "{}: {}",
            demo.id,
            found.reason
        );
    }
}

/// Tracing looks at a longer window, and takes friction for what nothing else explains.
#[test]
fn what_is_traced_beside_active_terms_is_never_told_to_be_sound() {
    let mut traced = 0;
    for demo in loops().iter().take(6) {
        for from in [BEFORE, BEFORE - WITH] {
            let (record, settings) = (compensated(demo, from), Settings::default());
            let found = diagnose(&record, &settings);
            let effects = trace_record(&record, &found, &settings, &residual::Settings::default());
            let Some(effects) = effects else { continue };
            let counts = effects.replaces_diagnosis();
            let verdict = if counts { &effects.verdict } else { &found.verdict };
            let said = format!("{} from {from}: {}; {}", demo.id, found.reason, effects.reason);
            assert_ne!(*verdict, Verdict::NoStiction, "{said}");
            traced += usize::from(counts);
        }
    }
    assert!(traced >= 3, "{traced}: nothing was traced");
}

#[test]
fn a_term_is_in_force_until_the_next() {
    let series = |of: &[(f64, f64)]| of.iter().map(|(t, v)| Sample::good(*t, *v)).collect::<Series>();
    let record = Record {
        op: series(&[(0.0, 50.0), (1.0, 50.5), (2.0, 51.0), (3.0, 50.0)]),
        term: Some(series(&[(1.0, 2.5), (2.5, -2.5)])),
        ..Record::default()
    };
    let input: Vec<f64> = record.input().iter().map(|s| s.value).collect();
    assert_eq!(input, [50.0, 53.0, 53.5, 47.5]);
    assert_eq!((record.term_at(0.9), record.term_at(1.0), record.term_at(9.0)), (0.0, 2.5, -2.5));
}
