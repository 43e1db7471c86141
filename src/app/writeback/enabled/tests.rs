use super::super::tests::{config, parts};
use super::*;
use crate::access::{Cost, PasswordHash, Role as Right, Roles, file};
use crate::app::App;
use crate::audit::Bounds;
use crate::compensation::gate::State;
use crate::diagnosis::Diagnosis;
use crate::results::{Outcome, Run, Trigger};
use crate::serve::NotificationPort;
use futures::FutureExt;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::mpsc;

fn id() -> LoopId {
    LoopId::new("A")
}

fn control(results: &Arc<Results>) -> WritebackControl {
    WritebackControl {
        clock: Clock::wall(),
        results: results.clone(),
        book: None,
        recorder: RwLock::default(),
        current: RwLock::default(),
        opening: Mutex::default(),
        read: Mutex::default(),
    }
}

/// A folder of its own for each test.
fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("stictiond-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("the temporary folder is writable");
    path
}

fn recorder(folder: &std::path::Path) -> Arc<Recorder> {
    let bounds = Bounds { max_bytes: 1 << 20, keep_files: 1 };
    Arc::new(Recorder::start(&folder.join("audit.log"), bounds, 0.0).expect("opens"))
}

/// The loop in shadow. Its device is gone, so that its task looks up once a second.
fn setups() -> Vec<LoopSetup> {
    let config = config();
    let own = config.loops[0].writeback.as_ref().expect("configured");
    vec![LoopSetup {
        id: id(),
        limits: own.limits(100.0, [0.0, 100.0]),
        target: own.target("127.0.0.1:9", 1, 0).expect("registers"),
        pause: Duration::from_secs(1),
        polled: watch::Sender::new(0).subscribe(),
        heard: Arc::new(|| 0),
        look: Arc::new(Inputs::default),
        keep: Arc::new(|_| ()),
        lasts_s: own.term_lasts_s(),
    }]
}

fn stiction(started: f64) -> Run {
    Run {
        id: id(),
        started,
        finished: started + 1.0,
        took_s: 1.0,
        trigger: Trigger::Periodic,
        op_span: Some(100.0),
        basis: None,
        outcome: Outcome::Diagnosed(Box::new(Diagnosis::bare(Verdict::Stiction, "made for a test").into())),
    }
}

#[test]
fn a_diagnosis_of_what_the_loop_was_before_a_reload_is_no_evidence() {
    let config = config();
    let (history, results) = parts(&config);
    let see = || {
        let look = look((id(), 1000.0), history.clone(), results.clone(), Clock::wall(), || 0);
        look().evidence.is_some()
    };
    assert!(!see());
    // It ended after the reload, and worked on samples of before.
    results.record(stiction(999.5));
    assert!(!see());
    results.record(stiction(1000.5));
    assert!(see());
}

#[test]
fn a_diagnosis_tells_when_its_data_ended_and_not_only_when_it_was_made() {
    let (history, results) = parts(&config());
    let mut run = stiction(1000.5);
    if let Outcome::Diagnosed(judged) = &mut run.outcome {
        judged.diagnosis.preparation.end = 400.0;
    }
    results.record(run);
    let look = look((id(), 1000.0), history, results, Clock::wall(), || 0);
    let evidence = look().evidence.expect("it was diagnosed");
    assert_eq!((evidence.at, evidence.data_end), (1001.5, 400.0));
}

#[test]
fn only_a_loop_that_is_read_or_diagnosed_in_another_way_needs_another_diagnosis() {
    let config = config();
    let (history, results) = parts(&config);
    let control = control(&results);
    assert_eq!(control.read_since(&id()), f64::INFINITY);
    let since = |config: &Config| {
        let history = history.successor(&config.plant().expect("it was checked").loops, &config.history);
        // Between two looks the clock has to have gone on.
        std::thread::sleep(Duration::from_millis(2));
        control.note_how_read(config, &history);
        control.read_since(&id())
    };
    let first = since(&config);
    assert_eq!(since(&config), first, "the same file again");
    let mut span = config.clone();
    span.loops[0].op_span = Some(50.0);
    let second = since(&span);
    assert!(second > first);
    let mut settings = span.clone();
    settings.diagnosis.f_threshold_percent *= 2.0;
    let third = since(&settings);
    assert!(third > second);
    // What it once was, it has not been since.
    assert!(since(&config) > third);
}

#[tokio::test]
async fn while_it_ends_it_is_shown_and_grants_nothing() {
    let folder = folder("ending");
    let config = config();
    let (_, results) = parts(&config);
    let control = control(&results);
    control.start(setups(), recorder(&folder));
    // The task has looked up, and does so again after a second.
    tokio::time::sleep(Duration::from_millis(100)).await;
    // Before the task has its next turn.
    let asked = async {
        let granted = control.act(&id(), Action::Grant(60.0), "ann").await;
        (control.status(&id()).map(|status| status.state), granted.map(|granted| granted.is_ok()))
    };
    let ((), asked) = tokio::join!(control.end(), asked);
    assert_eq!(asked, (Some(State::Disabled), Some(false)));
    assert_eq!(control.status(&id()), None);
    std::fs::remove_dir_all(&folder).expect("the folder is there");
}

