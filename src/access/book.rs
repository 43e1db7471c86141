//! Users and tokens: what the file of `[access]` holds, and what may be done to it. Pure; randomness and times are
//! arguments.

use super::role::{Role, Roles};
use super::secret::{PasswordHash, digest, hex, same};
use std::fmt;

/// Users, and tokens that have not run out, at most.
const MOST: usize = 10_000;
/// What a token begins with: whoever finds one in a log or a repository knows what it is.
const PREFIX: &str = "stictiond";

/// A person.
#[derive(Clone, Debug, PartialEq)]
pub struct User {
    /// What they log in with, and what stands in the audit log.
    pub name: String,
    /// What they may do.
    pub roles: Roles,
    /// What they are recognised by.
    pub password: PasswordHash,
}

impl User {
    /// Of password and roles: it changes when one of them does.
    pub fn stamp(&self) -> [u8; 32] {
        digest(&format!("{} {} {}", hex(&self.password.salt), hex(&self.password.hash), self.roles))
    }
}

/// What a program shows.
#[derive(Clone, PartialEq)]
pub struct Token {
    /// Which one; no secret.
    pub id: String,
    /// What it is for; stands in the audit log. Two have the same while one is being replaced.
    pub name: String,
    /// What it may do.
    pub roles: Roles,
    /// SHA-256 of the secret part.
    pub hash: [u8; 32],
    /// When it was made (s since the Unix epoch).
    pub created: f64,
    /// When it stops being good (s).
    pub expires: f64,
}

impl Token {
    /// What is another in the token that has its place now, for the audit log.
    fn changes(&self, now: &Self) -> Vec<String> {
        let mut found = Vec::new();
        if now.name != self.name {
            found.push(format!("is now called {}", now.name));
        }
        if now.roles != self.roles {
            found.push(format!("is now {}", now.roles));
        }
        if now.hash != self.hash {
            found.push("has another secret".to_string());
        }
        if now.expires.to_bits() != self.expires.to_bits() {
            let end = jiff::Timestamp::from_second(now.expires as i64);
            let end = end.map_or_else(|_| format!("{} s", now.expires), |end| end.to_string());
            found.push(format!("now runs out at {end}"));
        }
        found
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "Token({} {:?}, {})", self.id, self.name, self.roles)
    }
}

/// A token that has just been made: shown once, kept nowhere.
pub struct NewToken {
    /// Which one.
    pub id: String,
    /// What the program shows.
    pub text: String,
}

/// Why nothing was changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BookError {
    /// A name that cannot be one.
    #[error("{0:?} must be 1 to 64 letters, digits and . _ - @, the first a letter or digit")]
    BadName(String),
    /// It is there already.
    #[error("there is already a {0} {1:?}")]
    Taken(&'static str, String),
    /// It is not there.
    #[error("there is no {0} {1:?}")]
    Unknown(&'static str, String),
    /// Somebody who may nothing.
    #[error("at least one role: viewer, operator, engineer or approver")]
    NoRole,
    /// An end that has passed.
    #[error("it would have run out already")]
    Expired,
    /// Too many.
    #[error("there are {MOST} already")]
    Full,
}

/// Why a token is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// It was never made, was revoked, or is forged.
    Unknown,
    /// It has run out.
    Expired,
}

/// Users and tokens.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Book {
    /// By the order in which they were added.
    pub users: Vec<User>,
    /// By the order in which they were made.
    pub tokens: Vec<Token>,
}

/// Whether a user or token may be called so.
pub fn is_name(name: &str) -> bool {
    let first = name.chars().next().is_some_and(|c| c.is_ascii_alphanumeric());
    first && name.len() <= 64 && name.chars().all(|c| c.is_ascii_alphanumeric() || "._-@".contains(c))
}

fn named(name: &str, roles: &Roles) -> Result<(), BookError> {
    if !is_name(name) {
        return Err(BookError::BadName(name.to_string()));
    }
    if roles.is_empty() { Err(BookError::NoRole) } else { Ok(()) }
}

