use super::*;
use crate::alarm;
use crate::diagnosis::{Diagnosis, NotIdentifiable, Verdict};
use crate::results::{Event, made_findings};
use std::sync::atomic::AtomicU64;
use tokio::sync::broadcast;

mod votes;

fn nothing_to_say() -> Judged {
    Diagnosis::bare(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), "").into()
}

fn jobs(names: &[&str], period_s: f64) -> Vec<Job> {
    names.iter().map(|name| Job { id: LoopId::new(*name), period_s }).collect()
}

/// A scheduler over named loops; the record of a loop carries its name as the name of a tag, so that an injected
/// diagnosis knows whose turn it is.
struct Rig {
    scheduler: Arc<Scheduler>,
    events: broadcast::Receiver<Event>,
    results: Arc<Results>,
    token: CancellationToken,
    task: tokio::task::JoinHandle<()>,
}

fn plan(jobs: Vec<Job>) -> Plan {
    let snapshot: Snapshot =
        Arc::new(|id| Some(Record { tags: vec![(id.to_string(), vec![])], ..Record::default() }));
    Plan {
        jobs,
        snapshot,
        silence: Arc::new(|_, _, _| None),
        settings: Settings::default(),
        follows: false,
        searched: HashSet::new(),
    }
}

fn rig(config: Config, jobs: Vec<Job>, diagnose: impl Fn(&str) + Send + Sync + 'static) -> Rig {
    let ids: Vec<LoopId> = jobs.iter().map(|job| job.id.clone()).collect();
    let results = Arc::new(Results::new(&ids, 10, &alarm::Config::default()));
    let judge: Diagnose = Arc::new(move |record, _, _| {
        diagnose(&record.tags[0].0);
        nothing_to_say()
    });
    let clock = Clock::plant(0.0, 1.0);
    let scheduler = Arc::new(Scheduler::new(config, clock, judge, results.clone(), plan(jobs)));
    let token = CancellationToken::new();
    let (events, running) = (results.subscribe(), (scheduler.clone(), token.clone()));
    let task = tokio::spawn(async move { running.0.run(running.1).await });
    Rig { scheduler, events, results, token, task }
}

impl Rig {
    async fn next_run(&mut self) -> (String, f64, String) {
        loop {
            if let Event::Run(id, summary) = self.events.recv().await.expect("the channel stays open") {
                return (id.to_string(), summary.time, summary.outcome.to_string());
            }
        }
    }

    async fn stop(self) {
        self.token.cancel();
        self.task.await.expect("the scheduler ends by itself");
    }
}

/// A diagnosis that waits for the test before it returns.
fn gate() -> (std::sync::mpsc::Sender<()>, impl Fn() + Send + Sync + 'static) {
    let (open, closed) = std::sync::mpsc::channel::<()>();
    let closed = Mutex::new(closed);
    // A sender dropped by a failing test opens the gate too, so that the runtime can end.
    (open, move || {
        let _ = closed.lock().unwrap_or_else(PoisonError::into_inner).recv();
    })
}

#[test]
fn two_thousand_loops_spread_evenly_over_the_period() {
    let jobs: Vec<Job> =
        (0..2000).map(|i| Job { id: LoopId::new(format!("L{i}")), period_s: 3600.0 }).collect();
    let mut offsets: Vec<f64> = stagger(&jobs).iter().map(|(offset, _)| offset.as_secs_f64()).collect();
    offsets.sort_by(f64::total_cmp);
    assert!(offsets[0] > 0.0 && offsets[1999] < 3600.0);
    // Durations are whole nanoseconds: the gaps differ from 1.8 s by rounding only.
    assert!(offsets.windows(2).all(|w| (w[1] - w[0] - 1.8).abs() < 1e-8));
}

#[test]
fn loops_with_another_period_are_spread_among_themselves() {
    let mut mixed = jobs(&["a", "b"], 10.0);
    mixed.extend(jobs(&["c", "d"], 100.0));
    let offsets: Vec<f64> = stagger(&mixed).iter().map(|(offset, _)| offset.as_secs_f64()).collect();
    assert_eq!(offsets, vec![2.5, 7.5, 25.0, 75.0]);
    let silly = [f64::NAN, -1.0, f64::INFINITY, 0.0];
    for period_s in silly {
        let one = stagger(&[Job { id: LoopId::new("x"), period_s }]);
        assert!(one[0].1 >= Duration::from_millis(1), "{period_s}");
    }
}

