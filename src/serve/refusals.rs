//! How many refusals of one person or program are put on record: so many at once and then one a minute, so that nobody who may
//! change nothing can fill the record and push out of it what was changed.
//! Likewise how many throttled log-ins are in the log.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Refusals on record at once.
const AT_ONCE: f64 = 20.0;
/// Seconds until one more may be.
const EACH_S: f64 = 60.0;

/// What each name has left.
#[derive(Default)]
pub struct Refusals {
    /// Names are those of users and tokens, of which there are as many as the configuration has.
    by_name: Mutex<HashMap<String, Left>>,
}

struct Left {
    /// Refusals that may go on record now.
    entries: f64,
    at: f64,
    /// Those that did not since the last that did.
    left_out: u64,
}

impl Refusals {
    /// One more refusal of a name, at the steady clock's `now` (s): how many before it were not put on record, or `None` where it
    /// is not either.
    pub fn take(&self, name: &str, now: f64) -> Option<u64> {
        let mut by_name = self.by_name.lock().unwrap_or_else(PoisonError::into_inner);
        let new = || Left { entries: AT_ONCE, at: now, left_out: 0 };
        let left = by_name.entry(name.to_string()).or_insert_with(new);
        left.entries = (left.entries + (now - left.at).max(0.0) / EACH_S).min(AT_ONCE);
        left.at = now;
        if left.entries < 1.0 {
            left.left_out += 1;
            return None;
        }
        left.entries -= 1.0;
        Some(std::mem::take(&mut left.left_out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_refusals_leave_few_entries_and_say_how_many_they_were() {
        let refusals = Refusals::default();
        let taken: Vec<Option<u64>> = (0..100).map(|_| refusals.take("prometheus", 0.0)).collect();
        assert_eq!(taken.iter().flatten().count(), 20);
        assert_eq!(refusals.take("jw", 0.0), Some(0), "another person");
        assert_eq!(refusals.take("prometheus", 59.0), None);
        assert_eq!(refusals.take("prometheus", 61.0), Some(81));
        assert_eq!(refusals.take("prometheus", 62.0), None);
    }
}