impl Book {
    /// A user by name, whatever the case.
    pub fn user(&self, name: &str) -> Option<&User> {
        self.users.iter().find(|user| user.name.eq_ignore_ascii_case(name))
    }

    /// Adds a user.
    ///
    /// # Errors
    /// [`BookError`]; also when the name is there in another case.
    pub fn add_user(&mut self, name: &str, roles: Roles, password: PasswordHash) -> Result<(), BookError> {
        named(name, &roles)?;
        if self.user(name).is_some() {
            return Err(BookError::Taken("user", name.to_string()));
        }
        if self.users.len() >= MOST {
            return Err(BookError::Full);
        }
        self.users.push(User { name: name.to_string(), roles, password });
        Ok(())
    }

    /// Changes a user's password, or roles, or both: their sessions end.
    ///
    /// # Errors
    /// [`BookError::Unknown`].
    pub fn change_user(
        &mut self,
        name: &str,
        roles: Option<Roles>,
        password: Option<PasswordHash>,
    ) -> Result<(), BookError> {
        let user = self.users.iter_mut().find(|user| user.name.eq_ignore_ascii_case(name));
        let user = user.ok_or_else(|| BookError::Unknown("user", name.to_string()))?;
        if let Some(roles) = roles {
            named(name, &roles)?;
            user.roles = roles;
        }
        if let Some(password) = password {
            user.password = password;
        }
        Ok(())
    }

    /// Takes a user out: their sessions end.
    ///
    /// # Errors
    /// [`BookError::Unknown`].
    pub fn remove_user(&mut self, name: &str) -> Result<(), BookError> {
        let before = self.users.len();
        self.users.retain(|user| !user.name.eq_ignore_ascii_case(name));
        if self.users.len() < before { Ok(()) } else { Err(BookError::Unknown("user", name.to_string())) }
    }

    /// Makes a token, from 38 random bytes; tokens that have long run out are forgotten.
    ///
    /// # Errors
    /// [`BookError`]; also when another of this name is good.
    pub fn create_token(
        &mut self,
        name: &str,
        roles: Roles,
        (now, expires): (f64, f64),
        random: [u8; 38],
    ) -> Result<NewToken, BookError> {
        named(name, &roles)?;
        if self.good(name, now).next().is_some() {
            return Err(BookError::Taken("token", name.to_string()));
        }
        self.make(name, roles, (now, expires), random)
    }

    /// Makes a token of the name and roles of one that is there, which stops being good at `until`.
    ///
    /// # Errors
    /// [`BookError`].
    pub fn rotate_token(
        &mut self,
        name: &str,
        (now, expires): (f64, f64),
        until: f64,
        random: [u8; 38],
    ) -> Result<NewToken, BookError> {
        let newest = self.good(name, now).max_by(|a, b| a.created.total_cmp(&b.created));
        let roles = newest.map(|token| token.roles.clone());
        let roles = roles.ok_or_else(|| BookError::Unknown("token", name.to_string()))?;
        for token in self.tokens.iter_mut().filter(|token| token.name == name) {
            token.expires = token.expires.min(until);
        }
        self.make(name, roles, (now, expires), random)
    }

    /// Takes tokens out, by name or by id.
    ///
    /// # Errors
    /// [`BookError::Unknown`].
    pub fn revoke_token(&mut self, which: &str) -> Result<(), BookError> {
        let before = self.tokens.len();
        self.tokens.retain(|token| token.name != which && token.id != which);
        if self.tokens.len() < before { Ok(()) } else { Err(BookError::Unknown("token", which.to_string())) }
    }

