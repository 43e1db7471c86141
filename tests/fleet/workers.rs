//! What a worker says of a window: to the last bit what is said without a fleet, once, and of no loop that may be written to.

use crate::rig::{Fleet, PATIENCE, connected};
use futures::StreamExt;
use prost::Message;
use std::collections::HashMap;
use std::sync::Arc;
use stictiond::app::App;
use stictiond::diagnosis::Settings;
use stictiond::fleet::convert::block;
use stictiond::fleet::link::{Hearing, Link, Outgoing, digest};
use stictiond::fleet::message::{Answer, Window};
use stictiond::fleet::streams::WINDOWS;
use stictiond::fleet::subject::{Subject, What, all};
use stictiond::residual::Structure;
use stictiond::results::{Basis, Outcome, Run, Trigger, basis};
use stictiond::serve::dto::{BasisText, Report};
use stictiond::signal::{LoopId, Record, Sample};
use stictiond::sim::{DemoLoop, Recording, demo_plant, plant::record};
use stictiond::store::unpack;
use stictiond::version::BUILD;

const SITE: &str = "north";
/// 2026-01-01T00:00:00Z.
const START: f64 = 1_767_225_600.0;

/// A loop's samples as they are polled: 1,000, a while after its start.
fn polled(demo: &DemoLoop) -> Record {
    let run = record(&demo.spec, 2000, demo.seed, Recording::Sample { every: 4 }).expect("sound").after(1000);
    let series = |values: &[f64]| {
        let samples = run.t.iter().zip(values);
        samples.map(|(&t, &value)| Sample::good(t, value)).collect()
    };
    let mode = vec![f64::from(u8::from(demo.in_automatic())); run.t.len()];
    Record {
        op: series(&run.op),
        pv: series(&run.pv),
        sp: Some(series(&run.sp)),
        mode: Some(series(&mode)),
        op_limits: Some((0.0, 100.0)),
        op_span: Some(100.0),
        ..Record::default()
    }
}

/// Something to be diagnosed.
struct Job {
    id: LoopId,
    record: Record,
    basis: Basis,
}

impl Job {
    fn new(id: &str, record: Record, known: Option<Structure>) -> Self {
        let basis = Basis::of(&record, &Settings::default(), known);
        Self { id: LoopId::new(id), record, basis }
    }

    /// As an edge of the worker's build asks for it.
    fn message(&self) -> Outgoing {
        self.of_version(BUILD)
    }

    /// As an edge of this version asks for it.
    fn of_version(&self, version: &str) -> Outgoing {
        let tags = basis::series(&self.record).map(|(tag, samples)| block(tag, "", samples)).collect();
        let window = Window {
            control_loop: self.id.to_string(),
            basis: BasisText::text(&self.basis).expect("it can be written"),
            tags,
            started: START,
            on_demand: false,
            answer_within_s: 600.0,
            version: version.to_string(),
        };
        let subject = Subject::new(SITE, self.id.as_str(), What::Window).to_string();
        Outgoing::once(subject, window.encode_to_vec())
    }

    /// What its answer names.
    fn key(&self) -> Vec<u8> {
        let Outgoing { subject, body, .. } = self.message();
        digest(&subject, &body).to_vec()
    }

    /// What is said of it without a fleet.
    fn here(&self) -> Run {
        let Self { id, record, basis } = self;
        let judged = App::diagnosis()(record, &basis.settings, basis.structure.as_ref());
        Run {
            id: id.clone(),
            started: START,
            finished: START,
            took_s: 0.0,
            trigger: Trigger::Periodic,
            op_span: record.op_span,
            basis: Some(Arc::new(basis.clone())),
            outcome: Outcome::Diagnosed(Box::new(judged)),
        }
    }
}

async fn send(link: &Link, message: Outgoing) {
    link.send(&[message]).await.map_err(|(_, error)| error).expect("it is kept");
}

async fn next(answers: &mut Hearing) -> Answer {
    let message = tokio::time::timeout(PATIENCE, answers.next()).await.expect("somebody answers");
    Answer::decode(&message.expect("it is connected").payload[..]).expect("ours")
}

