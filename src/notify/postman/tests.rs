use super::*;
use crate::alarm;
use crate::notify::Outlet;
use crate::notify::notice::Places;
use crate::notify::notice::tests::change;
use crate::results::Results;
use crate::signal::LoopId;
use futures::FutureExt;
use std::sync::{Mutex, RwLock};

/// Notes when it is asked and what for, and answers as it was told, in the end with thanks.
struct Script {
    began: Instant,
    tried: Mutex<Vec<(f64, String)>>,
    faults: Mutex<Vec<Fault>>,
}

struct Scripted(Arc<Script>);

impl Carrier for Scripted {
    fn compose(&self, digest: &Digest, _source: &Source, _now: f64) -> String {
        format!("{} {}", digest.changes(), digest.lost)
    }

    async fn carry(&self, letter: &Letter) -> Result<(), Fault> {
        let at = self.0.began.elapsed().as_secs_f64();
        self.0.tried.lock().unwrap().push((at, letter.body.clone()));
        self.0.faults.lock().unwrap().pop().map_or(Ok(()), Err)
    }
}

struct Rig {
    results: Arc<Results>,
    script: Arc<Script>,
    letters: Arc<Letters>,
    state: Arc<State>,
    postman: Postman<Scripted>,
}

fn rig(loops: usize, faults: Vec<Fault>, retry: Retry) -> Rig {
    let ids: Vec<LoopId> = (0..loops).map(|at| LoopId::new(format!("L{at}"))).collect();
    let results = Arc::new(Results::new(&ids, 5, &alarm::Config::default()));
    let script =
        Arc::new(Script { began: Instant::now(), tried: Mutex::default(), faults: Mutex::new(faults) });
    let places = Arc::new(RwLock::new(Arc::new(Places::default())));
    let source = Source {
        results: results.clone(),
        places,
        now: Arc::new(|| 0.0),
        site: None,
        public_url: None,
        outlet: None,
    };
    let (letters, state) = (Arc::new(Letters::open(None, 5)), Arc::new(State::default()));
    let postman = Postman::new("it", Scripted(script.clone()), source, letters.clone(), state.clone());
    let pace = Pace { wait_s: 0.0, interval_s: 0.0, ..Pace::default() };
    let postman = postman.with(&[What::Raised], &Filter::default(), &pace, &retry);
    Rig { results, script, letters, state, postman }
}

fn trip(results: &Results, at: usize) {
    results.watch_trip(&LoopId::new(format!("L{at}")), Some("a fault".into()), at as f64);
}

