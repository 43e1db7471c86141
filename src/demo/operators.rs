//! The two persons of the demo: one grants write-back where the gate waits for nothing else, the other approves; what was
//! tripped by a machine that was busy with something else is reset. And what the screen says of it.

use crate::serve::Desk;
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
#[cfg(feature = "writeback")]
const OPERATOR: &str = "demo operator";

/// Grants and approves each sticky loop as soon as nothing else is missing: once, and again after a fault that passes by.
#[cfg(feature = "writeback")]
pub(super) async fn work(desk: Arc<dyn Desk>, loops: &[DemoLoop], stop: &CancellationToken) {
    let mut waiting: Vec<LoopId> =
        loops.iter().filter(|own| own.truth.sticky).map(|own| LoopId::new(own.id.as_str())).collect();
    let mut granted = Vec::new();
    let mut ticks = tokio::time::interval(std::time::Duration::from_millis(LOOK_MS));
    while stop.run_until_cancelled(ticks.tick()).await.is_some() {
        let before = std::mem::take(&mut granted);
        for id in std::mem::take(&mut waiting) {
            let ready = desk
                .status(&id)
                .is_some_and(|own| own.state == State::Shadow && own.denials == [Denial::NotGranted]);
            let done = ready
                && matches!(desk.act(&id, Action::Grant(GRANT_S), OPERATOR).await, Some(Ok(_)))
                && matches!(desk.act(&id, Action::Approve, "demo supervisor").await, Some(Ok(_)));
            if done { &mut granted } else { &mut waiting }.push(id);
        }
        for id in before {
            let passed = desk
                .status(&id)
                .is_some_and(|own| own.state == State::Tripped && own.tripped_by.is_some_and(passes_by));
            let reset = passed && matches!(desk.act(&id, Action::Reset, OPERATOR).await, Some(Ok(_)));
            if reset { &mut waiting } else { &mut granted }.push(id);
        }
    }
}

/// Whether a fault says nothing of the valve: answers came late, because the machine that is plant and daemon in one had too
/// much else to do.
#[cfg(feature = "writeback")]
fn passes_by(fault: Denial) -> bool {
    use Denial::{Late, ModeBad, OpBad, PollOverrun, PvBad, SpBad, WriteFailed};
    matches!(fault, OpBad | PvBad | SpBad | ModeBad | Late | PollOverrun | WriteFailed)
}

/// Nobody can act in a binary that only reads.
#[cfg(not(feature = "writeback"))]
pub(super) async fn work(_: Arc<dyn Desk>, _: &[DemoLoop], _: &CancellationToken) {}

const HEADER: &str = "loop    what it is                     write-back   term %  ISE before  ISE with    gain  travel x  turns/h  why";

/// What write-back does, a line per sticky loop; empty where there is none.
pub(super) fn lines(desk: &dyn Desk, loops: &[DemoLoop]) -> Vec<String> {
    let line = |demo: &DemoLoop| {
        let status = desk.status(&LoopId::new(demo.id.as_str()))?;
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