    /// The token that a program shows.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn token(&self, text: &str, now: f64) -> Result<&Token, Refused> {
        let rest = text.strip_prefix(PREFIX).and_then(|rest| rest.strip_prefix('_'));
        let (id, secret) = rest.and_then(|rest| rest.split_once('_')).ok_or(Refused::Unknown)?;
        match self.token_of(id, &digest(secret)) {
            Some(token) if token.expires > now => Ok(token),
            Some(_) => Err(Refused::Expired),
            None => Err(Refused::Unknown),
        }
    }

    /// The token of this name whose secret has this digest, expired or not.
    pub(super) fn token_of(&self, id: &str, hash: &[u8; 32]) -> Option<&Token> {
        self.tokens.iter().find(|token| token.id == id && same(&token.hash, hash))
    }

    /// Whether a role is had by anybody: by a user, or by a token that is good at `now`.
    pub fn has(&self, role: Role, now: f64) -> bool {
        let tokens = self.tokens.iter().filter(|token| token.expires > now).map(|token| &token.roles);
        self.users.iter().map(|user| &user.roles).chain(tokens).any(|roles| roles.may(role))
    }

    /// This book without what it gives more than the one in force: nobody and no token comes in who does not now, or may do more, or
    /// for longer. A user with another password can log in by neither of the two.
    pub fn no_more_than(&self, in_force: &Self) -> Self {
        let user = |own: &User| {
            let before = in_force.user(&own.name).filter(|before| before.password == own.password)?;
            Some(User { roles: own.roles.common(&before.roles), ..own.clone() })
        };
        let token = |own: &Token| {
            let before = in_force.token_of(&own.id, &own.hash)?;
            let expires = own.expires.min(before.expires);
            Some(Token { roles: own.roles.common(&before.roles), expires, ..own.clone() })
        };
        Self {
            users: self.users.iter().filter_map(user).filter(|user| !user.roles.is_empty()).collect(),
            tokens: self.tokens.iter().filter_map(token).filter(|token| !token.roles.is_empty()).collect(),
        }
    }

    /// What another book has that this one has not, and the other way round, for the audit log.
    pub fn differences(&self, other: &Book) -> Vec<String> {
        let mut found = Vec::new();
        for user in &self.users {
            let Some(now) = other.user(&user.name) else {
                found.push(format!("user {} removed", user.name));
                continue;
            };
            if now.roles != user.roles {
                found.push(format!("user {} is now {}", user.name, now.roles));
            }
            if now.password != user.password {
                found.push(format!("user {} has another password", user.name));
            }
        }
        let new = other.users.iter().filter(|user| self.user(&user.name).is_none());
        found.extend(new.map(|user| format!("user {} added as {}", user.name, user.roles)));
        for token in &self.tokens {
            let own = format!("token {} ({})", token.name, token.id);
            match other.tokens.iter().find(|other| other.id == token.id) {
                None => found.push(format!("{own} removed")),
                Some(now) => found.extend(token.changes(now).into_iter().map(|what| format!("{own} {what}"))),
            }
        }
        let there = |token: &Token| self.tokens.iter().any(|own| own.id == token.id);
        let new = other.tokens.iter().filter(|token| !there(token));
        found.extend(new.map(|token| format!("token {} ({}) made as {}", token.name, token.id, token.roles)));
        found
    }

    fn good<'a>(&'a self, name: &'a str, now: f64) -> impl Iterator<Item = &'a Token> {
        self.tokens.iter().filter(move |token| token.name == name && token.expires > now)
    }

    fn make(
        &mut self,
        name: &str,
        roles: Roles,
        (created, expires): (f64, f64),
        random: [u8; 38],
    ) -> Result<NewToken, BookError> {
        if expires.is_nan() || expires <= created {
            return Err(BookError::Expired);
        }
        // What has run out is shown in the list for a month.
        self.tokens.retain(|token| token.expires > created - 30.0 * 86_400.0);
        if self.tokens.len() >= MOST {
            return Err(BookError::Full);
        }
        let (id, secret) = (hex(&random[..6]), hex(&random[6..]));
        let (hash, name) = (digest(&secret), name.to_string());
        self.tokens.push(Token { id: id.clone(), name, roles, hash, created, expires });
        Ok(NewToken { text: format!("{PREFIX}_{id}_{secret}"), id })
    }
}

#[cfg(test)]
mod tests {
    use super::super::secret::Cost;
    use super::*;

    fn password(text: &str) -> PasswordHash {
        PasswordHash::of(text, [1; 16], Cost { memory_kib: 8, passes: 1 }).expect("a cost")
    }