#[test]
fn the_next_due_time_is_always_later_than_now() {
    let s = Duration::from_secs;
    assert_eq!(next_due(s(5), s(10), s(0)), (s(5), 0));
    assert_eq!(next_due(s(5), s(10), s(5)), (s(15), 1));
    assert_eq!(next_due(s(5), s(10), s(14)), (s(15), 1));
    assert_eq!(next_due(s(5), s(10), s(1000)), (s(1005), 100));
}

#[tokio::test(start_paused = true)]
async fn every_loop_runs_once_a_period_at_its_own_time() {
    let mut rig = rig(Config::default(), jobs(&["a", "b", "c", "d"], 100.0), |_| {});
    let mut seen = Vec::new();
    for _ in 0..8 {
        let (id, time, outcome) = rig.next_run().await;
        assert_eq!(outcome, "not_identifiable");
        seen.push((id, time.round()));
    }
    let expected = [12.0, 37.0, 62.0, 87.0, 112.0, 137.0, 162.0, 187.0];
    for (at, (id, time)) in seen.iter().enumerate() {
        assert_eq!(id, ["a", "b", "c", "d"][at % 4]);
        // Offsets end in .5, and a timer may be up to 1 ms late.
        assert!((time - expected[at]).abs() <= 1.0, "{seen:?}");
    }
    assert_eq!(rig.scheduler.counters().diagnosed, 8);
    rig.stop().await;
}

#[tokio::test(start_paused = true)]
async fn a_panic_is_counted_and_harms_no_other_loop() {
    let mut rig = rig(Config::default(), jobs(&["bad", "good"], 10.0), |id| {
        assert_ne!(id, "bad", "boom");
    });
    for _ in 0..3 {
        assert_eq!(rig.next_run().await.2, "panicked");
        assert_eq!(rig.next_run().await.2, "not_identifiable");
    }
    let counters = rig.scheduler.counters();
    assert_eq!((counters.panicked, counters.diagnosed), (3, 3));
    rig.stop().await;
}

#[tokio::test(start_paused = true)]
async fn a_copy_that_panics_is_counted_and_harms_no_later_run() {
    let mut rig = rig(Config::default(), jobs(&["a"], 10.0), |_| {});
    let broken: Snapshot =
        Arc::new(|_: &LoopId| -> Option<Record> { panic!("a copy that fails on purpose") });
    rig.scheduler.replace(Plan { snapshot: broken, ..plan(jobs(&["a"], 10.0)) });
    let answer = rig.scheduler.request(&LoopId::new("a")).expect("there is room").await;
    assert!(answer.is_err(), "nothing was run");
    assert_eq!(rig.scheduler.counters().panicked, 1);
    rig.scheduler.replace(plan(jobs(&["a"], 10.0)));
    assert_eq!(rig.next_run().await.2, "not_identifiable");
    rig.stop().await;
}

#[tokio::test(start_paused = true)]
async fn past_its_deadline_a_run_is_reported_and_its_late_result_dropped() {
    let (open, wait) = gate();
    let config = Config { parallelism: 2, deadline_s: 30.0, ..Config::default() };
    let mut rig = rig(config, jobs(&["slow", "quick"], 100.0), move |id| {
        if id == "slow" {
            wait();
        }
    });
    // Paused time stands still while a blocking thread runs, so the test moves it.
    let slow = rig.scheduler.request(&LoopId::new("slow")).expect("idle");
    while rig.scheduler.counters().running == 0 {
        tokio::task::yield_now().await;
    }
    tokio::time::advance(Duration::from_secs(31)).await;
    assert_eq!(slow.await.expect("answered at the deadline").outcome.as_str(), "deadline_exceeded");
    assert_eq!(rig.next_run().await.2, "deadline_exceeded");
    // Its loop counts as busy; another one runs beside it.
    assert_eq!(rig.scheduler.request(&LoopId::new("slow")).err(), Some(Refused::Overrunning));
    let quick = rig.scheduler.request(&LoopId::new("quick")).expect("idle");
    assert_eq!(quick.await.expect("runs").outcome.as_str(), "not_identifiable");
    assert_eq!(rig.next_run().await.0, "quick");
    tokio::time::advance(Duration::from_secs(100)).await;
    while rig.scheduler.counters().skipped_waiting == 0 {
        tokio::task::yield_now().await;
    }
    drop(open);
    while rig.scheduler.request(&LoopId::new("slow")).is_err() {
        tokio::task::yield_now().await;
    }
    let slow = rig.results.summaries(&LoopId::new("slow")).expect("known");
    assert_eq!(slow[0].outcome, "deadline_exceeded");
    assert_eq!(rig.scheduler.counters().deadline_exceeded, 1);
    rig.stop().await;
}

