//! Groups, sources and cascades of a few simulated plants; `examples/plantwide_rates.rs` measures them on many.

use std::borrow::Cow;
use std::cell::Cell;
use stictiond_numerics::diagnosis::{Model, Settings, Verdict, diagnose};
use stictiond_numerics::indicators::margins::{Margins, margins};
use stictiond_numerics::plantwide::{self, Cause, PlantLoop, analyse};
use stictiond_numerics::signal::{Record, Sample, Window};
use stictiond_numerics::sim::controller::ControllerSpec;
use stictiond_numerics::sim::load::{At, Load, LoadKind};
use stictiond_numerics::sim::process::{ProcessKind, ProcessSpec};
use stictiond_numerics::sim::sensor::SensorSpec;
use stictiond_numerics::sim::units::{Plant, Source, plant};
use stictiond_numerics::sim::valve::{Friction, ValveSpec};
use stictiond_numerics::sim::{LoopSpec, Run, simulate};

fn loops(of: &Plant, runs: &[Run]) -> Vec<PlantLoop> {
    let one = |(of, run): (&stictiond_numerics::sim::units::UnitLoop, &Run)| PlantLoop {
        name: of.name.clone(),
        window: Window {
            ts: run.ts,
            op: run.op.clone(),
            pv: run.pv.clone(),
            sp: Some(run.sp.clone()),
            ..Window::default()
        },
        op_limits: Some((0.0, 100.0)),
        ..PlantLoop::default()
    };
    of.loops.iter().zip(runs).map(one).collect()
}

#[test]
fn a_load_is_found_where_it_enters_and_its_victims_are_told_of_it() {
    let (mut first, mut among, mut missed, mut victims) = (0, 0, 0, 0);
    for seed in [31, 32, 33, 34] {
        let of = plant(seed, 5, &[(Source::Load, None)]);
        let at = of.sources[0].1;
        let (runs, shares) = of.truth(24.0);
        let found = analyse(&loops(&of, &runs));
        let clear: Vec<usize> = (0..60).filter(|i| shares[*i][0] > 0.5).collect();
        if clear.len() < 2 {
            continue;
        }
        victims += clear.len();
        missed += clear.iter().filter(|i| found.loops[**i].group != found.loops[at].group).count();
        let Some(group) = found.loops[at].group.map(|g| &found.groups[g]) else { continue };
        first += usize::from(group.suspects[0].at == at);
        among += 1;
        let sum: f64 = group.suspects.iter().map(|s| s.probability).sum();
        assert!((sum - 1.0).abs() < 1e-9);
        let source = group.suspects[0].at;
        let told = clear.iter().filter(|i| {
            found.loops[**i]
                .reason
                .as_ref()
                .is_some_and(|r| r.cause == Cause::Neighbour && r.neighbour == Some(source))
        });
        assert!(told.count() * 2 >= clear.len() - 1, "seed {seed}");
    }
    assert!(victims > 5 && missed * 10 <= victims, "{missed} of {victims}");
    assert!(among >= 3 && first * 2 >= among, "{first} of {among}");
}

#[test]
fn cascades_are_recognised_in_any_sampling() {
    let of = plant(41, 2, &[]);
    let found = analyse(&loops(&of, &of.run(12.0, &[])));
    for (at, one) in of.loops.iter().enumerate() {
        assert_eq!(found.loops[at].master, one.master, "{}", one.name);
    }
}

#[test]
fn what_the_user_says_of_streams_decides_between_two_alike() {
    let wave = |late: f64| -> Vec<f64> {
        (0..1440)
            .map(|k| ((f64::from(k) - late) * 0.2).sin() + 0.05 * (f64::from(k * k) * 0.7).sin())
            .collect()
    };
    let one = |name: &str, upstream: &[&str]| PlantLoop {
        name: name.into(),
        window: Window { ts: 60.0, op: wave(0.0), pv: wave(0.0), ..Window::default() },
        upstream: upstream.iter().map(|u| (*u).to_string()).collect(),
        ..PlantLoop::default()
    };
    for (a, b, source) in [(vec![], vec!["A"], 0), (vec!["B"], vec![], 1)] {
        let found = analyse(&vec![one("A", &a), one("B", &b)]);
        assert_eq!(found.groups.len(), 1);
        assert_eq!(found.groups[0].suspects[0].at, source);
    }
}

/// Loops whose rings go on while they are looked at: each time that one is asked for, its window begins a sample later.
struct Live {
    loops: Vec<PlantLoop>,
    asked: Cell<usize>,
}

impl plantwide::Plant for Live {
    fn count(&self) -> usize {
        self.loops.len()
    }

    fn get(&self, at: usize) -> Cow<'_, PlantLoop> {
        let late = self.asked.get() / self.loops.len();
        self.asked.set(self.asked.get() + 1);
        let mut of = self.loops[at].clone();
        let w = &mut of.window;
        w.t0 += late as f64 * w.ts;
        for x in [&mut w.op, &mut w.pv].into_iter().chain(&mut w.sp) {
            x.drain(..late);
        }
        Cow::Owned(of)
    }
}

