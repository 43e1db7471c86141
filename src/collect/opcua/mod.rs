//! OPC UA, read only: values by subscription or by reading, gaps filled from the server's history.
//!
//! `config` says what to ask; `plan` is that, checked, without I/O. `value` makes samples of data values and is
//! pure too. `link` is the only place that talks to a server; `device` keeps one session, whatever happens to it.

mod config;
mod device;
mod history;
mod link;
mod listener;
mod plan;
mod security;
mod value;

pub use config::{Config, Mode, Place, SecurityMode, SecurityPolicy, TagConfig, TimeFallback};
pub use device::Collector;
pub use history::{HistoryError, Keep, Slice, Wish, history};
pub use plan::{Deadband, Plan, Sampling, Tag, TagSpec};
