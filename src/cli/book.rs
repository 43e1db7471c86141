//! What `user` and `token` share: where the book of users and tokens is, and how it is changed.

use super::Failure;
use std::path::PathBuf;
use stictiond::access::file::{self, FileError};
use stictiond::access::{Book, BookError, Role, Roles, random};
use stictiond::config;
use stictiond::schedule::Clock;

/// Where the book is.
#[derive(clap::Args)]
pub struct Place {
    /// The configuration, whose [access] names the file
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// The file itself
    #[arg(long, value_name = "FILE", global = true, conflicts_with = "config")]
    access_file: Option<PathBuf>,
}

/// Why nothing was changed.
pub enum Wrong {
    /// Of the file.
    File(FileError),
    /// What was asked for.
    Asked(String),
}

impl From<FileError> for Wrong {
    fn from(error: FileError) -> Self {
        Wrong::File(error)
    }
}

impl From<BookError> for Wrong {
    fn from(error: BookError) -> Self {
        Wrong::Asked(error.to_string())
    }
}

impl From<Wrong> for Failure {
    fn from(wrong: Wrong) -> Self {
        match wrong {
            Wrong::File(error @ (FileError::Io { .. } | FileError::Busy(_))) => {
                Failure::Failed(error.to_string())
            }
            Wrong::File(error) => Failure::BadInput(error.to_string()),
            Wrong::Asked(what) => Failure::BadInput(what),
        }
    }
}

impl Place {
    fn path(&self) -> Result<PathBuf, Failure> {
        let Some(path) = &self.config else {
            let named = self.access_file.clone();
            return named.ok_or_else(|| {
                Failure::BadInput("name the file: --config FILE or --access-file FILE".into())
            });
        };
        let config = config::load(path).map_err(Failure::BadConfig)?;
        let access =
            config.access.ok_or_else(|| Failure::in_file(path, "has no [access]: there is no log-in"))?;
        Ok(access.file)
    }

    /// Where the book is, which somebody began before.
    fn existing(&self) -> Result<PathBuf, Failure> {
        let path = self.path()?;
        if path.exists() {
            return Ok(path);
        }
        Err(Failure::in_file(&path, "is not there: `stictiond user add` or `token create` makes it"))
    }

    /// Reads the book.
    pub fn read(&self) -> Result<Book, Failure> {
        file::load(&self.existing()?).map_err(|error| Wrong::File(error).into())
    }

    /// Changes what stands in the book.
    pub fn change<T>(&self, change: impl FnOnce(&mut Book) -> Result<T, Wrong>) -> Result<T, Failure> {
        Ok(file::change(&self.existing()?, change)?)
    }

    /// Adds to the book, or begins one.
    pub fn add<T>(&self, add: impl FnOnce(&mut Book) -> Result<T, Wrong>) -> Result<T, Failure> {
        Ok(file::change(&self.path()?, add)?)
    }
}

/// The roles that were named; each may be written with commas.
pub fn roles(named: &[Role]) -> Roles {
    Roles::of(named)
}

/// Seconds since the Unix epoch.
pub fn now() -> f64 {
    Clock::wall().now()
}

/// Bytes that nobody can guess.
pub fn secret<const N: usize>() -> Result<[u8; N], Wrong> {
    random().ok_or_else(|| Wrong::Asked("this machine has no randomness".to_string()))
}

/// A time as people read it.
pub fn day(t: f64) -> String {
    let stamp = jiff::Timestamp::from_second(t as i64);
    stamp.map_or_else(|_| "–".to_string(), |stamp| stamp.to_string())
}
