//! What the API asks of parts that it does not know: `app` gives it something that answers to each.

mod backfill;
mod fleet;
mod notifications;
mod plantwide;
mod writeback;

pub use backfill::{
    BackfillFile, BackfillPhase, BackfillPort, BackfillRefusal, BackfillRequest, BackfillRun,
};
pub use fleet::{FleetLoad, FleetPort, FleetSeen, Machine, Standby};
pub use notifications::{DeadLetter, NotificationPort, ReceiverState};
pub use plantwide::{CauseSeen, GroupSeen, Health, LoopLook, Overview, PlantwidePort, Standing, WorkLine};
#[cfg(feature = "writeback")]
pub use writeback::Acted;
pub use writeback::WritebackPort;
