//! Workbooks are archives: the fuzzer changes what is inside, and the archive is made around it.

#[path = "../../../tests/exports/archive.rs"]
mod stored;

pub use stored::{Part, archive, of_parts};
