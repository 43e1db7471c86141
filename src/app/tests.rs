use super::*;
use crate::results::{Basis, Event, Outcome, Run, Trigger, made_findings};
use crate::serve::NotificationPort;
use crate::signal::{Record, Sample};
use crate::sim::scenarios;
use crate::store::{AlarmRow, Batch, DiagnosisRow, Row, Store};
use std::fmt::Write;
use std::pin::pin;
use std::task::Poll;

/// Three loops of one unit: a flow whose valve sticks, a level that the flow feeds, a pressure of its own.
fn text() -> String {
    let mut text = "[[modbus]]\nname = \"dcs\"\naddress = \"127.0.0.1:1502\"\naddress_base = 0\n".to_string();
    for (at, (id, candidates)) in
        [("FIC203", "\"auto\""), ("LIC7", "[\"FIC203.pv\", \"PIC1.pv\"]"), ("PIC1", "\"auto\"")]
            .into_iter()
            .enumerate()
    {
        let tag = |name, address| {
            format!(
                "{name} = {{ device = \"dcs\", register = \"holding\", address = {address}, type = \"u16\" }}\n"
            )
        };
        let head = format!(
            "[[loop]]\nid = \"{id}\"\ngroup = \"unit 1\"\nop_span = 100.0\ncandidates = {candidates}\n"
        );
        write!(text, "{head}{}{}", tag("op", 2 * at), tag("pv", 2 * at + 1))
            .expect("a string takes everything");
    }
    text
}

fn config() -> Config {
    config::parse("f", &text()).expect("it is right")
}

/// A loop under PI control with a sound valve and a load: `y' = 0.9 y + 0.3 u + 0.25 load`.
fn driven(load: &[f64], seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut state = seed;
    let mut noise = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
    };
    let (mut y, mut integral, mut before) = (0.0f64, 0.0f64, [0.0f64; 2]);
    let mut walk = 0.0f64;
    let step = |load: &f64| {
        walk = 0.9 * walk + 0.1 * noise();
        let measured = y + 0.02 * noise();
        integral -= 0.03 * measured;
        let u = 50.0 - 0.3 * measured + integral;
        y = 0.9 * y + 0.3 * (before[1] - 50.0) + 0.25 * load + walk;
        before = [u, before[0]];
        (u, measured)
    };
    load.iter().map(step).unzip()
}

#[test]
fn an_oscillation_is_traced_through_a_neighbour_to_the_valve_that_sticks() {
    let config = config();
    let wired = config.plant().expect("it was checked");
    let history = Arc::new(History::new(&wired.loops, &config.history));
    let results = Arc::new(Results::new(&ids(&config), 3, &config.alarm));
    let plan = schedule_plan(&config, &history, Clock::wall());

    let flow = scenarios::table2()
        .into_iter()
        .find(|s| s.truth.kind.contains("flow control (strong"))
        .expect("it is there");
    let flow = flow.run().expect("it can be simulated");
    let n = flow.t.len();
    let deviation: Vec<f64> = {
        let mean = flow.pv[..n].iter().sum::<f64>() / n as f64;
        flow.pv[..n].iter().map(|pv| pv - mean).collect()
    };
    let (level_op, level_pv) = driven(&deviation, 1);
    let (pressure_op, pressure_pv) = driven(&vec![0.0; n], 2);
    let columns = [&flow.op[..n], &flow.pv[..n], &level_op, &level_pv, &pressure_op, &pressure_pv];
    for (tag, column) in columns.into_iter().enumerate() {
        for (&t, &value) in flow.t.iter().zip(column) {
            assert!(history.push(tag, Sample::good(t, value)));
        }
    }
    let diagnose = App::diagnosis();
    for id in ids(&config) {
        let record = (plan.snapshot)(&id).expect("the loop is there");
        assert_eq!(record.tags.len(), 2, "{id}");
        let judged = diagnose(&record, &plan.settings, None);
        let outcome = Outcome::Diagnosed(Box::new(judged));
        let trigger = Trigger::Periodic;
        results.record(Run {
            basis: None,
            id,
            started: 0.0,
            finished: 1.0,
            took_s: 0.1,
            trigger,
            op_span: Some(100.0),
            outcome,
        });
    }
    let [flow, level, pressure] = ["FIC203", "LIC7", "PIC1"].map(LoopId::new);
    let origin = results.origin(&level).expect("the flow drives the level");
    assert_eq!(
        (origin.path, origin.starts_in, origin.sticky),
        (vec![level.clone(), flow.clone()], Some(flow.clone()), true)
    );
    assert_eq!(results.origin(&flow), None, "the flow oscillates by itself");
    assert_eq!(results.origin(&pressure), None);
    let sticks = |id| results.get(id, 2.0).and_then(|known| known.diagnosed).is_some_and(|run| run.sticks());
    assert_eq!([&flow, &level, &pressure].map(sticks), [true, false, false]);
}

