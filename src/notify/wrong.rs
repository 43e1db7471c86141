//! What is wrong with a receiver's settings, for who points at the place in the file.

/// What is wrong: the table, empty for the receiver's own, the field, and why.
pub type Wrong = (&'static str, &'static str, String);
