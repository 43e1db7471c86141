//! What the API asks of parts that it does not know: `app` gives it something that answers to each.

mod backfill;
mod fleet;
mod notifications;
mod plantwide;
mod writeback;

pub use backfill::{
    BackfillFile, BackfillPhase, BackfillPort, BackfillRefusal, BackfillRequest, BackfillRun,
};
pub use fleet::{FleetPort, FleetSeen, Machine};
pub use notifications::{DeadLetter, NotificationPort, ReceiverState};
pub use plantwide::{GroupSeen, Health, Overview, PlantwidePort, WorkLine};
#[cfg(feature = "writeback")]
pub use writeback::Acted;
pub use writeback::WritebackPort;
