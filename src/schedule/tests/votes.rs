//! What becomes of runs on a record that does not go on.

use super::*;
use crate::results::{Remembered, Silent};
use crate::signal::{Role, Sample};

/// A scheduler of one loop that runs when it is asked, and its results.
struct Asking {
    scheduler: Arc<Scheduler>,
    results: Arc<Results>,
    token: CancellationToken,
    id: LoopId,
}

impl Asking {
    fn new(plan: Plan, judge: Diagnose, elsewhere: Option<Elsewhere>) -> Self {
        let id = plan.jobs[0].id.clone();
        let results = Arc::new(Results::new(std::slice::from_ref(&id), 10, &alarm::Config::default()));
        let clock = Clock::plant(0.0, 1.0);
        let scheduler = Scheduler::new(Config::default(), clock, judge, results.clone(), plan);
        let scheduler = Arc::new(match elsewhere {
            Some(elsewhere) => scheduler.asking(elsewhere),
            None => scheduler,
        });
        let token = CancellationToken::new();
        let running = (scheduler.clone(), token.clone());
        tokio::spawn(async move { running.0.run(running.1).await });
        Self { scheduler, results, token, id }
    }

    async fn run(&self) -> Arc<Run> {
        self.scheduler.request(&self.id).expect("idle").await.expect("runs")
    }

    fn is_raised(&self) -> bool {
        self.results.get(&self.id, 0.0).expect("it is there").alarm.active
    }
}

impl Drop for Asking {
    fn drop(&mut self) {
        self.token.cancel();
    }
}

#[tokio::test(start_paused = true)]
async fn of_a_silent_source_that_is_told_and_nobody_diagnoses_what_it_left() {
    let silent = Silent { tag: Role::Pv, since: 1_767_225_600.0 };
    let silence: Silence = Arc::new(move |_, record, period_s| {
        assert_eq!((record.tags[0].0.as_str(), period_s), ("a", 1e6));
        Some(silent)
    });
    let judge: Diagnose = Arc::new(|_, _, _| -> Judged { panic!("it is diagnosed here") });
    let elsewhere: Elsewhere =
        Arc::new(|_| -> BoxFuture<'static, Option<Told>> { panic!("others are asked") });
    let asking = Asking::new(Plan { silence, ..plan(jobs(&["a"], 1e6)) }, judge, Some(elsewhere));
    let run = asking.run().await;
    let summary = run.summary();
    assert_eq!((&*summary.outcome, summary.reason_code.as_deref()), ("not_identifiable", Some("silent")));
    assert_eq!(summary.reason, "silent: no good sample of PV since 2026-01-01 00:00:00 UTC");
    // Who makes the run again is told, too.
    assert_eq!(run.basis.as_ref().and_then(|basis| basis.silent), Some(silent));
    assert_eq!((asking.scheduler.counters().diagnosed, asking.scheduler.counters().panicked), (1, 0));
    assert_eq!(asking.results.summaries(&asking.id).map(|all| all.len()), Some(1));
}

/// What a loop's only sample is stamped with (s), whether its valve sticks, and where the window ends that says so (s).
type Source = Arc<Mutex<(f64, bool, Option<f64>)>>;

/// A loop whose period is 1e6 s, and whose record and verdict the test decides.
fn decided() -> (Asking, Source) {
    let source: Source = Arc::new(Mutex::new((1.0, true, None)));
    let (stamp, valve) = (source.clone(), source.clone());
    let snapshot: Snapshot = Arc::new(move |_| {
        let (t, ..) = *stamp.lock().expect("no panic");
        Some(Record { pv: vec![Sample::good(t, 50.0)], ..Record::default() })
    });
    let judge: Diagnose = Arc::new(move |_, _, _| {
        let (_, sticks, end) = *valve.lock().expect("no panic");
        let verdict = if sticks { Verdict::Stiction } else { Verdict::NoStiction };
        let mut judged = Judged { findings: Some(made_findings(verdict, Vec::new())), ..nothing_to_say() };
        if let Some(end) = end {
            (judged.diagnosis.preparation.n, judged.diagnosis.preparation.end) = (1, end);
        }
        judged
    });
    (Asking::new(Plan { snapshot, ..plan(jobs(&["a"], 1e6)) }, judge, None), source)
}

#[tokio::test(start_paused = true)]
async fn however_often_one_record_is_diagnosed_it_is_one_vote() {
    let (asking, source) = decided();
    let set = |t: f64, sticks: bool| *source.lock().expect("no panic") = (t, sticks, None);
    for _ in 0..4 {
        assert_eq!(asking.run().await.outcome.as_str(), "stiction");
    }
    assert!(!asking.is_raised(), "two of three raise, and this was one");
    // It went on, by a little and by more than half a period.
    set(1000.0, true);
    asking.run().await;
    assert!(!asking.is_raised());
    set(600_000.0, true);
    asking.run().await;
    assert!(asking.is_raised());
    // Three of four clear.
    for _ in 0..5 {
        set(1_200_000.0, false);
        assert_eq!(asking.run().await.outcome.as_str(), "no_stiction");
    }
    assert!(asking.is_raised());
    for t in [1_800_000.0, 2_400_000.0] {
        assert!(asking.is_raised());
        set(t, false);
        asking.run().await;
    }
    assert!(!asking.is_raised());
}

#[tokio::test(start_paused = true)]
async fn a_stretch_that_each_run_finds_again_is_one_vote_though_new_samples_come() {
    let (asking, source) = decided();
    let run = async |t: f64, end: f64| {
        *source.lock().expect("no panic") = (t, true, Some(end));
        assert_eq!(asking.run().await.outcome.as_str(), "stiction");
        asking.is_raised()
    };
    for period in 1..6 {
        assert!(!run(1e6 * f64::from(period), 5e5).await, "{period}");
    }
    assert!(run(6e6, 6e5).await, "it has gone on");
}

#[tokio::test(start_paused = true)]
async fn a_restart_gives_no_record_another_vote() {
    let (asking, source) = decided();
    // It was diagnosed just before the start.
    let summaries = vec![told(0.0).summary];
    asking.results.restore(&asking.id, Remembered { summaries, ..Remembered::default() });
    for (t, raised) in [(1.0, false), (600_000.0, false), (1_200_000.0, true)] {
        source.lock().expect("no panic").0 = t;
        asking.run().await;
        assert_eq!(asking.is_raised(), raised, "{t}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_restart_gives_no_stretch_another_vote_though_new_samples_came() {
    let (asking, source) = decided();
    let kept =
        Remembered { summaries: vec![told(-1e6).summary], fitted_until: Some(5e5), ..Remembered::default() };
    asking.results.restore(&asking.id, kept);
    // Two of three raise.
    for (t, end, raised) in [(1e6, 5e5, false), (2e6, 5e5, false), (3e6, 6e5, false), (4e6, 7e5, true)] {
        *source.lock().expect("no panic") = (t, true, Some(end));
        asking.run().await;
        assert_eq!(asking.is_raised(), raised, "{t}");
    }
}
