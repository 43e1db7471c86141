//! What the API may know of the fleet that this machine is a part of.

/// A machine of the fleet, as it says of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Machine {
    /// `edge`, `worker` or `centre`.
    pub role: String,
    /// The site of an edge; empty for others.
    pub site: String,
    /// What it is called.
    pub name: String,
    /// Version of its program.
    pub version: String,
    /// When it said so (s), by the clock of who was asked, whatever that is off the NATS server's.
    pub heard_at: f64,
    /// How far its clock is ahead of that server's (s).
    pub clock_offset_s: f64,
    /// Since when it runs (s).
    pub since: f64,
    /// Age of the oldest that waits to be forwarded, or to be taken (s).
    pub lag_s: f64,
    /// Diagnoses that it made, or a centre took.
    pub diagnosed: u64,
    /// Loops that it has.
    pub loops: u64,
    /// The certificate of it that ends first, and when (s).
    pub certificate: Option<(String, f64)>,
}

/// The fleet as this machine sees it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FleetSeen {
    /// What this machine is.
    pub role: &'static str,
    /// What it is called.
    pub name: String,
    /// Whether it reaches NATS.
    pub connected: bool,
    /// Whether it is the one that tells people now.
    pub tells: bool,
    /// Every machine that was heard of, by role, site and name.
    pub machines: Vec<Machine>,
}

/// A centre that does not lead.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Standby {
    /// What the centre is called that leads, where one is known.
    pub leader: Option<String>,
}

/// What waits in the fleet, as far as this machine knows, for metrics.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FleetLoad {
    /// This machine, as it says of itself.
    pub own: Machine,
    /// Windows that wait for a worker: those of an edge, or at a centre those of all edges; `None` where that is not known.
    pub windows: Option<u64>,
    /// Each stream, and how much of its room it takes (0..1); none but at a centre that reaches the server.
    pub streams: Vec<(&'static str, f64)>,
}

/// Answers for the fleet.
pub trait FleetPort: Send + Sync {
    /// The fleet as it is seen now.
    fn seen(&self) -> FleetSeen;

    /// Whether people cannot act here, because this is a centre that does not lead.
    fn standby(&self) -> Option<Standby> {
        None
    }

    /// What waits now.
    fn load(&self) -> FleetLoad {
        FleetLoad::default()
    }

    /// Messages of others that were of no use, or would have taken too much.
    fn refused(&self) -> u64 {
        0
    }

    /// Messages of loops that no edge has announced, or that are another edge's, which were left out.
    fn left_out(&self) -> u64 {
        0
    }
}
