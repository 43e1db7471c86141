//! Whether the database in the folder is the one that is open. Of a folder that was moved or deleted the files that are open take
//! everything, and no start would ever find it.

use super::super::DATABASE;
use super::{Acknowledged, Ledger, acknowledged};
use crate::store::StoreError;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

impl Acknowledged {
    /// What tells it apart from any other.
    fn sum(self) -> u32 {
        // The checksum of bytes with their own behind them is always the same.
        crc32fast::hash(&self.to_bytes()[..Self::BYTES - 4])
    }
}

/// What the ledger in a folder says, as a checksum; `None` where there is none that can be read.
pub(in crate::store) fn ledger_in(folder: &Path) -> Option<u32> {
    acknowledged(folder).ok().flatten().map(Acknowledged::sum)
}

impl Ledger {
    /// Looks whether the database in the folder is the one that is open.
    ///
    /// # Errors
    /// [`StoreError::Gone`], [`StoreError::Io`].
    pub fn is_there(&self) -> Result<(), StoreError> {
        let path = self.folder.join(DATABASE);
        let own = self.database.metadata().map_err(StoreError::io(&path))?;
        match fs::metadata(&path) {
            Ok(there) if (there.dev(), there.ino()) == (own.dev(), own.ino()) => Ok(()),
            // A file system over a network may number its files anew.
            Ok(_) if acknowledged(&self.folder)? == Some(self.now) => Ok(()),
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(StoreError::io(&path)(error)),
            _ => Err(StoreError::Gone { path, ledger: self.now.sum() }),
        }
    }
}
