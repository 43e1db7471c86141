//! The column of times: its format is decided from the whole column, never from one cell.

mod changes;
mod decide;
mod reading;
mod tally;
mod told;
mod turns;
mod units;
mod what;

pub use decide::{Column, few_are_missing};
pub use reading::Reading;
pub use tally::{Groups, Times};
pub use told::changes_nothing;
pub use what::{What, WhatKind};
