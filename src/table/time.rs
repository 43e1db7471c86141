//! The column of times: its format is decided from the whole column, never from one cell.

mod decide;
mod reading;
mod tally;
mod turns;
mod units;
mod what;

pub use decide::Column;
pub use reading::Reading;
pub use tally::{Groups, Times};
pub use what::{What, WhatKind};
