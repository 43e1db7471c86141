//! Who may come in: users with passwords, programs with tokens, sessions of the dashboard. All of it is pure but for
//! `file`, which reads and writes the book of users and tokens, and `secret`, which asks the machine for random bytes.
//!
//! A password is kept as Argon2id, a token and a session as SHA-256 of random bytes: what is kept does not open the door.

mod book;
mod config;
pub mod file;
mod lease;
mod role;
mod secret;
mod sessions;
mod throttle;

pub use book::{Book, BookError, NewToken, Refused, Token, User, is_name};
pub use config::Config;
pub use file::FileError;
pub use lease::Lease;
pub use role::{Role, Roles};
pub use secret::{Cost, PasswordHash, random, same_word, wrong_password};
pub use sessions::Begun;

use sessions::Sessions;
use std::fmt;
use std::net::IpAddr;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use throttle::Throttle;
use tokio::sync::watch;

/// Somebody who was recognised.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Their name.
    pub name: String,
    /// What they may do.
    pub roles: Roles,
    /// How they were recognised.
    pub by: Proof,
}

/// How somebody was recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proof {
    /// A person, by a password, and since then by a cookie.
    Session,
    /// A program, by its token.
    Token,
}

impl fmt::Display for Proof {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Proof::Session => "session",
            Proof::Token => "token",
        })
    }
}

/// Who is in, and who may come in.
pub struct Access {
    config: Config,
    book: RwLock<Arc<Book>>,
    sessions: Mutex<Sessions>,
    throttle: Mutex<Throttle>,
    /// Hashed for users that do not exist, so that they take as long.
    nobody: PasswordHash,
    /// Counts what may have ended a lease.
    changes: watch::Sender<u64>,
}

impl Access {
    /// Opens the door for who is in the book.
    pub fn new(config: Config, book: Book) -> Self {
        let cost = book.users.first().map_or(Cost::default(), |user| user.password.cost);
        Self {
            sessions: Mutex::new(Sessions::new(config.bounds())),
            throttle: Mutex::default(),
            nobody: PasswordHash { cost, salt: [0; 16], hash: [0; 32] },
            book: RwLock::new(Arc::new(book)),
            changes: watch::Sender::new(0),
            config,
        }
    }

    /// Where the book is.
    pub fn file(&self) -> &Path {
        &self.config.file
    }

    /// Whether who is not known may read.
    pub fn anyone_may_read(&self) -> bool {
        self.config.anyone_may_read
    }

    /// The book in force.
    pub fn book(&self) -> Arc<Book> {
        self.book.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Another book: sessions of users whose password or roles differ end.
    pub fn replace(&self, book: Book) {
        *self.book.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(book);
        self.changed();
    }

    /// The program that shows a token, at the wall's `now` (s).
    ///
    /// # Errors
    /// [`Refused`].
    pub fn of_token(&self, text: &str, now: f64) -> Result<(Identity, Lease), Refused> {
        let book = self.book();
        let token = book.token(text, now)?;
        let lease = Lease::Token(token.id.clone(), token.hash);
        Ok((Identity { name: token.name.clone(), roles: token.roles.clone(), by: Proof::Token }, lease))
    }

    /// The person whose browser shows a cookie, and what a change must carry beside it, at the steady clock's `now` (s); whether it
    /// counts as used.
    pub fn of_session(&self, id: &str, now: f64, used: bool) -> Option<(Identity, sessions::Found)> {
        let found = match used {
            true => self.sessions().find(id, now)?,
            false => self.sessions().find_unused(id, now)?,
        };
        let book = self.book();
        let user = book.user(&found.user).filter(|user| user.stamp() == found.stamp);
        let Some(user) = user else {
            self.sessions().end(id);
            return None;
        };
        Some((Identity { name: user.name.clone(), roles: user.roles.clone(), by: Proof::Session }, found))
    }

    /// Whether a password may be tried now; it counts as a failure until [`Access::begin`].
    ///
    /// # Errors
    /// How long to wait (s).
    pub fn attempt(&self, user: &str, from: IpAddr, now: f64) -> Result<(), f64> {
        self.throttle.lock().unwrap_or_else(PoisonError::into_inner).attempt(user, from, now)
    }

    /// The user with this password. Takes tens of milliseconds and megabytes, for those that do not exist too.
    pub fn recognise(&self, name: &str, password: &str) -> Option<User> {
        let book = self.book();
        match book.user(name) {
            Some(user) => user.password.is(password).then(|| user.clone()),
            None => {
                self.nobody.is(password);
                None
            }
        }
    }

    /// Begins a session of a user who was recognised; `None` where the machine has no randomness.
    pub fn begin(&self, user: &User, from: IpAddr, now: f64) -> Option<Begun> {
        self.throttle.lock().unwrap_or_else(PoisonError::into_inner).succeeded(&user.name, from);
        Some(self.sessions().begin(&user.name, user.stamp(), random()?, now))
    }

    /// Ends a session; whether there was one.
    pub fn end(&self, id: &str) -> bool {
        let ended = self.sessions().end(id);
        self.changed();
        ended
    }

    fn sessions(&self) -> MutexGuard<'_, Sessions> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access() -> Access {
        let hash = |word: &str| PasswordHash::of(word, [1; 16], Cost { memory_kib: 8, passes: 1 });
        let mut book = Book::default();
        let roles = Roles::of(&[Role::Operator]);
        book.add_user("jw", roles, hash("right and good").expect("a cost")).expect("added");
        Access::new(Config::new("unused".into()), book)
    }

    #[test]
    fn a_session_ends_when_password_or_roles_change_or_the_user_goes() {
        let from = IpAddr::from([10, 0, 0, 1]);
        let access = access();
        assert!(access.recognise("jw", "wrong").is_none() && access.recognise("nobody", "wrong").is_none());
        let user = access.recognise("JW", "right and good").expect("the password");
        let begin = || access.begin(&user, from, 0.0).expect("random bytes");
        let (first, second) = (begin(), begin());
        let (who, found) = access.of_session(&first.id, 1.0, true).expect("logged in");
        assert_eq!((who.name.as_str(), who.by), ("jw", Proof::Session));
        assert!(found.csrf == first.csrf && first.csrf != second.csrf);
        let mut book = (*access.book()).clone();
        book.change_user("jw", Some(Roles::of(&[Role::Viewer])), None).expect("there");
        access.replace(book.clone());
        assert!(access.of_session(&first.id, 1.0, true).is_none());
        let user = access.recognise("jw", "right and good").expect("the password");
        let third = access.begin(&user, from, 0.0).expect("random bytes");
        book.remove_user("jw").expect("there");
        access.replace(book);
        assert!(access.of_session(&third.id, 1.0, true).is_none());
        assert!(access.of_session(&second.id, 1.0, true).is_none());
    }
}
