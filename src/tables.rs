//! The reader of `stictiond`'s tables: it makes samples of what plants send as files.
//!
//! A package of its own, so that none of it can reach a runtime, a log or a protocol, and so that it is optimised where it is
//! tested. It uses of std what the numerics use, and opens files to read them; `tests/architecture.rs` checks that.

use stictiond_numerics::signal;

pub mod table;
