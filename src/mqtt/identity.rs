//! The name under which a broker knows a client. Two clients of one name throw each other out, again and again.

use std::collections::VecDeque;

/// Longest name that is made here (bytes); brokers of today take it.
const LONGEST: usize = 128;
/// So many connections that the broker ended within [`WINDOW_S`], and none that it refused, are no outage.
const ENDED: usize = 3;
/// The time in which they are counted (s).
const WINDOW_S: f64 = 120.0;
/// It is said again after so long (s).
const AGAIN_S: f64 = 3600.0;

/// The name of a client that has none in the file: the host's and the section's, so that neither two sections nor two
/// machines have the same.
pub fn default_client_id(host: &str, section: &str) -> String {
    let fits = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
    format!("stictiond-{host}-{section}").chars().map(fits).take(LONGEST).collect()
}

/// Tells a client of the same name from a broker that is not there: the one ends connections and takes the next at once, the
/// other takes none.
#[derive(Debug, Default)]
pub struct Takeovers {
    ended: VecDeque<f64>,
    said: Option<f64>,
}

impl Takeovers {
    /// The broker did not take a connection.
    pub fn refused(&mut self) {
        self.ended.clear();
    }

    /// The broker ended a connection that it had taken, at `now` (s). What to say of it, once in a while.
    pub fn ended(&mut self, now: f64, client_id: &str) -> Option<String> {
        self.ended.retain(|t| now - t <= WINDOW_S);
        self.ended.push_back(now);
        let quiet = self.said.is_some_and(|said| now - said < AGAIN_S);
        if self.ended.len() < ENDED || quiet {
            return None;
        }
        self.said = Some(now);
        Some(format!(
            "the broker ended {} connections within {WINDOW_S} s and took the next each time: another client seems to use \
             client_id = \"{client_id}\" and to take it over; give each client an id of its own",
            self.ended.len()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_differ_by_host_and_section() {
        assert_eq!(default_client_id("pc1", "plant"), "stictiond-pc1-plant");
        assert_ne!(default_client_id("pc1", "plant"), default_client_id("pc2", "plant"));
        assert_ne!(default_client_id("pc1", "a"), default_client_id("pc1", "b"));
        assert_eq!(default_client_id("pc1", "Halle 3/ä"), "stictiond-pc1-Halle-3--");
        assert!(default_client_id(&"x".repeat(300), "a").len() <= LONGEST);
    }

    #[test]
    fn connections_ended_in_a_row_are_a_takeover_and_an_outage_is_none() {
        let mut takeovers = Takeovers::default();
        assert_eq!(takeovers.ended(0.0, "x"), None);
        takeovers.refused();
        assert_eq!([1.0, 2.0].map(|t| takeovers.ended(t, "x")), [None, None]);
        let said = takeovers.ended(3.0, "x").unwrap();
        assert!(said.contains("client_id = \"x\""), "{said}");
        assert_eq!(takeovers.ended(4.0, "x"), None, "once");
        let again = [4000.0, 4001.0, 4002.0].map(|t| takeovers.ended(t, "x").is_some());
        assert_eq!(again, [false, false, true]);
        let mut rare = Takeovers::default();
        assert!((0..10).all(|n| rare.ended(f64::from(n) * 100.0, "x").is_none()));
    }
}
