//! A grant is good for as long as both who gave it may give it: who loses the role takes it along.

use crate::access::file::{self, Version};
use crate::access::{Book, Role};
use crate::compensation::gate::{Action, Grant};
use crate::writeback::Writeback;
use std::path::PathBuf;
use std::sync::Weak;
use std::time::Duration;

/// How often grants are held against the book.
const LOOK: Duration = Duration::from_secs(1);

/// The book of users as it was read last.
struct Rights {
    file: PathBuf,
    /// Of the version that was looked at; `None` before the first look.
    seen: Option<Option<Version>>,
    book: Option<Book>,
    /// That it cannot be read was said.
    failed: bool,
}

/// Takes grants back for as long as `running` is there: an active term by its ramp, and who has lost the right is on record.
pub(super) async fn follow(running: Weak<Writeback>, file: PathBuf) {
    let mut rights = Rights { file, seen: None, book: None, failed: false };
    loop {
        tokio::time::sleep(LOOK).await;
        let Some(running) = running.upgrade() else { return };
        let looked = tokio::task::spawn_blocking(move || rights.look_again()).await;
        rights = match looked {
            Ok(rights) => rights,
            Err(error) => {
                return tracing::error!(%error, "write-back: grants are no longer checked against the users file; restart stictiond");
            }
        };
        // Grants of now, not of when the book changed: a session of before may have given one since.
        for (id, grant) in running.grants() {
            if let Some(why) = rights.book.as_ref().and_then(|book| lost(book, &grant)) {
                tracing::warn!(%id, why, "a grant is taken back");
                // Refused where the grant has ended meanwhile.
                let _ = running.act(&id, Action::Withdraw, &why).await;
            }
        }
    }
}

impl Rights {
    /// Reads the book where it is another. One that cannot be read changes nothing, as at the door.
    fn look_again(mut self) -> Self {
        let now = Some(file::version(&self.file));
        if self.seen != now {
            // A missing file, as during a restore, does not mean that nobody has the role.
            match file::load(&self.file) {
                Ok(book) => (self.book, self.seen, self.failed) = (Some(book), now, false),
                Err(error) if !std::mem::replace(&mut self.failed, true) => {
                    tracing::error!(%error, "write-back: the users file cannot be read, so grants keep the rights read last; mend the file");
                }
                Err(_) => {}
            }
        }
        self
    }
}

/// Why a grant is no longer good, as it is put on record.
fn lost(book: &Book, grant: &Grant) -> Option<String> {
    let may = |name: &str| book.user(name).is_some_and(|user| user.roles.may(Role::Approver));
    let mut both = [Some(&grant.by), grant.approved_by.as_ref()].into_iter().flatten();
    let who = both.find(|name| !may(name))?;
    Some(format!("{who} no longer has the role {} in the users file", Role::Approver))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{Cost, PasswordHash, Roles};
    use crate::compensation::gate::Time;

    #[test]
    fn a_grant_is_good_while_both_may_give_it() {
        let hash = || PasswordHash::of("word", [1; 16], Cost { memory_kib: 8, passes: 1 }).expect("a cost");
        let mut book = Book::default();
        for name in ["ann", "bob"] {
            book.add_user(name, Roles::of(&[Role::Approver]), hash()).expect("added");
        }
        let until = Time { mono: 1.0, wall: 1.0 };
        let waits = Grant { by: "ann".into(), approved_by: None, until };
        let approved = Grant { approved_by: Some("bob".into()), ..waits.clone() };
        assert_eq!([&waits, &approved].map(|grant| lost(&book, grant)), [None, None]);
        book.change_user("bob", Some(Roles::of(&[Role::Operator])), None).expect("there");
        let why = "bob no longer has the role approver in the users file".to_string();
        assert_eq!([&waits, &approved].map(|grant| lost(&book, grant)), [None, Some(why)]);
        book.remove_user("ann").expect("there");
        assert!(lost(&book, &waits).is_some_and(|why| why.contains("ann")));
    }
}
