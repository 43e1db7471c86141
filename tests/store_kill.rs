//! The store under `kill -9`: a child process writes as fast as it can and says what was acknowledged; it is killed at a
//! random moment, and everything it said must be there, once.

use rand::{RngExt, SeedableRng};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use stictiond::signal::Sample;
use stictiond::store::{
    Batch, Config, DiagnosisRow, Reader, Row, Series, Store, TagName, TransitionRow, check, pack,
};

/// Tells the child, which is this same program, which folder to write to.
const CHILD: &str = "STICTIOND_STORE_CHILD";
const KILLS: usize = 200;
const TAGS: u32 = 20;
/// Batches between two runs that are written with them.
const RUN_EVERY: u64 = 5;

fn config(folder: &Path) -> Config {
    // Short chunks, so that rolls are under way at many of the moments.
    Config { chunk_s: 10, ..Config::new(folder) }
}

fn tag(i: u32) -> Arc<TagName> {
    Arc::new(TagName {
        control_loop: format!("L{i}"),
        tag: "op".into(),
        source: String::new(),
        unit: String::new(),
    })
}

fn sample(tag: u32, k: u64) -> Sample {
    Sample::good(k as f64, f64::from(tag) + (k % 1009) as f64 * 0.25)
}

fn batch(tags: &[Arc<TagName>], k: u64) -> Batch {
    let series =
        tags.iter().zip(0..).map(|(tag, i)| Series { tag: tag.clone(), samples: vec![sample(i, k)] });
    let mut rows = Vec::new();
    if k.is_multiple_of(RUN_EVERY) {
        let (control_loop, report) = ("L0".to_string(), pack(&format!("{{\"k\":{k}}}").repeat(50)));
        let state = |k: u64| if (k / RUN_EVERY).is_multiple_of(2) { "normal" } else { "unacknowledged" };
        rows.push(Row::Diagnosis(DiagnosisRow {
            control_loop: control_loop.clone(),
            finished: k as f64,
            report,
            ..DiagnosisRow::default()
        }));
        rows.push(Row::Transition(TransitionRow {
            control_loop,
            at: k as f64,
            before: state(k).into(),
            after: state(k + RUN_EVERY).into(),
            cause: "test".into(),
            ..TransitionRow::default()
        }));
    }
    Batch { series: series.collect(), rows }
}

/// The newest batch in the store.
fn newest(folder: &Path) -> Option<u64> {
    let mut reader = Reader::open(folder).expect("opens");
    let start = reader.previous_start(i64::MAX).expect("reads")?;
    let chunk = reader.chunk(start, None).expect("reads");
    chunk.values().flatten().map(|sample| sample.t as u64).max()
}

/// In the child: goes on from what is there, and never ends by itself.
#[test]
fn child() {
    let Some(folder) = std::env::var_os(CHILD).map(PathBuf::from) else { return };
    let mut store = Store::open(&config(&folder)).expect("the store opens after every kill");
    let tags: Vec<_> = (0..TAGS).map(tag).collect();
    let mut out = std::io::stdout();
    for k in newest(&folder).map_or(0, |last| last + 1).. {
        store.write(&batch(&tags, k)).expect("writes");
        // The parent may be about to kill; then nobody reads this.
        let _ = writeln!(out, "ack {k}").and_then(|()| out.flush());
        // What was written before is written again, as after a failure whose outcome nobody knows.
        if k % 7 == 3 {
            store.write(&batch(&tags, k - 1)).expect("writes again");
        }
        store.tidy(k as f64).expect("tidies");
    }
}

/// Runs the child until `after` its first acknowledgement; the last one it gave.
fn run_and_kill(folder: &Path, after: Duration) -> u64 {
    let mut child = Command::new(std::env::current_exe().expect("this program"))
        .args(["child", "--exact", "--nocapture", "--test-threads=1"])
        .env(CHILD, folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()
        .expect("this program runs");
    let mut lines = BufReader::new(child.stdout.take().expect("piped"));
    let mut acked = None;
    let mut read = |acked: &mut Option<u64>| {
        let mut line = String::new();
        let more = lines.read_line(&mut line).is_ok_and(|read| read > 0);
        // A line cut short was no acknowledgement.
        if let Some(k) = line.strip_suffix('\n').and_then(|l| l.split("ack ").nth(1)?.parse().ok()) {
            *acked = Some(k);
        }
        more
    };
    while acked.is_none() && read(&mut acked) {}
    let begun = Instant::now();
    std::thread::sleep(after);
    child.kill().expect("SIGKILL");
    child.wait().expect("it is gone");
    while read(&mut acked) {}
    acked.unwrap_or_else(|| panic!("the child gave no acknowledgement in {:?}", begun.elapsed()))
}

/// Batches `from..=to` are there, as they were written.
fn all_there(folder: &Path, from: u64, to: u64) {
    let mut reader = Reader::open(folder).expect("opens");
    let mut next = vec![from; TAGS as usize];
    let mut start = stictiond::store::first_start(from as f64);
    while let Some(at) = reader.next_start(start).expect("reads") {
        for (tag, samples) in reader.chunk(at, None).expect("reads") {
            for s in samples.iter().filter(|s| s.t >= from as f64) {
                let next = &mut next[tag as usize - 1];
                assert_eq!(*s, sample(tag - 1, *next), "tag {tag}: a sample is missing, wrong or twice");
                *next += 1;
            }
        }
        start = at + 1;
    }
    assert_eq!(reader.damaged(), 0);
    assert!(next.iter().all(|next| *next > to), "acknowledged up to {to}, there up to {next:?}");
    assert!(next.iter().all(|n| *n == next[0]), "half a batch: {next:?}");
}

#[test]
fn everything_acknowledged_survives_200_kills_at_random_moments_and_nothing_is_twice() {
    if std::env::var_os(CHILD).is_some() {
        return;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("store-kill-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    let mut random = rand_pcg::Pcg64::seed_from_u64(5);
    let mut acked = 0;
    for _ in 0..KILLS {
        let before = acked;
        acked = run_and_kill(&folder, Duration::from_micros(random.random_range(0..40_000)));
        assert!(acked >= before, "batch {before} was acknowledged, and the next child began before it");
        all_there(&folder, before, acked);
    }
    all_there(&folder, 0, acked);
    // Row by row, as they lie on disk: readers would hide a sample that is there twice.
    drop(Store::open(&config(&folder)).expect("opens"));
    let last = newest(&folder).expect("not empty");
    let mut store = Store::open(&config(&folder)).expect("opens");
    store.tidy(last as f64 + 1000.0).expect("rolls what is open");
    drop(store);
    let checked = check(&folder).expect("can be read");
    assert_eq!(checked.faults, [""; 0]);
    let runs = last / RUN_EVERY + 1;
    assert_eq!(
        (checked.samples, checked.diagnoses, checked.transitions),
        ((last + 1) * u64::from(TAGS), runs, runs)
    );
    println!("{KILLS} kills, {} batches acknowledged, {} samples", acked + 1, checked.samples);
    std::fs::remove_dir_all(&folder).expect("can be removed");
}
