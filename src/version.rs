//! Which program this is.

/// The version of the package, and behind a `+` the identity of the build: a digest of the library's sources, of its dependencies,
/// of the compiler and of the target, which `build.rs` makes.
///
/// Who compares what two programs find compares this: two builds of one version may find something else in the same samples.
pub const BUILD: &str = concat!(env!("CARGO_PKG_VERSION"), "+", env!("STICTIOND_BUILD"));
