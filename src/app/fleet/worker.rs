//! A worker: takes windows one by one as it has a free slot, diagnoses them, and answers. It keeps nothing. A window whose
//! worker falls silent is given to another.

use super::{Fleet, PAUSE, window};
use crate::app::App;
use crate::fleet::link::{Incoming, Link, digest};
use crate::fleet::message::{Answer, Window};
use crate::fleet::ops::LOG;
use crate::fleet::streams::WINDOWS;
use crate::fleet::subject::{Subject, What, all};
use crate::fleet::weights;
use crate::results::{Outcome, Run, Trigger};
use crate::schedule::Diagnose;
use crate::signal::LoopId;
use prost::Message;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};
use tokio::sync::Semaphore;

/// All workers read as one, so that each window goes to one of them.
const WORKERS: &str = "workers";
/// A window whose worker has said nothing for longer goes to another.
const SILENCE: Duration = Duration::from_secs(15);
/// How often a worker says that it is still at work on a window.
const STILL: Duration = Duration::from_secs(5);
/// Workers that one window may take down.
const ATTEMPTS: i64 = 3;
/// Longest wait for a window, before it is asked again whether there is one.
const WAIT: Duration = Duration::from_secs(5);

impl Fleet {
    pub(super) async fn worker(self: &Arc<Self>, link: &Link, app: &App) {
        let slots = self.scene.borrow().config.schedule.parallelism.max(1);
        let (free, stop) = (Arc::new(Semaphore::new(slots)), app.stop.clone());
        while !stop.is_cancelled() {
            let reading = link.share(WINDOWS, WORKERS, &all(None, What::Window), (SILENCE, ATTEMPTS)).await;
            let mut reading = match reading {
                Ok(reading) => reading,
                Err(error) => {
                    stop.run_until_cancelled(self.rest(&error, "there are no windows to be had")).await;
                    continue;
                }
            };
            let taking = async {
                loop {
                    // A slot first: what is taken is begun at once.
                    let Ok(slot) = free.clone().acquire_owned().await else { return };
                    match reading.next(1, WAIT).await {
                        Ok(windows) => {
                            if let Some(incoming) = windows.into_iter().next() {
                                let (own, link, diagnose) =
                                    (self.clone(), link.clone(), app.diagnose.clone());
                                tokio::spawn(async move {
                                    own.work(&link, incoming, diagnose).await;
                                    drop(slot);
                                });
                            }
                        }
                        Err(error) => return self.rest(&error, "there are no windows to be had").await,
                    }
                }
            };
            stop.run_until_cancelled(taking).await;
        }
    }

    /// How long a window has waited that its stream took at `taken` (s): by the server's clock, because ours may be wrong, and a
    /// worker that takes all windows for old ones would take them away from those that answer.
    fn waited(&self, taken: f64) -> f64 {
        self.hear_server(taken);
        self.server_now() - taken
    }

    /// Diagnoses one window and answers.
    async fn work(&self, link: &Link, incoming: Incoming, diagnose: Diagnose) {
        let subject = incoming.subject().to_string();
        let window = weights::read::<Window>(&subject, incoming.bytes());
        let Some((own, window)) = Subject::read(&subject).zip(window) else {
            tracing::debug!(subject, "what waits for a worker is no window");
            let _ = incoming.done().await;
            return;
        };
        let waited = incoming.taken_at().map_or(0.0, |taken| self.waited(taken));
        if waited > window.answer_within_s {
            // Who asked has diagnosed it by now. If we are wrong, another worker may still answer.
            tracing::warn!(target: LOG, subject, waited_s = waited, "a window has waited for too long, so it is left to others");
            return incoming.again(PAUSE).await;
        }
        if !window::is_of_this_build(&window) && incoming.times_given() < ATTEMPTS {
            // It is refused at once, so a worker of another build is always free: another may be of the right one.
            return incoming.again(PAUSE).await;
        }
        let (id, began) = (LoopId::new(window.control_loop.as_str()), Instant::now());
        let deadline_s = self.scene.borrow().config.schedule.deadline_s;
        let deadline = tokio::time::sleep(Duration::from_secs_f64(deadline_s));
        tokio::pin!(deadline);
        let mut work = tokio::task::spawn_blocking(move || run(id, &window, &diagnose));
        let made = loop {
            tokio::select! {
                made = &mut work => break made.unwrap_or_else(|_| Err("it was broken off".to_string())),
                () = &mut deadline => break Err(format!("not done within {deadline_s} s")),
                () = tokio::time::sleep(STILL) => incoming.under_way().await,
            }
        };
        let (run, refused) = match made {
            Ok(run) => (Some(window::message(&run)), None),
            Err(why) => (None, Some(why)),
        };
        // A run that failed is no diagnosis.
        let diagnosed = run.as_ref().is_some_and(|run| run.report.is_some());
        let answer = Answer {
            window: digest(&subject, incoming.body()).to_vec(),
            worker: self.name.clone(),
            run,
            refused,
        };
        let to = Subject::new(&own.site, &own.name, What::Answer).to_string();
        if let Err(error) = link.tell(to, answer.encode_to_vec()).await {
            tracing::warn!(%error, control_loop = own.name, "an answer is lost; another worker is asked");
            return incoming.again(PAUSE).await;
        }
        self.diagnosed.fetch_add(u64::from(diagnosed), Relaxed);
        tracing::debug!(
            site = own.site,
            control_loop = own.name,
            took_s = began.elapsed().as_secs_f64(),
            "answered"
        );
        if let Err(error) = incoming.done().await {
            tracing::warn!(%error, "a window that is answered may be given to another worker");
        }
        if !work.is_finished() {
            // It cannot be interrupted: the slot is busy until it returns.
            let _ = work.await;
        }
    }
}

/// Diagnoses a window as a scheduler would.
fn run(id: LoopId, window: &Window, diagnose: &Diagnose) -> Result<Run, String> {
    let (basis, record) = window::read(window)?;
    let began = Instant::now();
    let judged = || diagnose(&record, &basis.settings, basis.structure.as_ref());
    let judged = catch_unwind(AssertUnwindSafe(judged));
    let outcome = match judged {
        Ok(judged) => Outcome::Diagnosed(Box::new(judged)),
        Err(_) => {
            tracing::error!(control_loop = %id, "a diagnosis panicked");
            Outcome::Panicked("a worker's diagnosis panicked".to_string())
        }
    };
    let took_s = began.elapsed().as_secs_f64();
    Ok(Run {
        id,
        started: window.started,
        // By the clock of who asked.
        finished: window.started + took_s,
        took_s,
        trigger: if window.on_demand { Trigger::OnDemand } else { Trigger::Periodic },
        op_span: basis.op_span,
        basis: Some(Arc::new(basis)),
        outcome,
    })
}

#[cfg(test)]
mod tests {
    use crate::app::fleet::tests::centre;

    #[test]
    fn a_clock_that_is_wrong_makes_no_window_old() {
        let (fleet, _results) = centre("north:FIC1");
        for off_s in [-86_400.0, 0.0, 120.0, 3600.0] {
            let server = fleet.clock.now() + off_s;
            // Of another server.
            *crate::app::fleet::lock(&fleet.server) = Default::default();
            let waited = fleet.waited(server);
            assert!((-1e-3..1.0).contains(&waited), "{waited} s at {off_s}");
            let waited = fleet.waited(server - 90.0);
            assert!((90.0..100.0).contains(&waited), "{waited} s at {off_s}");
        }
    }
}
