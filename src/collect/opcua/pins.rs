//! Which namespaces the numbers of every server meant at first. All who ask the same server share them, so that what is read live
//! and what is read of its history are the same nodes, and a collector that takes the place of another goes on with them.
//!
//! As text they can be kept over a restart: a server may number its namespaces anew while nobody asks it.

use super::names::Pins;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The first line of the text: what it is, and how it is written.
const HEAD: &str = "stictiond namespaces 1";
/// Before the checksum, in the last line.
const SUM: &str = "crc32\t";
/// The largest file that is read back (bytes).
const MOST_BYTES: u64 = 1 << 22;

/// The namespaces that plain numbers mean, of every server by its address.
#[derive(Clone, Debug, Default)]
pub struct Pinned(Arc<Mutex<BTreeMap<String, ServerPins>>>);

/// Those of one server.
#[derive(Clone, Debug, Default)]
pub(super) struct ServerPins(Arc<Mutex<Pins>>);

/// A panic elsewhere leaves the maps whole: each change to them is one call.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ServerPins {
    /// Asks them, while nobody else does.
    pub(super) fn with<T>(&self, ask: impl FnOnce(&mut Pins) -> T) -> T {
        ask(&mut lock(&self.0))
    }

    /// Numbers and their URIs.
    pub(super) fn known(&self) -> Vec<(u16, String)> {
        self.with(|pins| pins.known().map(|(number, uri)| (number, uri.to_string())).collect())
    }
}

impl Pinned {
    /// Those of the server at this address, which all who ask for them share.
    pub(super) fn of(&self, url: &str) -> ServerPins {
        lock(&self.0).entry(key(url)).or_default().clone()
    }

    /// Remembers what a number means at the server of this address, unless that is known already.
    pub fn pin(&self, url: &str, number: u16, uri: &str) {
        self.of(url).with(|pins| pins.pin(number, uri.to_string()));
    }

    /// A line for each number, and a checksum in the last.
    pub fn to_text(&self) -> String {
        let all = lock(&self.0).clone();
        let mut text = format!("{HEAD}\n");
        for (url, pins) in all {
            for (number, uri) in pins.known() {
                text += &format!("{}\t{number}\t{}\n", escaped(&url), escaped(&uri));
            }
        }
        let sum = crc32fast::hash(text.as_bytes());
        text + &format!("{SUM}{sum:08x}\n")
    }

    /// What [`Pinned::to_text`] wrote; `None` where it did not.
    pub fn of_text(text: &str) -> Option<Self> {
        let whole = text.strip_suffix('\n')?;
        let (body, last) = whole.split_at(whole.rfind('\n')? + 1);
        let sum = u32::from_str_radix(last.strip_prefix(SUM)?, 16).ok()?;
        let mut lines = body.lines();
        if sum != crc32fast::hash(body.as_bytes()) || lines.next() != Some(HEAD) {
            return None;
        }
        let pinned = Self::default();
        for line in lines {
            let (url, rest) = line.split_once('\t')?;
            let (number, uri) = rest.split_once('\t')?;
            pinned.pin(&unescaped(url), number.parse().ok()?, &unescaped(uri));
        }
        Some(pinned)
    }

    /// What was kept in a file; nothing where there is none.
    ///
    /// # Errors
    /// The file cannot be read, or is not what was written.
    pub fn read(path: &Path) -> io::Result<Self> {
        let damaged = || io::Error::new(ErrorKind::InvalidData, "it is not what was written");
        let bytes = match fs::metadata(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::default()),
            about => about?.len(),
        };
        if bytes > MOST_BYTES {
            return Err(damaged());
        }
        Self::of_text(&fs::read_to_string(path)?).ok_or_else(damaged)
    }

    /// Keeps a text of [`Pinned::to_text`] in a file, whole or not at all.
    ///
    /// # Errors
    /// The file cannot be written; then what was there stays.
    pub fn keep(text: &str, path: &Path) -> io::Result<()> {
        let new = path.with_extension("new");
        let mut file = File::create(&new)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&new, path)?;
        // A new file is lost with its folder's entry.
        match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => File::open(folder)?.sync_all(),
            _ => Ok(()),
        }
    }
}

