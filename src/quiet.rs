//! A bound on what libraries may put into the log. Ours says a reason once; a library says it as often as a peer makes it.

use std::collections::HashMap;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tracing::{Event, Metadata, Subscriber};
use tracing_subscriber::layer::{Context, Filter};

/// Lines of one target in a window: enough to see what it is about.
pub const MOST: u64 = 10;
/// What they are counted over.
pub const WINDOW: Duration = Duration::from_secs(60);
/// How often it is looked whether there is something to tell.
const LOOK: Duration = Duration::from_secs(5);
/// Our own lines begin so.
const OWN: &str = "stictiond";

/// Lines left out since the start of the process.
static LEFT_OUT: AtomicU64 = AtomicU64::new(0);

/// Lines of libraries that were left out of the log since the start.
pub fn left_out() -> u64 {
    LEFT_OUT.load(Ordering::Relaxed)
}

/// What was said of one target in its window.
struct Said {
    since: Instant,
    lines: u64,
}

impl Said {
    fn left_out(&self) -> u64 {
        self.lines.saturating_sub(MOST)
    }
}

/// The bound, by target. Targets are names in programs, so there are no more than those.
#[derive(Clone, Default)]
pub struct Quiet {
    targets: Arc<Mutex<HashMap<&'static str, Said>>>,
}

impl Quiet {
    /// Tells from time to time, on a thread of its own, how much was left out.
    ///
    /// # Errors
    /// When there is no thread.
    pub fn tell(&self) -> io::Result<()> {
        let own = self.clone();
        let telling = move || {
            loop {
                thread::sleep(LOOK);
                for (library, lines) in own.over(Instant::now()) {
                    tracing::warn!(
                        library,
                        lines,
                        "lines of a library were left out of the log: it said more than {MOST} in a minute"
                    );
                }
            }
        };
        thread::Builder::new().name("log".into()).spawn(telling).map(drop)
    }

    /// Whether a line of a target may be written at `now`.
    fn may(&self, target: &'static str, now: Instant) -> bool {
        if target.starts_with(OWN) {
            return true;
        }
        let mut targets = self.targets.lock().unwrap_or_else(PoisonError::into_inner);
        let said = targets.entry(target).or_insert(Said { since: now, lines: 0 });
        // One that left something out is begun anew when that was told.
        if now.duration_since(said.since) >= WINDOW && said.left_out() == 0 {
            *said = Said { since: now, lines: 0 };
        }
        said.lines += 1;
        let may = said.lines <= MOST;
        if !may {
            LEFT_OUT.fetch_add(1, Ordering::Relaxed);
        }
        may
    }

    /// Targets whose window is over, with what was left out of it; they begin anew.
    fn over(&self, now: Instant) -> Vec<(&'static str, u64)> {
        let mut targets = self.targets.lock().unwrap_or_else(PoisonError::into_inner);
        let mut over = Vec::new();
        targets.retain(|target, said| {
            let ends = now.duration_since(said.since) >= WINDOW;
            if ends && said.left_out() > 0 {
                over.push((*target, said.left_out()));
            }
            !ends
        });
        over
    }
}

impl<S: Subscriber> Filter<S> for Quiet {
    fn enabled(&self, _: &Metadata<'_>, _: &Context<'_, S>) -> bool {
        true
    }

    fn event_enabled(&self, event: &Event<'_>, _: &Context<'_, S>) -> bool {
        self.may(event.metadata().target(), Instant::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use tracing_subscriber::filter::{EnvFilter, FilterExt};
    use tracing_subscriber::layer::{Layer, SubscriberExt};

    #[test]
    fn a_library_says_no_more_than_its_share_and_what_was_left_out_is_told_exactly() {
        let (quiet, begin) = (Quiet::default(), Instant::now());
        let at = |s: u64| begin + Duration::from_secs(s);
        let said = (0..50_134).filter(|_| quiet.may("opcua_core::comms", at(1))).count();
        assert_eq!(said as u64, MOST);
        assert!(quiet.may("rumqttc", at(1)), "another one is not concerned");
        assert!((0..1000).all(|_| quiet.may("stictiond::store", at(1))), "our own lines are");
        assert_eq!(quiet.over(at(60)), []);
        assert_eq!(quiet.over(at(61)), [("opcua_core::comms", 50_134 - MOST)]);
        assert_eq!(quiet.over(at(62)), []);
        // Nobody has told yet, and it goes on: it stays bounded, and nothing is forgotten.
        for _ in 0..2 * MOST {
            let _ = quiet.may("x", at(100));
        }
        assert!(!quiet.may("x", at(190)));
        assert_eq!(quiet.over(at(190)), [("x", MOST + 1)]);
        assert!(quiet.may("x", at(190)));
    }

    /// Counts the lines that reach it.
    struct Lines(Arc<Mutex<HashMap<&'static str, u64>>>);

    impl<S: Subscriber> Layer<S> for Lines {
        fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
            *self.0.lock().expect("no panic").entry(event.metadata().target()).or_default() += 1;
        }
    }

    #[test]
    fn as_a_filter_it_counts_what_is_wanted_only() {
        let lines = Arc::new(Mutex::new(HashMap::new()));
        let wanted = EnvFilter::new("info").and(Quiet::default());
        let log = tracing_subscriber::registry().with(Lines(lines.clone()).with_filter(wanted));
        let before = left_out();
        tracing::subscriber::with_default(log, || {
            for _ in 0..5000 {
                tracing::debug!(target: "library", "not wanted, so it takes no place");
            }
            for _ in 0..5000 {
                tracing::error!(target: "library", "noise");
                tracing::error!("our own");
            }
        });
        let lines = lines.lock().expect("no panic");
        assert_eq!((lines["library"], lines[module_path!()]), (MOST, 5000));
        assert!(left_out() - before >= 5000 - MOST);
    }
}