/// Lets the postman work for so long, on a clock that stands still while anybody works.
async fn work(postman: Postman<Scripted>, seconds: f64) {
    let stop = CancellationToken::new();
    let task = tokio::spawn(postman.run(stop.clone()));
    tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
    stop.cancel();
    task.await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn pauses_grow_to_the_longest_and_in_the_end_the_letter_is_dead() {
    let retry = Retry { first_s: 1.0, longest_s: 8.0, for_s: 60.0, dead_letters: 5 };
    let faults = vec![Fault::Later("away".into(), None); 100];
    let Rig { results, script, letters, state, postman } = rig(1, faults, retry);
    trip(&results, 0);
    work(postman, 100.0).await;
    let tried: Vec<f64> = script.tried.lock().unwrap().iter().map(|(at, _)| *at).collect();
    for (k, pair) in tried.windows(2).enumerate() {
        let (pause, whole) = (pair[1] - pair[0], 2f64.powi(k as i32).min(8.0));
        // A timer counts whole milliseconds.
        assert!((0.5 * whole..whole + 0.002).contains(&pause), "{k}: {pause}");
    }
    let last = *tried.last().unwrap();
    assert!(tried.len() > 8 && (60.0 - 8.0..=60.0).contains(&(last - tried[0])), "{tried:?}");
    assert_eq!(letters.counts(), (0, 1));
    assert_eq!((letters.dead()[0].attempts as usize, letters.dead()[0].why.as_str()), (tried.len(), "away"));
    let own = state.snapshot();
    assert_eq!((own.sent, own.failed as usize, own.queue), (0, tried.len(), 0));
    assert!(own.failing.is_some());
}

#[tokio::test(start_paused = true)]
async fn the_pause_that_a_receiver_asks_for_is_kept() {
    let faults = vec![Fault::Later("busy".into(), Some(Duration::from_secs(50)))];
    let Rig { results, script, letters, state, postman } = rig(1, faults, Retry::default());
    trip(&results, 0);
    work(postman, 60.0).await;
    let tried = script.tried.lock().unwrap().clone();
    assert!(tried.len() == 2 && (50.0..50.01).contains(&(tried[1].0 - tried[0].0)), "{tried:?}");
    assert_eq!((letters.counts(), state.snapshot().failing), ((0, 0), None));
}

#[tokio::test(start_paused = true)]
async fn who_asks_for_more_than_is_left_is_asked_once_more_at_the_end() {
    for (refusals, dead) in [(1, 0), (2, 1)] {
        let busy = Fault::Later("busy".into(), Some(Duration::from_secs(7200)));
        let retry = Retry { for_s: 60.0, ..Retry::default() };
        let Rig { results, script, letters, postman, .. } = rig(1, vec![busy; refusals], retry);
        trip(&results, 0);
        work(postman, 100.0).await;
        let tried = script.tried.lock().unwrap().clone();
        assert!(tried.len() == 2 && (59.99..60.01).contains(&(tried[1].0 - tried[0].0)), "{tried:?}");
        assert_eq!(letters.counts(), (0, dead));
    }
}

#[tokio::test(start_paused = true)]
async fn who_is_gone_is_so_until_something_is_taken() {
    let Rig { results, letters, state, postman, .. } =
        rig(2, vec![Fault::Gone("410".into())], Retry::default());
    let replayed = letters.clone();
    let asked = state.clone();
    trip(&results, 0);
    let later = tokio::spawn(async move {
        tokio::time::sleep(Duration::from_secs(5)).await;
        assert!(asked.is_gone());
        replayed.replay(None);
    });
    work(postman, 10.0).await;
    later.await.unwrap();
    assert_eq!((letters.counts(), state.is_gone()), ((0, 0), false));
}

#[tokio::test(start_paused = true)]
async fn more_changes_than_the_channel_holds_are_told_all_the_same() {
    let Rig { results, script, postman, .. } = rig(2100, Vec::new(), Retry::default());
    // 1024 events wait at most, and the log knows the last 2000 changes.
    (0..1500).for_each(|at| trip(&results, at));
    work(postman, 1.0).await;
    assert_eq!(script.tried.lock().unwrap()[0].1, "1500 0");
    let Rig { results, script, postman, .. } = rig(2100, Vec::new(), Retry::default());
    (0..2100).for_each(|at| trip(&results, at));
    work(postman, 1.0).await;
    assert_eq!(script.tried.lock().unwrap()[0].1, "2100 100");
}

#[tokio::test(start_paused = true)]
async fn what_was_gathered_when_it_stopped_is_a_letter_for_the_next() {
    let Rig { results, script, letters, postman, .. } = rig(2, Vec::new(), Retry::default());
    let pace = Pace { wait_s: 100.0, ..Pace::default() };
    let source = postman.source.clone();
    trip(&results, 0);
    work(postman.with(&[What::Raised], &Filter::default(), &pace, &Retry::default()), 1.0).await;
    assert_eq!((script.tried.lock().unwrap().len(), letters.counts()), (0, (1, 0)));
    // What happens between two postmen is the second one's.
    trip(&results, 1);
    let next = Postman::new("it", Scripted(script.clone()), source, letters.clone(), Arc::default());
    work(next, 20.0).await;
    let told: Vec<String> = script.tried.lock().unwrap().iter().map(|(_, body)| body.clone()).collect();
    assert_eq!((told, letters.counts()), (vec!["1 0".to_string(), "1 0".to_string()], (0, 0)));
}

#[tokio::test(start_paused = true)]
async fn what_happens_as_it_is_told_to_stop_is_a_letter_for_the_next() {
    // Which of two things that wait is looked at first is by chance: many postmen leave it none.
    for at in 0..64 {
        let Rig { results, letters, postman, .. } = rig(1, Vec::new(), Retry::default());
        let pace = Pace { wait_s: 100.0, ..Pace::default() };
        let postman = postman.with(&[What::Raised], &Filter::default(), &pace, &Retry::default());
        let stop = CancellationToken::new();
        let task = tokio::spawn(postman.run(stop.clone()));
        // It has begun and waits.
        tokio::time::sleep(Duration::from_secs(1)).await;
        trip(&results, 0);
        stop.cancel();
        task.await.unwrap();
        assert_eq!(letters.counts(), (1, 0), "{at}");
    }
}

#[tokio::test(start_paused = true)]
async fn what_was_gathered_when_the_power_failed_is_a_letter_for_the_next_start() {
    let Rig { results, script, postman, .. } = rig(3, Vec::new(), Retry::default());
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tmp/drafts");
    let _ = std::fs::remove_dir_all(&folder);
    let files = || std::fs::read_dir(&folder).map_or(0, |all| all.count());
    let pace = Pace { wait_s: 100.0, ..Pace::default() };
    let source = postman.source.clone();
    let begin = |letters| {
        let own = Postman::new("it", Scripted(script.clone()), source.clone(), letters, Arc::default());
        own.with(&[What::Raised], &Filter::default(), &pace, &Retry::default())
    };
    let open = || Arc::new(Letters::open(Some(folder.clone()), 5));
    let letters = open();
    let task = tokio::spawn(begin(letters.clone()).run(CancellationToken::new()));
    tokio::task::yield_now().await;
    for at in 0..2 {
        trip(&results, at);
        // Longer than between two drafts.
        tokio::time::sleep(Duration::from_secs(5)).await;
    }
    assert_eq!((files(), letters.counts()), (1, (0, 0)), "on disk, and not to be sent yet");
    task.abort();
    assert!(task.await.unwrap_err().is_cancelled());

    // The next start sends it at once; what comes then is another letter, whose draft goes with it.
    let letters = open();
    assert_eq!(letters.counts(), (1, 0));
    let task = tokio::spawn(begin(letters.clone()).run(CancellationToken::new()));
    tokio::time::sleep(Duration::from_secs(5)).await;
    trip(&results, 2);
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert_eq!(files(), 1);
    tokio::time::sleep(Duration::from_secs(100)).await;
    let told: Vec<String> = script.tried.lock().unwrap().iter().map(|(_, body)| body.clone()).collect();
    assert_eq!((told, files(), letters.counts()), (vec!["2 0".to_string(), "1 0".to_string()], 0, (0, 0)));
    task.abort();
}

#[tokio::test(start_paused = true)]
async fn what_was_picked_is_held_until_it_is_on_disk() {
    let Rig { postman, letters, script, .. } = rig(1, Vec::new(), Retry::default());
    let outlet = Outlet::default();
    let source = Source { outlet: Some(outlet.clone()), ..postman.source.clone() };
    let begin = |events: &[What], stop: &CancellationToken| {
        let own =
            Postman::new("it", Scripted(script.clone()), source.clone(), letters.clone(), Arc::default());
        let pace = Pace { wait_s: 100.0, ..Pace::default() };
        let own = own.with(events, &Filter::default(), &pace, &Retry::default());
        tokio::spawn(own.run(stop.clone()))
    };
    let stop = CancellationToken::new();
    let tasks = [begin(&[What::Raised], &stop), begin(&[What::Cleared], &stop)];
    let mut telling = outlet.tell(change());
    assert_eq!(telling.kept().now_or_never(), None, "in memory only");
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert_eq!(telling.kept().now_or_never(), Some(true), "one has a draft of it, the other nothing to tell");

    // Within a second of a draft it is not on disk yet; who stops writes what is left.
    let mut telling = outlet.tell(change());
    stop.cancel();
    assert_eq!(telling.kept().now_or_never(), None);
    for task in tasks {
        task.await.unwrap();
    }
    assert_eq!((telling.kept().now_or_never(), letters.counts()), (Some(true), (1, 0)));

    // Who dies without it says so.
    let task = begin(&[What::Raised], &CancellationToken::new());
    tokio::task::yield_now().await;
    let mut telling = outlet.tell(change());
    task.abort();
    assert!(task.await.unwrap_err().is_cancelled());
    assert_eq!(telling.kept().now_or_never(), Some(false));
}

#[tokio::test(start_paused = true)]
async fn what_cannot_be_written_is_held_until_it_is_written_or_delivered() {
    let later = || Fault::Later("not now".into(), Some(Duration::from_secs(200)));
    let Rig { postman, script, .. } = rig(1, vec![later()], Retry::default());
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tmp/letters_full");
    // A file in place of the folder: nothing can be written there.
    let fill = || {
        let _ = std::fs::remove_dir_all(&folder);
        let _ = std::fs::remove_file(&folder);
        std::fs::write(&folder, "").unwrap();
    };
    let free = || std::fs::remove_file(&folder).unwrap();
    fill();
    let letters = Arc::new(Letters::open(Some(folder.clone()), 5));
    let outlet = Outlet::default();
    let source = Source { outlet: Some(outlet.clone()), ..postman.source.clone() };
    let pace = Pace { wait_s: 100.0, interval_s: 0.0, ..Pace::default() };
    let stop = CancellationToken::new();
    let own = Postman::new("it", Scripted(script.clone()), source, letters.clone(), Arc::default());
    let task = tokio::spawn(
        own.with(&[What::Raised], &Filter::default(), &pace, &Retry::default()).run(stop.clone()),
    );
    tokio::task::yield_now().await;
    let pass = |s: u64| tokio::time::sleep(Duration::from_secs(s));

    // In no draft; then in a letter that is not taken; then there is room again.
    let mut telling = outlet.tell(change());
    pass(50).await;
    assert_eq!((telling.kept().now_or_never(), letters.counts()), (None, (0, 0)));
    pass(60).await;
    assert_eq!((telling.kept().now_or_never(), letters.counts()), (None, (1, 0)));
    free();
    pass(15).await;
    assert_eq!((telling.kept().now_or_never(), letters.counts()), (Some(true), (1, 0)));
    let again = Letters::open(Some(folder.clone()), 5);
    assert_eq!(again.counts(), (1, 0), "it is found at the next start");
    pass(300).await;
    assert_eq!(letters.counts(), (0, 0));

    // Delivered from memory.
    fill();
    let mut telling = outlet.tell(change());
    pass(50).await;
    assert_eq!(telling.kept().now_or_never(), None);
    pass(60).await;
    assert_eq!((telling.kept().now_or_never(), letters.counts()), (Some(true), (0, 0)));

    // A postman that stops while the letter is in memory only does not count it as kept.
    let mut telling = outlet.tell(change());
    pass(50).await;
    stop.cancel();
    task.await.unwrap();
    assert_eq!((telling.kept().now_or_never(), script.tried.lock().unwrap().len()), (Some(false), 3));
    free();
}

#[tokio::test(start_paused = true)]
async fn what_comes_to_light_of_before_the_start_is_not_told() {
    let before = rig(2, Vec::new(), Retry::default()).results;
    (0..2).for_each(|at| trip(&before, at));
    let old = || before.alarm_log().iter().rev().map(|change| (**change).clone()).collect();
    let Rig { results, script, postman, .. } = rig(3, Vec::new(), Retry::default());
    results.restore_alarms(Vec::new(), old());
    trip(&results, 2);
    results.restore_alarms(Vec::new(), old());
    work(postman, 1.0).await;
    let told: Vec<String> = script.tried.lock().unwrap().iter().map(|(_, body)| body.clone()).collect();
    assert_eq!((told, results.alarm_log().len()), (vec!["1 0".to_string()], 3));
}
