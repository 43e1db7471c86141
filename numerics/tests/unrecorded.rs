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
use stictiond_numerics::signal::Record;
use stictiond_numerics::sim::acquisition::{Acquisition, Poll, acquire};

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
