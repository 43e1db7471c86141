//! The generators of simulated loops: the same case gives the same record, and what a case asks for is in it.

#[path = "generators/mod.rs"]
mod generators;