/// Setups whose first loop says that it looks, and then looks until the sender is dropped: a step of it, and with it a reload or the
/// way to zero, takes so long.
fn held_up() -> (Vec<LoopSetup>, Arc<AtomicBool>, mpsc::Sender<()>) {
    let (go_on, waits) = mpsc::channel::<()>();
    let (waits, looks) = (Mutex::new(waits), Arc::new(AtomicBool::new(false)));
    let looked = looks.clone();
    let mut setups = setups();
    setups[0].pause = Duration::from_millis(1);
    setups[0].look = Arc::new(move || {
        looked.store(true, SeqCst);
        let _ = waits.lock().unwrap_or_else(PoisonError::into_inner).recv();
        Inputs::default()
    });
    (setups, looks, go_on)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_alarms_look_at_is_free_while_a_reload_waits_for_terms() {
    let folder = folder("reload");
    let app = App::build(config(), Clock::wall(), App::diagnosis()).expect("it is sound");
    let (setups, looks, go_on) = held_up();
    app.writeback.start(setups, recorder(&folder));
    while !looks.load(SeqCst) {
        tokio::task::yield_now().await;
    }
    let mut reloading = app.reload(config());
    assert!((&mut reloading).now_or_never().is_none(), "it waits for write-back");
    assert_eq!(app.writeback.status(&id()).map(|status| status.state), Some(State::Disabled));
    let is_free = app.state.try_lock().is_ok();
    drop(go_on);
    reloading.await.expect("it is taken");
    assert!(is_free, "a reload holds alarms up for as long as a term takes");
    std::fs::remove_dir_all(&folder).expect("the folder is there");
}

/// The next start takes a trip of before it for over, so nobody would ever hear of one that came during the stop.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_trips_while_terms_go_to_zero_for_a_stop_is_told() {
    let folder = folder("stopping");
    let mut config = config();
    let store = format!("folder = {:?}", folder.join("store"));
    config.store = Some(toml::from_str(&store).expect("it is right"));
    let mut receiver = "name = 'cmms'\nurl = 'http://127.0.0.1:1/'\n".to_string();
    receiver += "secret_env = 'NO_SUCH_SECRET'\n[pace]\nwait_s = 3600.0\n";
    config.notify.webhook = vec![toml::from_str(&receiver).expect("it is right")];
    let app = App::build(config, Clock::wall(), App::diagnosis()).expect("it is sound");
    let (setups, looks, go_on) = held_up();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let stopping = async {
        while !app.state.lock().await.collecting {
            tokio::task::yield_now().await;
        }
        app.writeback.start(setups, recorder(&folder));
        while !looks.load(SeqCst) {
            tokio::task::yield_now().await;
        }
        app.stop().cancel();
        // Half a second: who stops at once has long done so.
        for _ in 0..100 {
            assert!(!app.notifications.receivers().is_empty(), "nobody is told any more");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        app.results.watch_trip(&id(), Some("a fault".into()), Clock::wall().now());
        drop(go_on);
    };
    let both = async { tokio::join!(app.run(listener), stopping) };
    let (ended, ()) = tokio::time::timeout(Duration::from_secs(60), both).await.expect("it ends");
    ended.expect("it is sound");
    let letters = std::fs::read_dir(folder.join("store/letters/cmms")).expect("there is a letter");
    let told = letters.flatten().filter_map(|letter| std::fs::read_to_string(letter.path()).ok());
    assert!(told.into_iter().any(|letter| letter.contains("compensation_tripped")));
    drop(app);
    std::fs::remove_dir_all(&folder).expect("the folder is there");
}

#[tokio::test]
async fn a_grant_ends_with_the_right_to_give_it() {
    let folder = folder("rights");
    let book = folder.join("access.json");
    let change = |what: &dyn Fn(&mut crate::access::Book)| {
        let changed = file::change(&book, |book| {
            what(book);
            Ok::<_, crate::access::FileError>(())
        });
        changed.expect("changed");
    };
    change(&|book| {
        let hash = PasswordHash::of("word", [1; 16], Cost { memory_kib: 8, passes: 1 }).expect("a cost");
        book.add_user("ann", Roles::of(&[Right::Approver]), hash).expect("added");
    });
    let (_, results) = parts(&config());
    let control = WritebackControl { book: Some(book.clone()), ..control(&results) };
    control.start(setups(), recorder(&folder));
    control.act(&id(), Action::Grant(60.0), "ann").await.expect("enabled").expect("granted");
    let granted = || control.status(&id()).is_some_and(|status| status.grant.is_some());
    // Looked at once a second.
    tokio::time::sleep(Duration::from_millis(2500)).await;
    assert!(granted(), "she may");
    change(&|book| book.change_user("ann", Some(Roles::of(&[Right::Operator])), None).expect("there"));
    let began = std::time::Instant::now();
    while granted() {
        assert!(began.elapsed() < Duration::from_secs(20), "she may no longer, and it stays granted");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    control.end().await;
    std::fs::remove_dir_all(&folder).expect("the folder is there");
}