/// Has a worker diagnose the jobs, and demands that it says of each what is said here.
async fn is_same(link: &Link, answers: &mut Hearing, jobs: &[Job]) -> Vec<Run> {
    for job in jobs {
        send(link, job.message()).await;
    }
    // The worker is at it meanwhile.
    let runs: Vec<Run> = jobs.iter().map(Job::here).collect();
    let mut said = HashMap::new();
    while said.len() < jobs.len() {
        let answer = next(answers).await;
        said.insert(answer.window.clone(), answer);
    }
    for (job, run) in jobs.iter().zip(&runs) {
        let answer = said.get(&job.key()).expect("each is answered");
        let told = answer.run.as_ref().expect("it could be read");
        let theirs = told.report.as_deref().and_then(unpack).expect("a report");
        let ours = Report::text(run).expect("a report");
        assert!(theirs == ours, "{}: {:?}", run.id, Report::differences(&theirs, &ours));
        let theirs: Vec<_> = told.effects.iter().map(|own| (own.kind.clone(), own.tag.clone())).collect();
        let ours = run.effects().expect("diagnosed").into_iter();
        let ours: Vec<_> = ours.map(|(kind, tag)| (kind.to_string(), tag)).collect();
        assert_eq!((theirs, told.unexplained), (ours, run.unexplained()), "{}", run.id);
        assert_eq!((answer.worker.as_str(), &told.outcome[..]), ("w1", run.outcome.as_str()), "{}", run.id);
    }
    runs
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_worker_says_is_to_the_last_bit_what_is_said_without_a_fleet() {
    let fleet = Fleet::sized("workers", 1, 1);
    let link = connected(&fleet.hub, "").await;
    let mut answers = link.hear(all(Some(SITE), What::Answer)).await.expect("it can be heard");
    let worker = fleet.worker("w1");
    // The demo's test without sockets asks for the right verdicts of other seeds.
    let plant = demo_plant(2);
    let jobs: Vec<Job> = plant.iter().map(|demo| Job::new(&demo.id, polled(demo), None)).collect();
    let runs = is_same(&link, &mut answers, &jobs).await;
    for (demo, run) in plant.iter().zip(&runs) {
        assert_eq!(run.outcome.as_str(), demo.expected.as_str(), "{}", demo.id);
    }
    // What was found goes with the next window.
    let again = jobs.into_iter().zip(&runs).filter_map(|(job, run)| {
        let known = run.judged()?.structure()?.clone();
        Some(Job::new(job.id.as_str(), job.record, Some(known)))
    });
    let again: Vec<Job> = again.collect();
    assert!(again.len() >= 5, "{} have a model", again.len());
    // Every second is enough: the same is demanded of each.
    let some: Vec<Job> = again.into_iter().step_by(2).collect();
    is_same(&link, &mut answers, &some).await;
    drop(worker);
    std::fs::remove_dir_all(&fleet.folder).expect("writable");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_window_that_is_sent_again_is_answered_once() {
    let fleet = Fleet::sized("again", 1, 1);
    let link = connected(&fleet.hub, "").await;
    let mut answers = link.hear(all(Some(SITE), What::Answer)).await.expect("it can be heard");
    // One at a time, so that what is sent later is answered later.
    let worker = fleet.worker_of("w1", 1);
    let record = polled(&demo_plant(2)[0]);
    let (one, other) = (Job::new("A", record.clone(), None), Job::new("B", record, None));
    // Twice while it waits, and once more when it is answered.
    send(&link, one.message()).await;
    send(&link, one.message()).await;
    assert_eq!(next(&mut answers).await.window, one.key());
    send(&link, one.message()).await;
    send(&link, other.message()).await;
    assert_eq!(next(&mut answers).await.window, other.key(), "it was answered again");
    // Another version may say something else of the same window.
    send(&link, other.of_version("9.9.9")).await;
    let Answer { run, refused, .. } = next(&mut answers).await;
    assert!(run.is_none() && refused.as_ref().is_some_and(|why| why.contains("9.9.9")), "{refused:?}");
    // And so may another build of one version.
    let build = concat!(env!("CARGO_PKG_VERSION"), "+0");
    send(&link, other.of_version(build)).await;
    let Answer { run, refused, .. } = next(&mut answers).await;
    assert!(run.is_none() && refused.as_ref().is_some_and(|why| why.contains(build)), "{refused:?}");
    drop(worker);
    // What is answered is no longer asked for.
    let left = link.last(WINDOWS, &one.message().subject).await.expect("the server is there");
    assert_eq!(left, None);
    std::fs::remove_dir_all(&fleet.folder).expect("writable");
}

/// Write-back takes nobody else's diagnosis for evidence.
#[cfg(feature = "writeback")]
#[tokio::test(flavor = "multi_thread")]
async fn no_worker_is_asked_for_a_loop_that_may_be_written_to() {
    use crate::rig::{LOOPS, times, until_none};
    use crate::webhook;
    use crate::wire::Wire;
    use std::collections::BTreeSet;
    use stictiond::demo::{Demo, Options, WRITEBACK_SPEED};

    let mut fleet = Fleet::sized("kept", 1, 1);
    // Without samples a diagnosis takes no time, and every loop has to be diagnosed twice.
    fleet.period_s = 3;
    let _link = connected(&fleet.hub, "").await;
    let wire = Wire::at(&fleet.hub).await;
    let worker = fleet.worker("w1");
    // The plant does not run: a loop without samples is diagnosed, too.
    let options = Options { speed: WRITEBACK_SPEED, writeback: true, ..crate::options(1) };
    let demo = Demo::build(&options).await.expect("builds");
    let sticky = demo.loops().iter().filter(|own| own.truth.sticky);
    let kept: BTreeSet<String> = sticky.map(|own| own.id.clone()).collect();
    let (receiver, _told) = webhook::receiver();
    let edge = fleet.edge(SITE, &demo, receiver);
    let done = tokio::task::spawn_blocking(move || {
        until_none("a worker is asked for every other loop", PATIENCE, || {
            let left = LOOPS - kept.len() - wire.asked(SITE).difference(&kept).count();
            if left == 0 { Vec::new() } else { vec![left] }
        });
        // The line was there: the others are diagnosed once more.
        let before = times(&edge);
        until_none("every loop is diagnosed again", PATIENCE, || {
            let left =
                times(&edge).into_iter().filter(|(id, time)| before.get(id).is_none_or(|then| then == time));
            left.collect::<Vec<(String, f64)>>()
        });
        let asked = wire.asked(SITE);
        assert!(asked.is_disjoint(&kept), "{asked:?}, and not {kept:?}");
        drop((edge, worker));
        std::fs::remove_dir_all(&fleet.folder).expect("writable");
    });
    done.await.expect("all is well");
}
