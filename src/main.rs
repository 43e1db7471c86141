//! The thin binary: arguments, tracing, `App::build`, run until a signal.
fn main() {}