    fn viewer() -> Roles {
        Roles::of(&[Role::Viewer])
    }

    #[test]
    fn users_are_added_changed_and_taken_out() {
        let mut book = Book::default();
        assert_eq!(book.add_user("M.Keller", viewer(), password("a")), Ok(()));
        assert!(matches!(book.add_user("m.keller", viewer(), password("a")), Err(BookError::Taken(..))));
        assert_eq!(book.add_user("x", Roles::default(), password("a")), Err(BookError::NoRole));
        for wrong in ["", "a b", "-a", "a\n", "ä", &"a".repeat(65), "a\"b", "<b>"] {
            assert!(matches!(book.add_user(wrong, viewer(), password("a")), Err(BookError::BadName(_))));
        }
        let stamp = book.user("m.KELLER").expect("there").stamp();
        let operator = Roles::of(&[Role::Operator]);
        assert_eq!(book.change_user("M.Keller", Some(operator), None), Ok(()));
        let other = book.user("M.Keller").expect("there").stamp();
        assert_ne!(stamp, other);
        assert_eq!(book.change_user("M.Keller", None, Some(password("b"))), Ok(()));
        assert_ne!(book.user("M.Keller").expect("there").stamp(), other);
        let mut more = book.clone();
        more.add_user("kb", viewer(), password("c")).expect("added");
        more.change_user("M.Keller", Some(viewer()), None).expect("there");
        more.create_token("t", viewer(), (0.0, 1.0), [7; 38]).expect("made");
        assert_eq!(
            book.differences(&more),
            [
                "user M.Keller is now viewer",
                "user kb added as viewer",
                "token t (070707070707) made as viewer"
            ]
        );
        assert_eq!(more.differences(&book)[1..], ["user kb removed", "token t (070707070707) removed"]);
        assert!(book.has(Role::Operator, 0.0) && !book.has(Role::Engineer, 0.0));
        assert_eq!(book.remove_user("m.keller"), Ok(()));
        assert!(matches!(book.remove_user("m.keller"), Err(BookError::Unknown(..))));
    }

    #[test]
    fn of_a_user_with_other_roles_and_another_password_both_are_told() {
        let mut book = Book::default();
        book.add_user("jw", viewer(), password("a")).expect("added");
        let mut other = book.clone();
        let engineer = Roles::of(&[Role::Engineer]);
        other.change_user("jw", Some(engineer), Some(password("b"))).expect("there");
        assert_eq!(book.differences(&other), ["user jw is now engineer", "user jw has another password"]);
    }

    #[test]
    fn what_has_changed_in_a_token_that_stays_is_told() {
        let mut book = Book::default();
        book.create_token("t", viewer(), (0.0, 100.0), [7; 38]).expect("made");
        assert_eq!(book.differences(&book), Vec::<String>::new());
        // The old one is good for ten seconds yet.
        let mut rotated = book.clone();
        rotated.rotate_token("t", (50.0, 200.0), 60.0, [9; 38]).expect("made");
        assert_eq!(
            book.differences(&rotated),
            [
                "token t (070707070707) now runs out at 1970-01-01T00:01:00Z",
                "token t (090909090909) made as viewer"
            ]
        );
        // By a hand in the file.
        let mut edited = book.clone();
        edited.tokens[0].name = "u".to_string();
        edited.tokens[0].roles = Roles::of(&[Role::Engineer]);
        edited.tokens[0].hash = [0; 32];
        let said = ["is now called u", "is now engineer", "has another secret"];
        let said = said.map(|what| format!("token t (070707070707) {what}"));
        assert_eq!(book.differences(&edited), said);
    }

