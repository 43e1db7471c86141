//! Reads and writes the file of users and tokens. It is replaced as a whole, by its owner only readable; whoever changes it
//! holds a lock, so that two commands at once do not lose each other's work.

use super::book::{Book, Token, User};
use super::role::{Role, Roles};
use super::secret::{Cost, PasswordHash, hex, random, unhex};
use serde::{Deserialize, Serialize};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};

/// Largest file read (bytes).
const MAX_BYTES: u64 = 1 << 24;
/// The layout of the file.
const VERSION: u32 = 1;

/// Why users and tokens cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It cannot be opened, read, written or replaced.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Others may read or write it.
    #[error("{}: others than its owner may read or change it (mode {mode:03o}): chmod 600 it", path.display())]
    Open {
        /// Which file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// It is not what was written.
    #[error("{}: {what}", path.display())]
    Broken {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Another command works on it.
    #[error("{}: another command is changing it; try again", .0.display())]
    Busy(PathBuf),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Whole {
    version: u32,
    users: Vec<OneUser>,
    tokens: Vec<OneToken>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OneUser {
    name: String,
    roles: Vec<String>,
    argon2id_memory_kib: u32,
    argon2id_passes: u32,
    salt: String,
    hash: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OneToken {
    id: String,
    name: String,
    roles: Vec<String>,
    sha256: String,
    created_s: f64,
    expires_s: f64,
}

/// What tells one version of a file from the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Version {
    inode: u64,
    size: u64,
    changed: (i64, i64),
}

/// The version that is there; `None` when there is none.
pub fn version(path: &Path) -> Option<Version> {
    let meta = fs::metadata(path).ok()?;
    Some(Version { inode: meta.ino(), size: meta.len(), changed: (meta.ctime(), meta.ctime_nsec()) })
}

/// Reads it.
///
/// # Errors
/// [`FileError`]; also when others than its owner may read it.
pub fn load(path: &Path) -> Result<Book, FileError> {
    let io = |source| FileError::Io { path: path.to_path_buf(), source };
    let file = File::open(path).map_err(io)?;
    let mode = file.metadata().map_err(io)?.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(FileError::Open { path: path.to_path_buf(), mode });
    }
    let mut text = String::new();
    file.take(MAX_BYTES).read_to_string(&mut text).map_err(io)?;
    let broken = |what: String| FileError::Broken { path: path.to_path_buf(), what };
    let whole: Whole = serde_json::from_str(&text).map_err(|error| broken(error.to_string()))?;
    if whole.version != VERSION {
        return Err(broken(format!("is of version {}, this stictiond reads {VERSION}", whole.version)));
    }
    let users = whole.users.into_iter().map(|one| {
        let name = one.name.clone();
        one.user().ok_or_else(|| broken(format!("user {name:?} cannot be read")))
    });
    let users = users.collect::<Result<_, _>>()?;
    let tokens = whole.tokens.into_iter().map(|one| {
        let id = one.id.clone();
        one.token().ok_or_else(|| broken(format!("token {id:?} cannot be read")))
    });
    Ok(Book { users, tokens: tokens.collect::<Result<_, _>>()? })
}

/// Changes it under a lock; a file that is not there yet is an empty book. What `change` refuses changes nothing.
///
/// # Errors
/// [`FileError`], and what `change` says.
pub fn change<T, E: From<FileError>>(
    path: &Path,
    change: impl FnOnce(&mut Book) -> Result<T, E>,
) -> Result<T, E> {
    let beside = |suffix: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        PathBuf::from(name)
    };
    let lock_path = beside(".lock");
    let lock = private().create(true).truncate(false).open(&lock_path);
    let lock = lock.map_err(|source| FileError::Io { path: lock_path, source })?;
    lock.try_lock().map_err(|_| FileError::Busy(path.to_path_buf()))?;
    let mut book = if path.exists() { load(path)? } else { Book::default() };
    let done = change(&mut book)?;
    let suffix = random::<8>().map(|bytes| hex(&bytes)).unwrap_or_default();
    let new = beside(&format!(".new{suffix}"));
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let written = write(&new, &book)
        .and_then(|file| keep_owner(&file, path, folder))
        .and_then(|()| fs::rename(&new, path))
        .and_then(|()| File::open(folder)?.sync_all());
    if let Err(source) = written {
        // What could not be put in place is of no use to anybody.
        let _ = fs::remove_file(&new);
        return Err(FileError::Io { path: path.to_path_buf(), source }.into());
    }
    Ok(done)
}

/// Gives the new file the owner of the old one, a first file that of its folder: made by root, the daemon must still be
/// able to read it. It is the file that changes its owner, whatever its name stands for by then: the folder may be another user's.
fn keep_owner(new: &File, old: &Path, folder: &Path) -> io::Result<()> {
    let (own, before) = (new.metadata()?, fs::metadata(old));
    let wanted = before.as_ref().map_or_else(|_| fs::metadata(folder), |meta| Ok(meta.clone()))?;
    if (own.uid(), own.gid()) == (wanted.uid(), wanted.gid()) {
        return Ok(());
    }
    let changed = fchown(new, Some(wanted.uid()), Some(wanted.gid()));
    // A first file in somebody else's folder is of who makes it, unless that is root.
    if before.is_ok() { changed } else { Ok(()) }
}

/// For the owner only. No link is followed, and nobody waits for what is no file: root would make files anywhere, or hang.
fn private() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.write(true).mode(0o600).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK);
    options
}

