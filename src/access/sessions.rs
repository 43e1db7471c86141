//! Who is logged in: a bounded table of sessions, each with an idle and an absolute end. Only the hash of what the browser
//! holds is kept.

use super::secret::{digest, hex};
use std::collections::HashMap;

/// Sessions of one user; a further one ends the oldest.
const MOST_OF_A_USER: usize = 10;

/// How long and how many.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// One that nobody used for so long ends (s).
    pub idle_s: f64,
    /// Every one ends after this (s).
    pub longest_s: f64,
    /// At the same time.
    pub most: usize,
}

struct Session {
    user: String,
    /// Of the user's password and roles when it began: it ends when they change.
    stamp: [u8; 32],
    csrf: String,
    began: f64,
    used: f64,
}

/// A session that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// Whose.
    pub user: String,
    /// What a change must carry beside the cookie.
    pub csrf: String,
    /// See `Session`.
    pub stamp: [u8; 32],
}

/// What a new session's holder is given.
pub struct Begun {
    /// For the cookie; nobody else has it, and it is not kept.
    pub id: String,
    /// For the page.
    pub csrf: String,
}

/// The sessions.
pub struct Sessions {
    bounds: Bounds,
    by_digest: HashMap<[u8; 32], Session>,
}

impl Sessions {
    /// None yet.
    pub fn new(bounds: Bounds) -> Self {
        Self { bounds, by_digest: HashMap::new() }
    }

    /// Begins one, at `now` (s, of a steady clock), from 64 random bytes.
    pub fn begin(&mut self, user: &str, stamp: [u8; 32], random: [u8; 64], now: f64) -> Begun {
        self.forget_ended(now);
        let own = self.by_digest.values().filter(|session| session.user == user).count();
        if own >= MOST_OF_A_USER {
            self.drop_oldest(|session| session.user == user);
        }
        if self.by_digest.len() >= self.bounds.most {
            self.drop_oldest(|_| true);
        }
        let (id, csrf) = (hex(&random[..32]), hex(&random[32..]));
        let session = Session { user: user.to_string(), stamp, csrf: csrf.clone(), began: now, used: now };
        self.by_digest.insert(digest(&id), session);
        Begun { id, csrf }
    }

    /// The session that a cookie names, if it has not ended; it counts as used.
    pub fn find(&mut self, id: &str, now: f64) -> Option<Found> {
        let found = self.find_unused(id, now)?;
        if let Some(session) = self.by_digest.get_mut(&digest(id)) {
            session.used = now;
        }
        Some(found)
    }

    /// The same for what a page asks by itself, while nobody touches it: it does not count as used.
    pub fn find_unused(&mut self, id: &str, now: f64) -> Option<Found> {
        let key = digest(id);
        let bounds = self.bounds;
        let session = self.by_digest.get(&key)?;
        if !session.lasts(bounds, now) {
            self.by_digest.remove(&key);
            return None;
        }
        Some(Found { user: session.user.clone(), csrf: session.csrf.clone(), stamp: session.stamp })
    }

    /// Whose session has this digest, and its stamp, if it has not ended; it does not count as used.
    pub fn look(&self, key: &[u8; 32], now: f64) -> Option<(String, [u8; 32])> {
        let session = self.by_digest.get(key).filter(|session| session.lasts(self.bounds, now))?;
        Some((session.user.clone(), session.stamp))
    }

    /// Ends one; whether there was one.
    pub fn end(&mut self, id: &str) -> bool {
        self.by_digest.remove(&digest(id)).is_some()
    }

    fn forget_ended(&mut self, now: f64) {
        let bounds = self.bounds;
        self.by_digest.retain(|_, session| session.lasts(bounds, now));
    }

    fn drop_oldest(&mut self, among: impl Fn(&Session) -> bool) {
        let some = self.by_digest.iter().filter(|(_, session)| among(session));
        if let Some(oldest) = some.min_by(|a, b| a.1.used.total_cmp(&b.1.used)).map(|(key, _)| *key) {
            self.by_digest.remove(&oldest);
        }
    }
}

impl Session {
    fn lasts(&self, bounds: Bounds, now: f64) -> bool {
        now - self.used <= bounds.idle_s && now - self.began <= bounds.longest_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds { idle_s: 100.0, longest_s: 250.0, most: 12 };

    fn random(n: u8) -> [u8; 64] {
        let mut bytes = [n; 64];
        bytes[40] = 200;
        bytes
    }

    #[test]
    fn it_ends_when_idle_when_old_and_at_log_out() {
        let mut sessions = Sessions::new(BOUNDS);
        let first = sessions.begin("jw", [1; 32], random(1), 0.0);
        let found = sessions.find(&first.id, 100.0).expect("in time");
        assert_eq!((found.user.as_str(), found.csrf.as_str()), ("jw", first.csrf.as_str()));
        assert!(first.csrf != first.id && !first.csrf.is_empty());
        assert!(sessions.find_unused(&first.id, 150.0).is_some());
        assert!(sessions.find(&first.id, 200.0).is_some(), "used meanwhile");
        assert_eq!(sessions.find(&first.id, 251.0), None, "too old, although used");
        let second = sessions.begin("jw", [1; 32], random(2), 300.0);
        assert_eq!(sessions.find(&second.id, 401.0), None, "idle");
        let third = sessions.begin("jw", [1; 32], random(3), 500.0);
        assert!(sessions.end(&third.id) && !sessions.end(&third.id));
        assert_eq!(sessions.find(&third.id, 500.0), None);
        assert_eq!(sessions.find("no such", 500.0), None);
    }

    #[test]
    fn there_are_no_more_than_the_bounds_say_and_one_user_cannot_take_all_places() {
        let mut sessions = Sessions::new(BOUNDS);
        let other = sessions.begin("kb", [2; 32], random(100), 0.0);
        let all: Vec<Begun> =
            (0..30).map(|n| sessions.begin("jw", [1; 32], random(n), f64::from(n))).collect();
        assert_eq!(sessions.by_digest.len(), 11);
        assert!(sessions.find(&other.id, 30.0).is_some());
        assert!(sessions.find(&all[19].id, 30.0).is_none() && sessions.find(&all[20].id, 30.0).is_some());
        for n in 40..60 {
            sessions.begin(&format!("u{n}"), [3; 32], random(n), 40.0);
        }
        assert_eq!(sessions.by_digest.len(), BOUNDS.most);
    }
}