/// An address as it is looked up: `opc.tcp://Plant:4840/` and `opc.tcp://plant:4840` are one server.
fn key(url: &str) -> String {
    url.trim_end_matches('/').to_lowercase()
}

/// A text without what divides fields and lines.
fn escaped(text: &str) -> String {
    text.replace('%', "%25").replace('\t', "%09").replace('\n', "%0A").replace('\r', "%0D")
}

fn unescaped(text: &str) -> String {
    text.replace("%09", "\t").replace("%0A", "\n").replace("%0D", "\r").replace("%25", "%")
}

#[cfg(test)]
mod tests {
    use super::super::names::{Namespaces, NodeName};
    use super::*;

    const URL: &str = "opc.tcp://plant:4840/server";

    fn spaces(own: &[&str]) -> Namespaces {
        let all = std::iter::once("http://opcfoundation.org/UA/").chain(own.iter().copied());
        Namespaces(all.map(str::to_string).collect())
    }

    fn resolve(pins: &ServerPins, namespaces: &Namespaces) -> Result<u16, String> {
        let name: NodeName = "ns=2;s=OP".parse().unwrap();
        pins.with(|pins| name.resolve(namespaces, pins)).map(|node| node.namespace)
    }

    #[test]
    fn who_asks_the_same_server_takes_a_number_for_the_same_namespace() {
        let pinned = Pinned::default();
        let (before, after) =
            (spaces(&["urn:own", "urn:a", "urn:b"]), spaces(&["urn:own", "urn:b", "urn:a"]));
        assert_eq!(resolve(&pinned.of(URL), &before), Ok(2));
        // Another reader of it, or the collector that takes the place of the first.
        for url in [URL, "opc.tcp://PLANT:4840/server/"] {
            let why = resolve(&pinned.clone().of(url), &after).expect_err("it is another node");
            assert!(why.contains("'urn:a' and is now 'urn:b'"), "{why}");
        }
        assert_eq!(resolve(&pinned.of("opc.tcp://other:4840"), &after), Ok(2), "another server");
    }

    #[test]
    fn what_was_kept_is_read_back_and_what_is_damaged_is_none() {
        let pinned = Pinned::default();
        assert_eq!(Pinned::of_text(&pinned.to_text()).map(|read| read.to_text()), Some(pinned.to_text()));
        for uri in ["urn:a", "urn:tab\tline\nreturn\rper%09cent%25", "urn:ü"] {
            pinned.pin(URL, 2 + uri.len() as u16, uri);
        }
        pinned.pin("opc.tcp://other:4840", 2, "urn:b");
        let text = pinned.to_text();
        let read = Pinned::of_text(&text).expect("it is whole");
        assert_eq!(read.of(URL).known(), pinned.of(URL).known());
        assert_eq!(read.to_text(), text);
        for damaged in [
            "".to_string(),
            text.replace("urn:a", "urn:c"),
            text.replace(":4840", ":4841"),
            text[..40].into(),
        ] {
            assert!(Pinned::of_text(&damaged).is_none(), "{damaged}");
        }
    }

    #[test]
    fn a_file_is_whole_or_refused_and_one_that_is_not_there_has_nothing() {
        let folder = std::env::temp_dir().join(format!("stictiond-pins-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("namespaces");
        assert_eq!(Pinned::read(&path).unwrap().to_text(), Pinned::default().to_text());
        let pinned = Pinned::default();
        pinned.pin(URL, 2, "urn:a");
        for _ in 0..2 {
            Pinned::keep(&pinned.to_text(), &path).unwrap();
            assert_eq!(Pinned::read(&path).unwrap().to_text(), pinned.to_text());
        }
        fs::write(&path, pinned.to_text().replace("urn:a", "urn:b")).unwrap();
        let error = Pinned::read(&path).expect_err("it was changed");
        assert!(error.to_string().contains("not what was written"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