/// What another machine says of a loop.
fn told(time: f64) -> Told {
    Told {
        summary: crate::results::Summary {
            time,
            took_s: 0.5,
            trigger: Trigger::Periodic,
            outcome: "stiction".into(),
            reason_code: None,
            reason: "made for a test".into(),
            f: Some(1.0),
            f_ci95: Some([0.9, 1.1]),
            f_in_percent: true,
            delta_aic: Some(400.0),
            compensated: None,
        },
        report: Some("{}".into()),
        quality: "good".into(),
        structure: None,
        doubtful: false,
        fitted_until: None,
        effects: Vec::new(),
        unexplained: None,
        version: "0.1.0".into(),
    }
}

#[tokio::test(start_paused = true)]
async fn others_are_asked_first_and_what_they_do_not_answer_is_diagnosed_here() {
    let ids = ["theirs", "ours"].map(LoopId::new);
    let results = Arc::new(Results::new(&ids, 10, &alarm::Config::default()));
    let judge: Diagnose = Arc::new(|record, _, _| {
        assert_eq!(record.tags[0].0, "ours");
        nothing_to_say()
    });
    let elsewhere: Elsewhere = Arc::new(|asked| {
        assert_eq!(asked.basis.samples(), 0);
        let answer = (asked.id.as_str() == "theirs").then(|| told(asked.started + 0.25));
        Box::pin(async move { answer })
    });
    let (clock, plan) = (Clock::plant(0.0, 1.0), plan(jobs(&["theirs", "ours"], 100.0)));
    let scheduler = Scheduler::new(Config::default(), clock, judge, results.clone(), plan).asking(elsewhere);
    let (scheduler, token) = (Arc::new(scheduler), CancellationToken::new());
    let running = (scheduler.clone(), token.clone());
    let task = tokio::spawn(async move { running.0.run(running.1).await });
    for (id, outcome) in ids.iter().zip(["stiction", "not_identifiable"]) {
        let run = scheduler.request(id).expect("idle").await.expect("runs");
        assert_eq!(run.outcome.as_str(), outcome);
        if outcome == "stiction" {
            // By the clock of who asked, and the same wherever it is kept.
            assert_eq!(run.finished, run.started + 0.25);
        }
    }
    assert_eq!(scheduler.counters().diagnosed, 2);
    token.cancel();
    task.await.expect("the scheduler ends by itself");
}

#[tokio::test(start_paused = true)]
async fn a_run_that_failed_elsewhere_is_no_diagnosis() {
    let ids = ["panicked", "deadline_exceeded", "stiction"].map(LoopId::new);
    let results = Arc::new(Results::new(&ids, 10, &alarm::Config::default()));
    let judge: Diagnose = Arc::new(|_, _, _| nothing_to_say());
    let elsewhere: Elsewhere = Arc::new(|asked| {
        let mut answer = told(asked.started + 0.25);
        answer.summary.outcome = asked.id.to_string().into();
        if asked.id.as_str() != "stiction" {
            answer.report = None;
        }
        Box::pin(async move { Some(answer) })
    });
    let jobs = ids.iter().map(|id| Job { id: id.clone(), period_s: 1e6 }).collect();
    let (clock, plan) = (Clock::plant(0.0, 1.0), plan(jobs));
    let scheduler = Scheduler::new(Config::default(), clock, judge, results, plan).asking(elsewhere);
    let (scheduler, token) = (Arc::new(scheduler), CancellationToken::new());
    let running = (scheduler.clone(), token.clone());
    let task = tokio::spawn(async move { running.0.run(running.1).await });
    for id in &ids {
        let run = scheduler.request(id).expect("idle").await.expect("runs");
        assert_eq!(run.outcome.as_str(), id.as_str());
    }
    let Counters { diagnosed, panicked, deadline_exceeded, .. } = scheduler.counters();
    assert_eq!((diagnosed, panicked, deadline_exceeded), (1, 1, 1));
    token.cancel();
    task.await.expect("the scheduler ends by itself");
}

