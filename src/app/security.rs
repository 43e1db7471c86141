//! Wires who may come in: the book of users and tokens, certificates, and the log of changes.

use super::AppError;
use crate::access::file::{self, Version};
use crate::access::{Access, Book, FileError};
use crate::audit::Recorder;
use crate::config::Config;
use crate::schedule::Clock;
use crate::serve::Tls;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
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
    /// Of the book that is in force, or was refused.
    seen: Mutex<Option<Version>>,
}

impl Security {
    /// Opens what `[access]`, `[audit]` and `[server.tls]` name; changes go to `other` where there is no `[audit]`.
    pub(super) fn new(config: &Config, clock: Clock, other: Option<Arc<Recorder>>) -> Result<Self, AppError> {
        let tls = config.server.tls.as_ref().map(Tls::load).transpose()?.map(Arc::new);
        let own = config.audit.as_ref().map(|own| Recorder::start(&own.file, own.bounds(), clock.now()));
        let audit = own.transpose()?.map(Arc::new).or(other);
        let mut seen = None;
        let access = match &config.access {
            None => None,
            Some(access) => {
                seen = file::version(&access.file);
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
            book(access.file())?;
        }
        if let Some(tls) = &self.tls {
            tls.reload()?;
            tracing::info!("certificates read again");
        }
        self.look_again(true)
    }

    /// Follows the book until `stop` is cancelled.
    pub(super) async fn run(self: Arc<Self>, stop: CancellationToken) {
        if self.access.is_none() {
            return;
        }
        while stop.run_until_cancelled(tokio::time::sleep(LOOK)).await.is_some() {
            let own = self.clone();
            match tokio::task::spawn_blocking(move || own.look_again(false)).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => tracing::error!(%error, "users and tokens stay as they were"),
                Err(error) => tracing::error!(%error, "users and tokens cannot be looked at"),
            }
        }
    }

    /// Takes the book when it is another; when it cannot be read says so once.
    fn look_again(&self, anyway: bool) -> Result<(), AppError> {
        let Some(access) = &self.access else { return Ok(()) };
        let now = file::version(access.file());
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if *seen == now && !anyway {
            return Ok(());
        }
        let book = book(access.file())?;
        // Only now: one that could not be read is read again.
        *seen = now;
        tracing::info!(users = book.users.len(), tokens = book.tokens.len(), "users and tokens read again");
        for what in access.book().differences(&book) {
            tracing::info!(what, "who may come in has changed");
            if let Some(audit) = &self.audit {
                audit.put(self.clock.now(), "access", vec![("what", what)]);
            }
        }
        access.replace(book);
        Ok(())
    }
}

/// The book; an empty one, that lets nobody in, where there is none yet.
fn book(path: &Path) -> Result<Book, FileError> {
    if path.exists() {
        return file::load(path);
    }
    let path = path.display();
    tracing::warn!(
        "{path} is not there, so nobody can log in: make it by stictiond user add --config FILE NAME"
    );
    Ok(Book::default())
}
