//! Telling others what was found. It only speaks: nothing here listens to a plant or writes to one.
//!
//! ```text
//!            event             notices          letters
//! results ---------> source ----------> batch ----------> webhook, smtp    what happened: grouped, at a bounded rate, tried
//!            |                                  |                          again for a bounded time, then a dead letter
//!            |                                  +-> dead letters -> replay
//!            +------> all alarms as they stand ---------> alertmanager     what stands: sent again until it is over
//!            +------> the latest of each loop ----------> mqtt
//! ```
//! A receiver that is dead costs a bounded number of notices and letters, and stops nobody.

pub mod alertmanager;
mod batch;
mod config;
mod filter;
mod http;
mod letters;
pub mod mqtt;
mod notice;
mod outlet;
mod payload;
mod postman;
mod secret;
pub mod smtp;
mod state;
mod time;
pub mod webhook;
mod wrong;

pub use batch::Pace;
pub use config::Config;
pub use filter::{Filter, What};
pub use letters::{Letter, Letters};
pub use notice::{Places, Source};
pub use outlet::{Outlet, Telling};

#[cfg(test)]
pub(crate) use notice::tests::change;
pub use postman::{Carrier, Fault, Postman, Retry};
pub use state::{Snapshot, State};
pub use wrong::Wrong;