#[tokio::test(start_paused = true)]
async fn what_a_run_found_is_given_to_the_next_that_is_due_and_to_none_that_is_asked_for() {
    let ids = ["a", "written"].map(LoopId::new);
    let results = Arc::new(Results::new(&ids, 10, &alarm::Config::default()));
    let given = Arc::new(Mutex::new(Vec::new()));
    let heard = given.clone();
    let judge: Diagnose = Arc::new(move |_, _, last| {
        heard.lock().expect("no panic").push(last.map(|last| last.confirmed));
        let confirmed = last.map_or(0, |last| last.confirmed + 1);
        let mut found = made_findings(Verdict::NoStiction, Vec::new());
        found.structure = Some(Structure { confirmed, ..Structure::default() });
        Judged { findings: Some(found), ..nothing_to_say() }
    });
    let clock = Clock::plant(0.0, 1.0);
    let plan = Plan { searched: HashSet::from([ids[1].clone()]), ..plan(jobs(&["a", "written"], 1e6)) };
    let scheduler = Arc::new(Scheduler::new(Config::default(), clock, judge, results.clone(), plan));
    let token = CancellationToken::new();
    let running = (scheduler.clone(), token.clone());
    let task = tokio::spawn(async move { running.0.run(running.1).await });
    for trigger in [Trigger::Periodic, Trigger::Periodic, Trigger::OnDemand, Trigger::Periodic] {
        scheduler.ask(&ids[0], trigger).expect("idle").await.expect("runs");
    }
    assert_eq!(*given.lock().expect("no panic"), [None, Some(0), None, Some(0)]);
    assert_eq!((scheduler.counters().diagnosed, scheduler.counters().confirmed), (4, 2));
    // Nor to one of a loop that write-back may act on.
    for _ in 0..2 {
        scheduler.ask(&ids[1], Trigger::Periodic).expect("idle").await.expect("runs");
    }
    assert_eq!(given.lock().expect("no panic")[4..], [None, None]);
    token.cancel();
    task.await.expect("the scheduler ends by itself");
}

#[test]
fn a_loop_of_another_machine_is_not_diagnosed_here() {
    let results = Arc::new(Results::new(&[LoopId::new("a")], 10, &alarm::Config::default()));
    let judge: Diagnose = Arc::new(|_, _, _| nothing_to_say());
    let plan = Plan { follows: true, ..plan(Vec::new()) };
    let scheduler = Scheduler::new(Config::default(), Clock::plant(0.0, 1.0), judge, results, plan);
    assert_eq!(scheduler.request(&LoopId::new("a")).err(), Some(Refused::NotHere));
}

#[tokio::test(start_paused = true)]
async fn a_full_queue_refuses_callers_and_what_is_due_waits() {
    let (open, wait) = gate();
    let config = Config { queue: 1, deadline_s: 1e6, ..Config::default() };
    let rig = rig(config, jobs(&["a", "b", "c"], 1e6), move |_| wait());
    let first = rig.scheduler.request(&LoopId::new("a")).expect("idle");
    while rig.scheduler.counters().running == 0 {
        tokio::task::yield_now().await;
    }
    let second = rig.scheduler.request(&LoopId::new("b")).expect("one may wait");
    assert_eq!(rig.scheduler.request(&LoopId::new("c")).err(), Some(Refused::Busy));
    // What is due waits, once, and what is asked for goes before it.
    let due = rig.scheduler.table.borrow().seats[2].clone();
    rig.scheduler.begin(&due);
    rig.scheduler.begin(&due);
    let counters = rig.scheduler.counters();
    assert_eq!((counters.queued, counters.running, counters.skipped_waiting), (2, 1, 1));
    assert_eq!(rig.scheduler.request(&LoopId::new("c")).err(), Some(Refused::Busy));
    // A second caller for a running loop shares the run.
    let shared = rig.scheduler.request(&LoopId::new("a")).expect("joins");
    drop(open);
    let (first, shared) = (first.await.expect("done"), shared.await.expect("done"));
    assert!(Arc::ptr_eq(&first, &shared));
    assert_eq!(first.trigger, Trigger::OnDemand);
    second.await.expect("done");
    assert_eq!(rig.scheduler.request(&LoopId::new("nobody")).err(), Some(Refused::UnknownLoop));
    rig.stop().await;
}

