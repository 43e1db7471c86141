use super::*;
use crate::audit::Bounds;
use crate::compensation::measure::Criteria;
use crate::writeback::config::{TermType, WordOrder};
use std::path::Path;

const LIMITS: Limits = Limits {
    clamp: 3.0,
    rate: 2.0,
    withdraw_rate: 1.0,
    withdraw_limit_s: 3600.0,
    dead_band: 0.0,
    rest_s: 5.0,
    max_step_s: 2.0,
    clock_tolerance_s: 1.0,
    max_sample_age_s: 3.0,
    max_missed_polls: 1,
    op_span: 100.0,
    op_limits: [0.0, 100.0],
    op_margin: 5.0,
    sp_rate: 0.1,
    sp_settle_s: 3.0,
    evidence_max_age_s: 1000.0,
    f_margin: 0.1,
    grant_max_s: 100.0,
    criteria: Criteria {
        length_s: 5.0,
        prove_s: 50.0,
        ise_gain: 1.1,
        ise_limit: 100.0,
        travel_limit: 10.0,
        reversal_band: 0.1,
    },
};

fn id() -> LoopId {
    LoopId::new("FIC101")
}

fn target() -> Target {
    Target {
        address: "127.0.0.1:0".into(),
        unit_id: 1,
        term: 0,
        heartbeat: 2,
        term_type: TermType::F32,
        order: WordOrder::Abcd,
        scale: 1.0,
        timeout: Duration::from_millis(100),
    }
}

/// One loop in shadow, with its log in a folder.
fn started(folder: &Path, polled: watch::Receiver<u64>) -> Writeback {
    std::fs::create_dir_all(folder).expect("the temporary folder is writable");
    let bounds = Bounds { max_bytes: 1 << 20, keep_files: 1 };
    let recorder = Arc::new(Recorder::start(&folder.join("audit.log"), bounds, 0.0).expect("opens"));
    let setup = LoopSetup {
        id: id(),
        limits: LIMITS,
        target: target(),
        pause: Duration::from_millis(10),
        polled,
        look: Arc::new(Inputs::default),
        keep: Arc::new(|_| {}),
    };
    let clocks: Clocks = Arc::new(|| Time { mono: 0.0, wall: 0.0 });
    Writeback::start(vec![setup], clocks, recorder, Arc::new(|_, _| {}))
}

/// A stop that comes before the tasks had their first turn must not leave them running until the withdrawal's limit.
#[tokio::test]
async fn what_is_stopped_as_soon_as_it_starts_ends_at_once() {
    let folder = std::env::temp_dir().join(format!("stictiond-run-{}", std::process::id()));
    let (_polls, polled) = watch::channel(0);
    let running = started(&folder, polled);
    let ended = tokio::time::timeout(Duration::from_secs(10), running.end()).await;
    let state = running.status(&id()).map(|status| status.state);
    std::fs::remove_dir_all(&folder).expect("the folder is there");
    assert_eq!((ended.is_ok(), state), (true, Some(State::Disabled)));
}

/// What the writer says was about another write.
#[tokio::test]
async fn a_term_that_cannot_be_put_on_record_was_not_refused_by_the_device() {
    let folder = std::env::temp_dir().join(format!("stictiond-why-{}", std::process::id()));
    let (_polls, polled) = watch::channel(0);
    let running = started(&folder, polled.clone());
    let (writer, look, pause) = (Writer::new(target()), Arc::new(Inputs::default), Duration::ZERO);
    let task = Task { slot: running.slots[&id()].clone(), writer, look, polled, pause };
    assert_eq!(task.why(WriteFault::Audit), "it cannot be put on record");
    assert_eq!(task.why(WriteFault::Failed), task.writer.why());
    running.end().await;
    std::fs::remove_dir_all(&folder).expect("the folder is there");
}
