//! The two persons of the demo: one grants write-back where the gate waits for nothing else and resets it after a pause of
//! the computer, the other approves. And what the screen says of it.

use crate::serve::WritebackPort;
use crate::signal::LoopId;
use crate::sim::DemoLoop;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

#[cfg(feature = "writeback")]
use crate::compensation::gate::{Action, Denial, State};

/// How often they look (ms).
#[cfg(feature = "writeback")]
const LOOK_MS: u64 = 200;
/// How long a grant lasts (s of plant time).
#[cfg(feature = "writeback")]
const GRANT_S: f64 = 36_000.0;

/// What trips a loop when the computer pauses although the plant waits for it: an answer is late on the wall all the same.
#[cfg(feature = "writeback")]
const PAUSED: &[Denial] = &[
    Denial::Late,
    Denial::ClockJump,
    Denial::OpBad,
    Denial::PvBad,
    Denial::SpBad,
    Denial::ModeBad,
    Denial::PollOverrun,
    Denial::WriteFailed,
    Denial::NotAtZero,
];

/// Grants and approves each sticky loop as soon as nothing else is missing: once, and again after each pause of the computer.
#[cfg(feature = "writeback")]
pub(super) async fn work(writeback: Arc<dyn WritebackPort>, loops: &[DemoLoop], stop: &CancellationToken) {
    let mut sticky: Vec<(LoopId, bool)> = loops
        .iter()
        .filter(|own| own.truth.sticky)
        .map(|own| (LoopId::new(own.id.as_str()), false))
        .collect();
    let mut ticks = tokio::time::interval(std::time::Duration::from_millis(LOOK_MS));
    while stop.run_until_cancelled(ticks.tick()).await.is_some() {
        for (id, granted) in &mut sticky {
            let Some(own) = writeback.status(id) else { continue };
            if own.state == State::Tripped && own.tripped_by.is_some_and(|by| PAUSED.contains(&by)) {
                let reset = writeback.act(id, Action::Reset, "demo operator").await;
                *granted = !matches!(reset, Some(Ok(_)));
            } else if !*granted && own.state == State::Shadow && own.denials == [Denial::NotGranted] {
                *granted =
                    matches!(writeback.act(id, Action::Grant(GRANT_S), "demo operator").await, Some(Ok(_)))
                        && matches!(writeback.act(id, Action::Approve, "demo supervisor").await, Some(Ok(_)));
            }
        }
    }
}

/// Nobody can act in a binary that only reads.
#[cfg(not(feature = "writeback"))]
pub(super) async fn work(_: Arc<dyn WritebackPort>, _: &[DemoLoop], _: &CancellationToken) {}

const HEADER: &str = "loop    what it is                     write-back   term %  ISE before  ISE with    gain  travel x  turns/h  why";

/// What write-back does, a line per sticky loop; empty where there is none.
pub(super) fn lines(writeback: &dyn WritebackPort, loops: &[DemoLoop]) -> Vec<String> {
    let line = |demo: &DemoLoop| {
        let status = writeback.status(&LoopId::new(demo.id.as_str()))?;
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let (before, with) = (status.before, status.with);
        let both = before.zip(with);
        let why = status.tripped_by.or(status.denials.first().copied()).map_or("", |denial| denial.code());
        Some(format!(
            "{:7} {:30} {:11} {:>7}  {:>10}  {:>8}  {:>6}  {:>8}  {:>7}  {why}",
            demo.id,
            format!("{}, {}", demo.class.as_str(), demo.truth.kind),
            status.state.as_str(),
            number(Some(status.term), 2),
            number(before.map(|m| m.ise), 1),
            number(with.map(|m| m.ise), 1),
            number(both.map(|(before, with)| before.ise / with.ise), 1),
            number(both.map(|(before, with)| with.travel / before.travel), 1),
            number(with.map(|m| 3600.0 * m.reversals as f64 / m.length_s), 0),
        ))
    };
    let lines: Vec<String> = loops.iter().filter_map(line).collect();
    if lines.is_empty() { lines } else { [vec![String::new(), HEADER.to_owned()], lines].concat() }
}