fn write(path: &Path, book: &Book) -> io::Result<File> {
    let whole = Whole {
        version: VERSION,
        users: book.users.iter().map(OneUser::from).collect(),
        tokens: book.tokens.iter().map(OneToken::from).collect(),
    };
    let mut text = serde_json::to_vec_pretty(&whole)?;
    text.push(b'\n');
    let mut file = private().create_new(true).open(path)?;
    file.write_all(&text)?;
    file.sync_all()?;
    Ok(file)
}

fn names(roles: &Roles) -> Vec<String> {
    roles.iter().map(|role| role.to_string()).collect()
}

fn roles(names: &[String]) -> Option<Roles> {
    let roles: Option<Vec<Role>> = names.iter().map(|name| name.parse().ok()).collect();
    roles.map(|roles| Roles::of(&roles)).filter(|roles| !roles.is_empty())
}

impl OneUser {
    fn user(self) -> Option<User> {
        let cost = Cost { memory_kib: self.argon2id_memory_kib, passes: self.argon2id_passes };
        let password = PasswordHash { cost, salt: unhex(&self.salt)?, hash: unhex(&self.hash)? };
        let good = super::is_name(&self.name) && cost.memory_kib <= 1 << 20 && cost.passes <= 100;
        good.then_some(User { roles: roles(&self.roles)?, name: self.name, password })
    }
}

impl From<&User> for OneUser {
    fn from(user: &User) -> Self {
        Self {
            name: user.name.clone(),
            roles: names(&user.roles),
            argon2id_memory_kib: user.password.cost.memory_kib,
            argon2id_passes: user.password.cost.passes,
            salt: hex(&user.password.salt),
            hash: hex(&user.password.hash),
        }
    }
}

impl OneToken {
    fn token(self) -> Option<Token> {
        let good = super::is_name(&self.name) && self.created_s.is_finite() && self.expires_s.is_finite();
        good.then_some(Token {
            roles: roles(&self.roles)?,
            hash: unhex(&self.sha256)?,
            id: self.id,
            name: self.name,
            created: self.created_s,
            expires: self.expires_s,
        })
    }
}

