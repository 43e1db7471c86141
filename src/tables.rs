//! The reader of `stictiond`'s tables: it makes samples of what plants send as files.
//!
//! It is a package of its own, so that it cannot use a runtime, a log or a protocol, and so that it is optimised in test builds. Of
//! std it uses what the numerics use, and it opens files to read them; `tests/architecture.rs` checks that.

use stictiond_numerics::signal;

pub mod table;
