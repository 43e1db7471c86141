//! What the API may know of those who are told of alarms, and what an engineer may ask of what never reached them.

/// How one receiver is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReceiverState {
    /// Its name.
    pub name: String,
    /// `webhook`, `alertmanager`, `smtp` or `mqtt`.
    pub kind: &'static str,
    /// Why the last attempt failed and since when they do (s); `None` while it takes what it is sent.
    pub failing: Option<(String, f64)>,
    /// When it last took something (s).
    pub sent_at: Option<f64>,
    /// Messages that it took.
    pub sent: u64,
    /// Attempts that failed.
    pub failed: u64,
    /// Changes that were counted in a message instead of told one by one, or not told.
    pub dropped: u64,
    /// What waits.
    pub queue: u64,
    /// Messages that never arrived.
    pub dead_letters: u64,
}

/// A message that never arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct DeadLetter {
    /// Its name.
    pub id: String,
    /// When it was made (s).
    pub made: f64,
    /// Since when it is dead (s).
    pub dead_since: Option<f64>,
    /// Attempts that failed.
    pub attempts: u32,
    /// Why the last one did.
    pub why: String,
    /// What it says.
    pub body: String,
}

/// Where receivers are asked after. The two that may write files do not belong on an async thread.
pub trait NotificationPort: Send + Sync {
    /// All of them.
    fn receivers(&self) -> Vec<ReceiverState>;

    /// What never arrived, oldest first; `None` where there is no such receiver or it keeps none.
    fn dead_letters(&self, receiver: &str) -> Option<Vec<DeadLetter>>;

    /// Sends one of them, or all, once more; how many, `None` as above.
    fn replay(&self, receiver: &str, id: Option<&str>) -> Option<usize>;
}
