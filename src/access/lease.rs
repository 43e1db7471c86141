//! What somebody's rights rest on: they are asked for again as long as they are used, and end with it.

use super::secret::digest;
use super::{Access, Role};
use std::fmt;
use tokio::sync::watch;

/// A session or a token, by what is kept of it; it opens no door.
#[derive(Clone, PartialEq, Eq)]
pub enum Lease {
    /// A person's, by the digest of the cookie.
    Session([u8; 32]),
    /// A program's, by the token's name in the book and the digest of its secret.
    Token(String, [u8; 32]),
}

impl fmt::Debug for Lease {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Lease::Session(_) => "Session",
            Lease::Token(..) => "Token",
        })
    }
}

impl Lease {
    /// Of the cookie of a session.
    pub fn of_session(id: &str) -> Self {
        Lease::Session(digest(id))
    }
}

impl Access {
    /// Whether a lease still gives a role, at the wall's and the steady clock's now (s). It does not count as use: who
    /// only listens is idle.
    pub fn holds(&self, lease: &Lease, role: Role, wall: f64, steady: f64) -> bool {
        let book = self.book();
        match lease {
            Lease::Token(id, hash) => {
                book.token_of(id, hash).is_some_and(|token| token.expires > wall && token.roles.may(role))
            }
            Lease::Session(key) => {
                let found = self.sessions().look(key, steady);
                let user = found.and_then(|(name, stamp)| book.user(&name).filter(|u| u.stamp() == stamp));
                user.is_some_and(|user| user.roles.may(role))
            }
        }
    }

    /// Changes whenever a lease may have ended, but for those that end by their time.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    pub(super) fn changed(&self) {
        self.changes.send_modify(|count| *count += 1);
    }
}
