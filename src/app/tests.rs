use super::*;
use crate::results::{Outcome, Run, Trigger};
use crate::serve::NotificationPort;
use crate::signal::Sample;
use crate::sim::scenarios;
use crate::store::{AlarmRow, Batch, Row, Store};
use std::fmt::Write;

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
    let plan = schedule_plan(&config, &history);

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