#[test]
fn rings_may_go_on_between_two_looks_at_a_loop() {
    let of = plant(31, 5, &[(Source::Load, None)]);
    let loops = loops(&of, &of.truth(24.0).0);
    let still = analyse(&loops);
    let live = Live { loops, asked: Cell::new(0) };
    let found = analyse(&live);
    assert!(live.asked.get() >= 2 * found.loops.len(), "a loop is asked for again");
    let members = |found: &plantwide::Analysis| -> Vec<Vec<usize>> {
        found.groups.iter().map(|group| group.members.clone()).collect()
    };
    assert!(!still.groups.is_empty());
    assert_eq!(members(&found), members(&still));
}

#[test]
fn rubbish_is_in_no_group_and_no_panic() {
    let one = |pv: Vec<f64>| PlantLoop {
        window: Window { ts: 1.0, op: pv.clone(), pv, ..Window::default() },
        ..PlantLoop::default()
    };
    let rubbish = [vec![], vec![f64::NAN; 200], vec![1e300; 200], vec![0.0; 3], vec![f64::INFINITY; 100]];
    let found = analyse(&rubbish.map(one).to_vec());
    assert_eq!((found.loops.len(), found.groups.len()), (5, 0));
    assert_eq!(analyse(&Vec::new()).groups.len(), 0);
}

/// A loop whose integral time cancels the lag of the process, `0.1 q^-3 / (1 - 0.9 q^-1)`, with a moving set point and a load:
/// L = 0.6 q^-3 / (1 - q^-1).
fn tight(seed: u64) -> Run {
    let tau_s = -1.0 / 0.9f64.ln();
    let sizes = [1.0, 0.0, -1.0, -0.5, 0.5, 0.0];
    let step = |i: u32| (f64::from(150 + 230 * i + 37 * i * i % 90), 50.0 + sizes[i as usize % 6]);
    let spec = LoopSpec {
        process: ProcessSpec { kind: ProcessKind::FirstOrder { gain: 1.0, tau_s }, dead_time_s: 2.0 },
        controller: ControllerSpec::pi(5.4, 9.0),
        valve: ValveSpec::linear(Friction::Ideal),
        loads: vec![Load { kind: LoadKind::Coloured { sd: 1.15, tau_s }, at: At::ProcessInput }],
        sensor: SensorSpec::noisy(0.05),
        sp: 50.0,
        sp_schedule: (0..12).map(step).collect(),
        sp_steps: None,
        ts_s: 1.0,
        op0: 50.0,
        pv0: 50.0,
    };
    simulate(&spec, 3000, seed).expect("a sound loop")
}

#[test]
fn a_tight_loop_is_told_so_with_its_true_margins() {
    // 2 sin 18° / 0.6, and 90° - 5 asin 0.3.
    let is_near = |found: Margins, gain: f64, phase_deg: f64| {
        found.gain.is_some_and(|own| (own - 1.030).abs() < gain)
            && found.phase_deg.is_some_and(|own| (own - 2.71).abs() < phase_deg)
    };
    let truth = Model { na: 1, nb: 1, nc: 0, nk: 3, a: vec![-0.9], b: vec![0.1], c: Vec::new(), rmse: 0.0 };
    let (mut told, mut fitted) = (0, 0);
    for seed in [71, 72, 73] {
        let run = tight(seed);
        let (op, pv, sp) = (run.op.clone(), run.pv.clone(), Some(run.sp.clone()));
        let window = Window { ts: run.ts, op, pv, sp, ..Window::default() };
        let limits = Some((0.0, 100.0));
        let known = margins(&window, limits, &truth).expect("the set point moves");
        assert!(is_near(known, 1e-2, 0.2), "{seed}: {known:?}");
        let of = PlantLoop { window, op_limits: limits, margins: Some(known), ..PlantLoop::default() };
        let found = analyse(&vec![of]);
        let reason = found.loops[0].reason.as_ref().filter(|own| own.cause == Cause::Tuning);
        told += usize::from(reason.is_some());
        let [begins, goes_on] =
            ["too tight: gain margin 1.0", ", phase margin 3°; it rings with a period of 10 s"];
        let is_said = |why: &str| why.starts_with(begins) && why.contains(goes_on);
        assert!(reason.is_none_or(|own| is_said(&own.why)), "{reason:?}");

        // By the model that a diagnosis fits to it.
        let series = |values: &[f64]| -> Vec<Sample> {
            run.t.iter().zip(values).map(|(t, value)| Sample::good(*t, *value)).collect()
        };
        let (op, pv, sp) = (series(&run.op), series(&run.pv), Some(series(&run.sp)));
        let own = diagnose(&Record { op, pv, sp, ..Record::default() }, &Settings::default());
        let linear = own.estimate.as_ref().filter(|estimate| estimate.f == 0.0);
        if let (Verdict::NoStiction, Some(estimate), Some(window)) = (&own.verdict, linear, &own.window)
            && let Some(found) = margins(window, limits, &estimate.model)
        {
            assert!(is_near(found, 0.1, 10.0), "{seed}: {found:?}");
            fitted += 1;
        }
    }
    assert!(told >= 2 && fitted >= 1, "{told} are told tight, {fitted} have a model that tells it");
}