    #[test]
    fn no_more_than_another_book_leaves_out_what_is_gained_and_keeps_what_is_taken() {
        let [operator, engineer, approver] =
            [Role::Operator, Role::Engineer, Role::Approver].map(|role| Roles::of(&[role]));
        let mut old = Book::default();
        for (name, roles) in
            [("gone", &engineer), ("less", &engineer), ("more", &operator), ("other", &engineer)]
        {
            old.add_user(name, roles.clone(), password("a")).expect("added");
        }
        old.add_user("word", engineer.clone(), password("a")).expect("added");
        old.create_token("t", engineer.clone(), (0.0, 100.0), [1; 38]).expect("made");
        let mut new = old.clone();
        new.remove_user("gone").expect("there");
        new.change_user("less", Some(operator.clone()), None).expect("there");
        new.change_user("more", Some(engineer.clone()), None).expect("there");
        new.change_user("other", Some(approver), None).expect("there");
        new.change_user("word", None, Some(password("b"))).expect("there");
        new.add_user("new", viewer(), password("a")).expect("added");
        new.rotate_token("t", (50.0, 200.0), 60.0, [2; 38]).expect("made");
        let taken = new.no_more_than(&old);
        let names: Vec<&str> = taken.users.iter().map(|user| user.name.as_str()).collect();
        assert_eq!(names, ["less", "more", "other"]);
        assert_eq!(taken.user("less").expect("there").roles, operator);
        assert_eq!(taken.user("more").expect("there").stamp(), old.user("more").expect("there").stamp());
        let other = &taken.user("other").expect("there").roles;
        assert!(other.may(Role::Operator) && !other.may(Role::Engineer) && !other.may(Role::Approver));
        assert_eq!(taken.tokens.iter().map(|token| token.expires).collect::<Vec<_>>(), [60.0]);
        new.tokens[0].expires = 500.0;
        new.tokens[0].roles = Roles::of(&Role::ALL);
        let taken = new.no_more_than(&old);
        let kept = &taken.tokens[0];
        assert_eq!((kept.expires, &kept.roles), (100.0, &engineer));
        assert_eq!(old.no_more_than(&old), old);
    }

    #[test]
    fn a_token_is_good_until_it_runs_out_is_replaced_or_revoked() {
        let mut book = Book::default();
        let first = book.create_token("scraper", viewer(), (0.0, 100.0), [1; 38]).expect("made");
        assert_eq!(book.token(&first.text, 99.0).map(|token| token.id.as_str()), Ok(first.id.as_str()));
        assert_eq!(book.token(&first.text, 100.0), Err(Refused::Expired));
        assert!(matches!(
            book.create_token("scraper", viewer(), (1.0, 9.0), [9; 38]),
            Err(BookError::Taken(..))
        ));
        let second = book.rotate_token("scraper", (50.0, 200.0), 60.0, [2; 38]).expect("made");
        assert!(book.token(&first.text, 59.0).is_ok() && book.token(&second.text, 59.0).is_ok());
        assert_eq!(book.token(&first.text, 60.0), Err(Refused::Expired));
        assert!(book.rotate_token("nobody", (0.0, 1.0), 0.0, [3; 38]).is_err());
        assert_eq!(book.revoke_token("scraper"), Ok(()));
        assert_eq!(book.token(&second.text, 59.0), Err(Refused::Unknown));
        assert!(matches!(book.create_token("a", viewer(), (5.0, 5.0), [4; 38]), Err(BookError::Expired)));
    }

    #[test]
    fn a_token_that_was_changed_anywhere_is_unknown() {
        let mut book = Book::default();
        let made = book.create_token("scraper", viewer(), (0.0, 100.0), [0x5a; 38]).expect("made");
        for at in 0..made.text.len() {
            let mut forged = made.text.clone().into_bytes();
            forged[at] = if forged[at] == b'0' { b'1' } else { b'0' };
            let forged = String::from_utf8(forged).expect("ASCII");
            assert_eq!(book.token(&forged, 1.0), Err(Refused::Unknown), "{at}");
        }
        for wrong in ["", "stictiond", "stictiond__", &made.text[..made.text.len() - 1], &made.id] {
            assert_eq!(book.token(wrong, 1.0), Err(Refused::Unknown), "{wrong}");
        }
        assert!(!format!("{book:?}").contains("5a5a5a5a5a5a5a5a"), "no secret is shown");
    }
}
