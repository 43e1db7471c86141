//! Many machines as one, over NATS JetStream: what they say to each other, and the only code that talks to NATS. Its client
//! reaches a server through a relay of ours, which bounds what the server may say.
//!
//! ```text
//! edge    --alarms, states, diagnoses, samples, hello-->  streams  -->  centre
//! edge    --window-->  work queue  -->  worker  --answer-->  edge
//! centre  --action-->  stream  -->  edge
//! ```
//! An *edge* collects at a site, keeps everything in its own store, and forwards it from there.
//! A *worker* diagnoses windows for others.
//! A *centre* shows all sites, tells people, and passes on what they do about alarms.
//!
//! # What is guaranteed
//! - The edge is the only writer of what it measured and of its alarms, so nothing has to be merged.
//! - What was forwarded is known from the streams themselves: an edge goes on behind the last message of each loop, and behind a
//!   cursor that names a message which has to be there.
//! - A message is sent again until it is acknowledged; its id is a digest of its bytes, so the stream keeps it once.
//! - The list of an edge's loops comes in parts, and is taken whole or not at all.
//! - Write-back never crosses the fleet: there is no message for it.

pub mod announcement;
pub mod config;
pub mod convert;
mod digest;
pub mod lease;
pub mod link;
mod login;
pub mod message;
pub mod ops;
mod relay;
pub mod streams;
pub mod subject;
pub mod weights;

pub use config::Config;
