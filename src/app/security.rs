//! Wires who may come in: the book of users and tokens, certificates, and the log of changes.

use super::AppError;
use crate::access::file::{self, Version};
use crate::access::{Access, Book, FileError};
use crate::audit::Recorder;
use crate::config::Config;
use crate::schedule::Clock;
use crate::serve::Tls;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// How often the book is looked at: a token that is revoked is good for no longer.
const LOOK: Duration = Duration::from_secs(1);

/// The door of the daemon, across reloads.
pub(super) struct Security {
    clock: Clock,
    pub(super) access: Option<Arc<Access>>,
    pub(super) audit: Option<Arc<Recorder>>,
    pub(super) tls: Option<Arc<Tls>>,
    seen: Mutex<Seen>,
}

/// What was seen of the book last.
#[derive(Default)]
struct Seen {
    /// Of the book that is in force; none before there was one.
    version: Option<Version>,
    /// It was said that the file is not there any more.
    gone: bool,
    /// What it adds waits for an audit log that works.
    waits: bool,
}

impl Security {
    /// Opens what `[access]`, `[audit]` and `[server.tls]` name; changes go to `other` where there is no `[audit]`. A log that is
    /// damaged takes no changes, and is no reason not to watch the plant.
    pub(super) fn new(config: &Config, clock: Clock, other: Option<Arc<Recorder>>) -> Result<Self, AppError> {
        let tls = config.server.tls.as_ref().map(Tls::load).transpose()?.map(Arc::new);
        let own = config.audit.as_ref().map(|own| Recorder::start(&own.file, own.bounds(), clock.now()));
        let audit = own.transpose()?.map(Arc::new).or(other);
        let mut seen = Seen::default();
        let access = match &config.access {
            None => None,
            Some(access) => {
                seen.version = file::version(&access.file);
                let book = book(&access.file)?;
                tracing::info!(users = book.users.len(), tokens = book.tokens.len(), "a log-in is needed");
                Some(Arc::new(Access::new(access.clone(), book)))
            }
        };
        Ok(Self { clock, access, audit, tls, seen: Mutex::new(seen) })
    }

    /// Reads certificates and book again.
    ///
    /// # Errors
    /// Then what was in force stays.
    pub(super) fn reload(&self) -> Result<(), AppError> {
        // A book that is refused must not leave new certificates in force.
        if let Some(access) = &self.access {
            let in_force = self.seen().version;
            read(access.file(), file::version(access.file()), in_force)?;
        }
        if let Some(tls) = &self.tls {
            tls.reload()?;
            tracing::info!("certificates read again");
        }
        self.look_again(true)
    }

