//! Records of a controller that acts between the samples: friction is not denied because OP tells what PV did there.

#[path = "common/acquired.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod acquired;
#[path = "common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "common/parallel.rs"]
mod parallel;

use acquired::{Loop, Said, draw, judge, scans};
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::acquisition::{Acquisition, Poll, acquire};
use stictiond_numerics::sim::plant::record;
use stictiond_numerics::sim::{Load, LoadKind, Recording, SetPointSteps, demo_plant};

/// Loops drawn, and their first seed.
const LOOPS: u64 = 24;
const FIRST: u64 = 92_000;

/// What is said of a loop that is read at every n-th scan of its controller.
fn read_every(own: &Loop, n: f64) -> Said {
    let scans = scans(&own.record).expect("it has scans");
    // In the middle of what is held: a quarter of two scans, a sixth of three.
    let poll = Poll { phase: 0.5 / n, ..Poll::every(n * scans.scan_s) };
    let record = acquire(&scans, &Acquisition::Polled(poll), own.seed);
    judge(own, &Record { op_span: Some(100.0), ..record })
}

#[test]
fn a_sticking_valve_is_not_denied_because_op_tells_of_pv_between_the_samples() {
    let jobs: Vec<(u64, f64)> = (0..LOOPS).flat_map(|i| [1.0, 2.0, 3.0].map(|n| (i, n))).collect();
    let all = parallel::each(&jobs, |(i, n)| {
        let own = draw(*i, FIRST + i);
        let said = read_every(&own, *n);
        (own, *n, said)
    });
    let (mut cleared, mut between) = (0, 0);
    for (own, n, said) in &all {
        let told = format!("{} every {n}: {} {}", own.name, said.verdict, said.reason);
        let denied = said.verdict == "no_stiction";
        assert!(!denied || said.covers(own.f), "{told}");
        let tells = said.reason.contains("OP tells more of PV");
        assert!(!tells || *n > 1.0, "every scan is a sample: {told}");
        between += usize::from(tells);
        cleared += usize::from(denied && own.f == 0.0 && *n > 1.0);
    }
    // Sound valves are still told so, where their records exclude friction.
    assert!(cleared >= 8 && between >= 4, "{cleared} cleared, {between} told of what OP tells");
}

/// What is said of a flow loop at every fourth scan, from this one on: a dead band of S, or none, a smooth load that moves OP, and
/// set-point steps or none.
fn smooth(seed: u64, from: usize, s: f64, sp_steps: Option<SetPointSteps>) -> Said {
    let like =
        |kind: &str| demo_plant(seed).into_iter().find(|own| own.truth.kind == kind).expect("in the plant");
    let mut spec = like(if s > 0.0 { "dead band only" } else { "sound" }).spec;
    spec.loads = vec![Load::input(LoadKind::Coloured { sd: 3.0, tau_s: 40.0 })];
    spec.sp_steps = sp_steps;
    let run = record(&spec, 8000, seed, Recording::All).expect("valid");
    let read = |values: &[f64]| -> Vec<Sample> {
        let each = run.t.iter().zip(values).skip(4000 + from).step_by(4);
        each.map(|(&t, &value)| Sample::good(t, value)).collect()
    };
    let (op, pv, sp) = (read(&run.op), read(&run.pv), Some(read(&run.sp)));
    let record = Record { op, pv, sp, op_span: Some(100.0), ..Record::default() };
    let own = Loop { name: String::new(), record, f: 0.5 * s, also: Vec::new(), seed };
    judge(&own, &own.record)
}

#[test]
fn a_smooth_pv_that_op_foretells_denies_no_dead_band_and_set_point_steps_clear_a_sound_valve() {
    let steps = Some(SetPointSteps { every_s: 300.0, size: 4.0 });
    let jobs: Vec<(u64, usize)> = (0..8).map(|i| (92_100 + i as u64, i % 4)).collect();
    let all = parallel::each(&jobs, |(seed, from)| {
        [(4.0, None), (4.0, steps), (0.0, steps)].map(|(s, steps)| smooth(*seed, *from, s, steps))
    });
    for [loads, moved, sound] in &all {
        // A dead band of 4 %, of which f is 2 %.
        assert!(loads.verdict != "no_stiction" || loads.covers(2.0), "{}", loads.reason);
        assert!(moved.verdict != "no_stiction" || moved.covers(2.0), "{}", moved.reason);
        assert_eq!(sound.verdict, "no_stiction", "{}", sound.reason);
    }
}