impl From<&Token> for OneToken {
    fn from(token: &Token) -> Self {
        Self {
            id: token.id.clone(),
            name: token.name.clone(),
            roles: names(&token.roles),
            sha256: hex(&token.hash),
            created_s: token.created,
            expires_s: token.expires,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{chown, symlink};

    fn place(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("stictiond-access-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let path = folder.join(name);
        let _ = fs::remove_file(&path);
        path
    }

    fn add(path: &Path, name: &str) -> Result<(), FileError> {
        let cost = Cost { memory_kib: 8, passes: 1 };
        let hash = PasswordHash::of("a secret word", [3; 16], cost).expect("a cost");
        change(path, |book| {
            book.add_user(name, Roles::of(&[Role::Operator, Role::Engineer]), hash).expect("added");
            book.create_token(name, Roles::of(&[Role::Viewer]), (0.0, 1e9), [7; 38]).expect("made");
            Ok::<_, FileError>(())
        })
    }

    #[test]
    fn what_is_written_is_read_and_only_the_owner_may() {
        let path = place("users.json");
        add(&path, "jw").expect("written");
        let before = version(&path);
        add(&path, "kb").expect("written");
        assert_ne!(before, version(&path));
        let book = load(&path).expect("read");
        let names: Vec<&str> = book.users.iter().map(|user| user.name.as_str()).collect();
        assert_eq!((names, book.tokens.len()), (vec!["jw", "kb"], 2));
        assert!(book.user("jw").expect("there").password.is("a secret word"));
        let text = fs::read_to_string(&path).expect("read");
        assert!(!text.contains("a secret word") && !text.contains(&"07".repeat(32)), "no secret is kept");
        let mode = |mode| fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("set");
        assert_eq!(fs::metadata(&path).expect("there").mode() & 0o777, 0o600);
        for open in [0o640, 0o604, 0o620] {
            mode(open);
            assert!(matches!(load(&path), Err(FileError::Open { .. })), "{open:o}");
        }
        mode(0o600);
        assert_eq!(load(&path).expect("read"), book);
    }

    #[test]
    fn what_another_user_makes_of_a_name_is_not_followed() {
        let (path, lock, victim) = (place("linked.json"), place("linked.json.lock"), place("victim"));
        symlink(&victim, &lock).expect("linked");
        assert!(add(&path, "jw").is_err() && !victim.exists(), "nothing is made where a link leads");
        fs::remove_file(&lock).expect("removed");
        add(&path, "jw").expect("written");

        // Between its making and its change of owner the new file's name becomes a link.
        let new = place("linked.json.new");
        let file = write(&new, &Book::default()).expect("written");
        fs::write(&victim, "").expect("written");
        let before = fs::metadata(&victim).expect("there");
        fs::remove_file(&new).expect("removed");
        symlink(&victim, &new).expect("linked");
        // Where this is not allowed, both have one owner.
        let _ = chown(&path, Some(65_532), Some(65_532));
        keep_owner(&file, &path, &std::env::temp_dir()).expect("changed");
        let (own, wanted) = (file.metadata().expect("open"), fs::metadata(&path).expect("there"));
        assert_eq!((own.uid(), own.gid()), (wanted.uid(), wanted.gid()));
        let after = fs::metadata(&victim).expect("there");
        assert_eq!(
            (after.uid(), after.gid()),
            (before.uid(), before.gid()),
            "another file got another owner"
        );
    }

    #[test]
    fn a_refused_change_changes_nothing_and_a_broken_file_is_named() {
        let path = place("refused.json");
        add(&path, "jw").expect("written");
        let before = fs::read(&path).expect("read");
        let refused: Result<(), FileError> = change(&path, |book| {
            book.users.clear();
            Err(FileError::Busy(PathBuf::new()))
        });
        assert!(refused.is_err() && fs::read(&path).expect("read") == before);
        for broken in ["", "{}", "{\"version\": 9, \"users\": [], \"tokens\": []}", "[1]"] {
            fs::write(&path, broken).expect("written");
            let said = load(&path).expect_err("broken").to_string();
            assert!(said.starts_with(&path.display().to_string()), "{said}");
            assert!(add(&path, "kb").is_err(), "a broken file is never written over");
        }
    }
}