/// Whoever waits for messages begins to hear before the design does anything: the store has an alarm that stands and was
/// suppressed, and the configuration suppresses it no more.
#[tokio::test]
async fn what_the_configuration_no_longer_suppresses_is_told_at_the_start() {
    let folder = std::env::temp_dir().join(format!("stictiond-unsuppressed-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    let mut text = text() + &format!("[store]\nfolder = {:?}\n", folder.join("store"));
    text += "[[notify.webhook]]\nname = 'cmms'\nurl = 'http://127.0.0.1:1/'\nsecret_env = 'NO_SUCH_SECRET'\n";
    text += "[notify.webhook.pace]\nwait_s = 3600.0\n";
    let config = config::parse("f", &text).expect("it is right");
    std::fs::create_dir_all(&folder).expect("writable");
    let stands = AlarmRow {
        control_loop: "FIC203".into(),
        kind: "stiction".into(),
        active: true,
        suppressed: true,
        since: Some(1.0),
        raised_at: Some(1.0),
        ..AlarmRow::default()
    };
    let mut store = Store::open(config.store.as_ref().expect("there")).expect("opens");
    store.write(&Batch { series: Vec::new(), rows: vec![Row::Alarm(stands)] }).expect("writes");
    drop(store);
    let app = App::build(config, Clock::wall(), App::diagnosis()).expect("it is sound");
    let stop = CancellationToken::new();
    let heard = async {
        while app.notifications.receivers().iter().all(|own| own.queue == 0) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        stop.cancel();
    };
    let both = async { tokio::join!(app.notifications.run(stop.clone()), heard) };
    tokio::time::timeout(Duration::from_secs(60), both).await.expect("it waits to be told");
    drop(app);
    let _ = std::fs::remove_dir_all(&folder);
}

/// What the rings still have of a loop says nothing of it as it is now.
#[tokio::test]
async fn a_loop_of_which_nothing_comes_any_more_is_not_diagnosed_again() {
    const START: f64 = 1_767_225_600.0;
    let clock = Clock::by_hand(START);
    let diagnose: Diagnose = Arc::new(|_, _, _| {
        diagnosis::Diagnosis::bare(diagnosis::Verdict::NoStiction, "made for a test").into()
    });
    let app = App::build(config(), clock, diagnose).expect("it is sound");
    let history = app.state.lock().await.history.clone();
    // A sample comes when its stamp says so (s after the start).
    let comes = |tag: usize, at: f64, value: f64| {
        assert!(history.push(tag, Sample::good(START + at, value)));
        history.ring(tag).expect("a tag").heard().sample(START + at, at);
    };
    for k in 0..300 {
        comes(0, f64::from(k), f64::from(k % 17));
        comes(1, f64::from(k), f64::from(k % 17));
    }
    let (id, stop) = (LoopId::new("FIC203"), CancellationToken::new());
    let said = async |after_s: f64| {
        clock.set(START + 299.0 + after_s);
        let summary = app.scheduler.request(&id).expect("idle").await.expect("it runs").summary();
        (summary.outcome.to_string(), summary.reason_code.map(|code| code.to_string()), summary.reason)
    };
    let asking = async {
        assert_eq!(said(3599.0).await.0, "no_stiction");
        let reason = "silent: no good sample of PV since 2026-01-01 00:04:59 UTC".to_string();
        let silent = ("not_identifiable".to_string(), Some("silent".to_string()), reason);
        assert_eq!([said(3601.0).await, said(400_000.0).await], [silent.clone(), silent]);
        comes(1, 400_299.0, 1.0);
        comes(0, 400_299.0, 1.0);
        assert_eq!(said(400_001.0).await.0, "no_stiction", "it is back");
        stop.cancel();
    };
    let both = async { tokio::join!(app.scheduler.run(stop.clone()), asking) };
    tokio::time::timeout(Duration::from_secs(60), both).await.expect("they end");
}

/// A run that finds a valve that sticks.
fn sticking() -> Judged {
    let mut found = made_findings(diagnosis::Verdict::Stiction, Vec::new());
    found.structure = Some(residual::Structure::default());
    let declared = diagnosis::Diagnosis::bare(diagnosis::Verdict::Stiction, "made for a test");
    Judged { findings: Some(found), ..declared.into() }
}

/// Whether the next run is given a structure, and whether friction of before a term is known.
fn is_given(results: &Results, id: &LoopId) -> (bool, bool) {
    (results.structure(id).is_some(), results.before(id).is_some())
}

/// The plant with OP of the first loop in another register.
fn elsewhere(text: &str) -> String {
    text.replace("address = 0,", "address = 40,")
}

#[tokio::test]
async fn a_loop_that_a_reload_points_at_another_valve_is_given_nothing_of_the_one_before() {
    let clock = Clock::by_hand(1000.0);
    let diagnose: Diagnose = Arc::new(|_, _, _| sticking());
    let app = App::build(config(), clock, diagnose).expect("it is sound");
    let history = app.state.lock().await.history.clone();
    for (k, tag) in (0..300).flat_map(|k| [(k, 0), (k, 1)]) {
        assert!(history.push(tag, Sample::good(700.0 + f64::from(k), f64::from(k % 17))));
    }
    let (id, stop) = (LoopId::new("FIC203"), CancellationToken::new());
    let reload = async |text: String| {
        app.reload(config::parse("f", &text).expect("it is right")).await.expect("it is sound");
        is_given(&app.results, &id)
    };
    let asking = async {
        app.scheduler.request(&id).expect("idle").await.expect("it runs");
        assert_eq!(is_given(&app.results, &id), (true, true));
        // Another loop is read elsewhere.
        assert_eq!(reload(text().replace("address = 4,", "address = 44,")).await, (true, true));
        assert_eq!(reload(elsewhere(&text())).await, (false, false));
        stop.cancel();
    };
    let both = async { tokio::join!(app.scheduler.run(stop.clone()), asking) };
    tokio::time::timeout(Duration::from_secs(60), both).await.expect("they end");
}

#[tokio::test]
async fn a_start_is_given_nothing_of_another_valve_and_no_structure_of_another_version() {
    let (own, other_build) = (crate::version::BUILD, concat!(env!("CARGO_PKG_VERSION"), "+0"));
    let cases = [
        ("same", own, false, (true, true)),
        ("version", "0.0.1", false, (false, true)),
        ("build", other_build, false, (false, true)),
        ("elsewhere", own, true, (false, false)),
    ];
    for (name, version, is_elsewhere, given) in cases {
        let folder = std::env::temp_dir().join(format!("stictiond-valve-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("writable");
        let text = text() + &format!("[store]\nfolder = {:?}\n", folder.join("store"));
        let before = config::parse("f", &text).expect("it is right");
        let id = LoopId::new("FIC203");
        let history = History::new(&before.plant().expect("it was checked").loops, &before.history);
        let record = Record { source: history.source(&id), ..Record::default() };
        let run = Run {
            basis: Some(Arc::new(Basis::of(&record, &Settings::default(), None))),
            id: id.clone(),
            started: 0.0,
            finished: 1.0,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            op_span: Some(100.0),
            outcome: Outcome::Diagnosed(Box::new(sticking())),
        };
        let row = persistence::rows::diagnosis_row(&run, &run.summary());
        let rows = vec![Row::Diagnosis(DiagnosisRow { version: version.into(), ..row })];
        let mut store = Store::open(before.store.as_ref().expect("there")).expect("opens");
        store.write(&Batch { series: Vec::new(), rows }).expect("writes");
        drop(store);
        let text = if is_elsewhere { elsewhere(&text) } else { text };
        let now = config::parse("f", &text).expect("it is right");
        let app = App::build(now, Clock::wall(), App::diagnosis()).expect("it is sound");
        assert_eq!(is_given(&app.results, &id), given, "{name}");
        let shown = app.results.summaries(&id).map(|all| all.len());
        assert_eq!(shown, Some(1), "{name}: it is shown all the same");
        drop(app);
        let _ = std::fs::remove_dir_all(&folder);
    }
}

/// Whoever hears that there are other loops asks for them at once.
#[tokio::test]
async fn that_there_are_other_loops_is_told_once_they_are_shown() {
    let folder = std::env::temp_dir().join(format!("stictiond-reloaded-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    // A store takes its time.
    let old = text() + &format!("[store]\nfolder = {:?}\n", folder.join("store"));
    let [old, new] = [old.clone(), old.replace("PIC1", "PIC2")]
        .map(|text| config::parse("f", &text).expect("it is right"));
    std::fs::create_dir_all(&folder).expect("writable");
    let app = App::build(old, Clock::wall(), App::diagnosis()).expect("it is sound");
    let mut events = app.results.subscribe();
    let is_shown = || app.plant.borrow().loops().iter().any(|own| own.id.as_str() == "PIC2");
    let (mut waited, mut told) = (false, false);
    {
        let mut reloading = pin!(app.reload(new));
        let reloaded = async {
            loop {
                let ended = std::future::poll_fn(|cx| Poll::Ready(reloading.as_mut().poll(cx))).await;
                while let Ok(event) = events.try_recv() {
                    if let Event::Reloaded { loops } = event {
                        assert!(is_shown(), "it is told before the new loops are there");
                        told = loops == 3;
                    }
                }
                match ended {
                    Poll::Ready(done) => return done,
                    Poll::Pending => waited = true,
                }
                tokio::task::yield_now().await;
            }
        };
        let done = tokio::time::timeout(Duration::from_secs(60), reloaded).await;
        done.expect("it ends").expect("it is sound");
    }
    assert!(waited && told, "waited {waited}, told {told}");
    drop(app);
    let _ = std::fs::remove_dir_all(&folder);
}
