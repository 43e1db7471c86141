//! OPC UA, read only: values by subscription or by reading, gaps filled from the server's history.
//!
//! `config` says what to ask; `plan` is that, checked, without I/O. `names` tells which node a name means in a session and
//! `value` makes samples of data values: both are pure. `pins` has what the numbers of namespaces meant at first. `link` is the only
//! place that talks to a server; `device` keeps one session, whatever happens to it.

mod config;
mod device;
mod history;
mod link;
mod listener;
mod names;
mod pins;
mod plan;
mod probe;
mod security;
mod value;

pub use config::{Config, Mode, Place, SecurityMode, SecurityPolicy, TagConfig, TimeFallback};
pub use device::Collector;
pub use history::{HistoryError, Keep, Slice, Wish, history};
pub use names::{Namespace, NodeName, PathName};
pub use pins::Pinned;
pub use plan::{Deadband, Plan, Sampling, Tag, TagSpec};
pub use probe::{Probed, Seen, probe};