    /// Says what nobody would notice: a log of write-back that was opened by a reload takes no changes of people.
    pub(super) fn warn_of_log(&self, of_writeback: Option<Arc<Recorder>>) {
        if self.audit.is_none() && of_writeback.is_some() {
            tracing::warn!(
                "write-back's audit log is open since a reload: it has what people change by the API from the next start on only"
            );
        }
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Follows the book until `stop` is cancelled.
    pub(super) async fn run(self: Arc<Self>, stop: CancellationToken) {
        if self.access.is_none() {
            return;
        }
        let mut said = None;
        while stop.run_until_cancelled(tokio::time::sleep(LOOK)).await.is_some() {
            let own = self.clone();
            let looked = tokio::task::spawn_blocking(move || own.look_again(false)).await;
            let failed = match looked {
                Ok(looked) => looked.err().map(|error| error.to_string()),
                Err(error) => Some(format!("they cannot be looked at: {error}")),
            };
            if let Some(error) = news(&mut said, failed) {
                tracing::error!(error, "users and tokens stay as they were");
            }
        }
    }

    /// Takes the book when it is another; when it cannot be read says so once. While there is an audit log that does not work, it takes
    /// what is removed and reduced only: what is added waits until it can be put on record.
    fn look_again(&self, anyway: bool) -> Result<(), AppError> {
        let Some(access) = &self.access else { return Ok(()) };
        let now = file::version(access.file());
        let mut seen = self.seen();
        let said = seen.gone;
        seen.gone = now.is_none() && seen.version.is_some();
        if seen.gone && !said {
            let path = access.file().display();
            tracing::warn!("{path} is not there, or cannot be reached: users and tokens stay as they were");
        }
        let fault = self.audit.as_ref().and_then(|audit| audit.fault());
        if seen.version == now && !anyway && (!seen.waits || fault.is_some()) {
            return Ok(());
        }
        let Some(book) = read(access.file(), now, seen.version)? else { return Ok(()) };
        // Only now: one that could not be read is read again.
        seen.version = now;
        tracing::info!(users = book.users.len(), tokens = book.tokens.len(), "users and tokens read again");
        let in_force = access.book();
        let mut taken = if fault.is_some() { book.no_more_than(&in_force) } else { book.clone() };
        if !self.put_on_record(in_force.differences(&taken)) {
            // A token that is revoked ends all the same.
            taken = taken.no_more_than(&in_force);
        }
        seen.waits = taken != book;
        if seen.waits {
            for what in taken.differences(&book) {
                tracing::warn!(what, "this change of who may come in waits for an audit log that works");
            }
        }
        access.replace(taken);
        Ok(())
    }

    /// Puts changes of who may come in on record; false when one of them cannot be.
    fn put_on_record(&self, changes: Vec<String>) -> bool {
        let mut all = true;
        for what in changes {
            tracing::info!(what, "who may come in has changed");
            if let Some(audit) = &self.audit
                && !audit.put(self.clock.now(), "access", vec![("what", what.clone())])
            {
                tracing::error!(what, "this change of who may come in is not on record");
                all = false;
            }
        }
        all
    }
}

/// What is to be said of a failure: nothing while it is the one that was said last, or the log would have it every second.
fn news(said: &mut Option<String>, failed: Option<String>) -> Option<String> {
    let is_new = *said != failed;
    said.clone_from(&failed);
    failed.filter(|_| is_new)
}

/// The book of a file whose version is `now`. None where another was in force and there is none: it is being replaced, or out
/// of reach, and says of nobody that they may not come in.
fn read(path: &Path, now: Option<Version>, in_force: Option<Version>) -> Result<Option<Book>, FileError> {
    match (now, in_force) {
        (Some(_), _) => file::load(path).map(Some),
        (None, Some(_)) => Ok(None),
        (None, None) => book(path).map(Some),
    }
}

/// The book; an empty one, that lets nobody in, where there is none yet.
fn book(path: &Path) -> Result<Book, FileError> {
    // What cannot be reached may be there.
    if path.try_exists().map_err(|source| FileError::Io { path: path.to_path_buf(), source })? {
        return file::load(path);
    }
    let path = path.display();
    tracing::warn!(
        "{path} is not there, so nobody can log in: make it by stictiond user add --config FILE NAME"
    );
    Ok(Book::default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{Cost, PasswordHash, Role, Roles};
    use std::fs;

    fn add(path: &Path, name: &str) {
        let hash = PasswordHash::of("a word", [3; 16], Cost { memory_kib: 8, passes: 1 }).expect("a cost");
        let added = file::change(path, |book| {
            book.add_user(name, Roles::of(&[Role::Operator]), hash).expect("added");
            Ok::<_, FileError>(())
        });
        added.expect("written");
    }

    fn security(file: &Path) -> Result<Security, AppError> {
        let access = toml::from_str(&format!("file = {file:?}")).expect("it is right");
        Security::new(&Config { access: Some(access), ..Config::default() }, Clock::wall(), None)
    }

    #[test]
    fn a_book_that_is_away_for_a_moment_logs_nobody_out() {
        let folder = std::env::temp_dir().join(format!("stictiond-book-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("writable");
        let (path, away) = (folder.join("users.json"), folder.join("away.json"));
        let security = security(&path).expect("there is none yet");
        let look = |reload: bool| {
            let looked = if reload { security.reload() } else { security.look_again(false) };
            looked.expect("it goes on");
            security.access.as_ref().map_or(0, |access| access.book().users.len())
        };
        assert_eq!((look(false), look(true)), (0, 0));
        add(&path, "jw");
        assert_eq!(look(false), 1);
        fs::rename(&path, &away).expect("moved");
        assert_eq!((look(false), look(true), look(false)), (1, 1, 1));
        assert!(security.seen().gone);
        fs::rename(&away, &path).expect("moved");
        assert_eq!(look(false), 1);
        assert!(!security.seen().gone, "it is said again when it happens again");
        add(&path, "kb");
        assert_eq!(look(false), 2);
        fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn a_book_that_cannot_be_read_is_said_once_each_time_it_breaks() {
        let folder = std::env::temp_dir().join(format!("stictiond-book-broken-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("writable");
        let path = folder.join("users.json");
        add(&path, "jw");
        let whole = fs::read(&path).expect("there");
        let security = security(&path).expect("it is whole");
        let mut said = None;
        let mut look = || {
            let looked = security.look_again(false);
            news(&mut said, looked.err().map(|error| error.to_string()))
        };
        assert_eq!(look(), None);
        for broken in ["{", "[]"] {
            fs::write(&path, broken).expect("writable");
            let said = look().expect("it is said");
            assert!(said.contains("users.json"), "{said}");
            assert_eq!((look(), look()), (None, None), "it is said already");
        }
        fs::write(&path, &whole).expect("writable");
        assert_eq!(look(), None);
        fs::write(&path, "[]").expect("writable");
        assert!(look().is_some(), "it is said again when it happens again");
        fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn nobody_comes_in_anew_while_the_audit_log_is_damaged() {
        let folder = std::env::temp_dir().join(format!("stictiond-book-log-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("writable");
        let (path, log) = (folder.join("users.json"), folder.join("audit.log"));
        ["jw", "kb"].iter().for_each(|name| add(&path, name));
        fs::write(&log, "no entry\n").expect("written");
        let text = |path: &Path| format!("file = {path:?}");
        let access = toml::from_str(&text(&path)).expect("it is right");
        let audit = toml::from_str(&text(&log)).expect("it is right");
        let config = Config { access: Some(access), audit: Some(audit), ..Config::default() };
        let security = Security::new(&config, Clock::wall(), None).expect("it begins all the same");
        let names = || -> Vec<String> {
            let book = security.access.as_ref().expect("there is a log-in").book();
            book.users.iter().map(|user| user.name.clone()).collect()
        };
        assert_eq!(names(), ["jw", "kb"]);
        add(&path, "new");
        let removed = file::change(&path, |book| {
            book.remove_user("jw").expect("there");
            Ok::<_, FileError>(())
        });
        removed.expect("written");
        for reload in [false, true, false] {
            let looked = if reload { security.reload() } else { security.look_again(false) };
            looked.expect("it goes on");
            assert_eq!(names(), ["kb"]);
            assert!(security.seen().waits);
        }
        drop(security);
        fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn a_book_that_cannot_be_reached_is_not_taken_for_none() {
        // A file is no folder: what is below it can neither be there nor be said not to be.
        let file = std::env::temp_dir().join(format!("stictiond-no-folder-{}", std::process::id()));
        fs::write(&file, "").expect("written");
        let found = security(&file.join("users.json"));
        assert!(matches!(found, Err(AppError::Access(FileError::Io { .. }))));
        fs::remove_file(&file).expect("removed");
    }
}