#[tokio::test(start_paused = true)]
async fn a_loop_that_went_away_and_came_back_while_it_waited_runs_once() {
    let (open, wait) = gate();
    let config = Config { deadline_s: 1e6, ..Config::default() };
    let rig = rig(config, jobs(&["a", "b"], 1e6), move |id| {
        if id == "a" {
            wait();
        }
    });
    let first = rig.scheduler.request(&LoopId::new("a")).expect("idle");
    while rig.scheduler.counters().running == 0 {
        tokio::task::yield_now().await;
    }
    let before = rig.scheduler.table.borrow().seats[1].clone();
    rig.scheduler.begin(&before);
    rig.scheduler.replace(plan(jobs(&["a"], 1e6)));
    rig.scheduler.replace(plan(jobs(&["a", "b"], 1e6)));
    let again = rig.scheduler.request(&LoopId::new("b")).expect("a new seat");
    drop(open);
    first.await.expect("done");
    assert_eq!(again.await.expect("done").trigger, Trigger::OnDemand);
    while rig.scheduler.counters().queued + rig.scheduler.counters().running > 0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(rig.scheduler.counters().diagnosed, 2);
    rig.stop().await;
}

#[tokio::test(start_paused = true)]
async fn at_most_parallelism_diagnoses_run_at_once() {
    let now = Arc::new((AtomicU64::new(0), AtomicU64::new(0)));
    let seen = now.clone();
    let names: Vec<String> = (0..20).map(|i| format!("L{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let config = Config { parallelism: 3, ..Config::default() };
    let rig = rig(config, jobs(&names, 1e6), move |_| {
        let running = seen.0.fetch_add(1, Relaxed) + 1;
        seen.1.fetch_max(running, Relaxed);
        std::thread::yield_now();
        seen.0.fetch_sub(1, Relaxed);
    });
    let all: Vec<_> = names.iter().map(|n| rig.scheduler.request(&LoopId::new(*n)).expect("idle")).collect();
    for run in all {
        run.await.expect("done");
    }
    assert!(now.1.load(Relaxed) <= 3);
    rig.stop().await;
}

#[tokio::test(start_paused = true)]
async fn a_new_plan_takes_effect_at_once_and_running_loops_keep_their_seats() {
    let mut rig = rig(Config::default(), jobs(&["a"], 1e6), |_| {});
    rig.results.reload(&[LoopId::new("a"), LoopId::new("b")], &alarm::Config::default(), 0.0);
    let before = rig.scheduler.table.borrow().seats[0].clone();
    rig.scheduler.replace(plan(jobs(&["b", "a"], 10.0)));
    assert!(Arc::ptr_eq(&before, &rig.scheduler.table.borrow().seats[1]));
    assert_eq!(rig.next_run().await.0, "b");
    assert_eq!(rig.next_run().await.0, "a");
    rig.stop().await;
}

#[tokio::test(start_paused = true)]
async fn a_plant_that_runs_faster_is_diagnosed_more_often() {
    let clock = Clock::plant(1000.0, 60.0);
    clock.sleep_until(Duration::from_secs(600)).await;
    // 600 s of plant time are 10 s on the wall; timers tick in milliseconds, which are 0.06 s here.
    assert!((clock.now() - 1600.0).abs() < 0.1);
    assert!((clock.elapsed().as_secs_f64() - 600.0).abs() < 0.1);
}

/// Paused timers jump to the next one: a wait of a minute is one look a minute later, which a watched clock does not count.
#[tokio::test(start_paused = true)]
async fn a_watched_clock_waits_for_a_computer_that_stands_still() {
    let longest = Duration::from_millis(50);
    let clock = Clock::watched(1000.0, 20.0, longest);
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert_eq!((clock.now(), clock.elapsed()), (1001.0, Duration::from_secs(1)));
    // Looked at often enough it goes as any other.
    let asked = tokio::time::Instant::now();
    clock.sleep_until(Duration::from_secs(601)).await;
    assert!((clock.now() - 1601.0).abs() < 0.1);
    assert!((asked.elapsed().as_secs_f64() - 30.0).abs() < 0.1);
}

#[test]
fn impossible_settings_are_named() {
    assert_eq!(Config::default().validate(), vec![]);
    let bad = Config { period_s: f64::NAN, parallelism: 0, deadline_s: -1.0, queue: 0, keep_results: 0 };
    let fields: Vec<&str> = bad.validate().iter().map(|(field, _)| *field).collect();
    assert_eq!(fields, vec!["period_s", "deadline_s", "parallelism", "queue", "keep_results"]);
}
