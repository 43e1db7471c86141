//! Whose the folder of a log is, and as which user this process runs: what helps where the system refuses a file of the log.

use super::AuditError;
use std::fs::{self, OpenOptions};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// The rights of a mode; the other bits say what kind of file it is.
const RIGHTS: u32 = 0o7777;

/// What helps where a file of a log cannot be opened, made or moved, to stand behind the system's own words: the folder, its owner,
/// the user of this process and the remedy. Empty where rights and folder are not the cause.
pub fn remedy(path: &Path, error: &io::Error) -> String {
    let folder = folder_of(path);
    let shown = folder.display();
    let own = own_uid();
    let user = own.map_or_else(|| "the user that has started it".to_string(), named);
    match error.kind() {
        io::ErrorKind::PermissionDenied => {
            let chown = own.map_or_else(|| "USER".to_string(), |own| own.to_string());
            let of_file = owner(path).map(|owner| format!(", the file to {owner}")).unwrap_or_default();
            let of_folder = owner(folder).unwrap_or_else(|| "an unknown user".to_string());
            format!(
                "; a log's files are made and moved in their folder: the folder {shown} belongs to {of_folder}{of_file}, and \
                 stictiond runs as {user}; name a log in a folder of that user, or, where the folder is the log's alone, give it to \
                 that user by `chown -R {chown} {shown}`"
            )
        }
        io::ErrorKind::ReadOnlyFilesystem => format!(
            "; the folder {shown} is read-only for stictiond, which runs as {user}, perhaps by its systemd unit: name a log in the \
             unit's StateDirectory, or in another folder of that user"
        ),
        io::ErrorKind::NotFound if !folder.is_dir() => {
            format!(
                "; the folder {shown} is not there: make it, as a folder of {user}, as whom stictiond runs"
            )
        }
        _ => String::new(),
    }
}

/// Whether files can be made in the folder of a log: one that is full is moved there, long after the start. What is made is gone at
/// once. A disk that is full is no matter of rights, and keeps no log from going on.
///
/// # Errors
/// [`AuditError::Io`], where the rights are missing.
pub(super) fn try_folder(path: &Path) -> Result<(), AuditError> {
    let name = format!(".stictiond-audit-{:016x}", getrandom::u64().unwrap_or_default());
    let made = folder_of(path).join(name);
    let opened = OpenOptions::new().write(true).create_new(true).open(&made);
    match opened.and_then(|_| fs::remove_file(&made)) {
        Err(source) if !remedy(path, &source).is_empty() => {
            Err(AuditError::Io { path: path.to_path_buf(), source })
        }
        _ => Ok(()),
    }
}

pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}

/// Whose a file or folder is, and who may do what with it; `None` where there is none.
fn owner(path: &Path) -> Option<String> {
    let about = fs::metadata(path).ok()?;
    Some(format!("{}, mode {:03o}", named(about.uid()), about.mode() & RIGHTS))
}

/// A user by name and number, or by number alone: one that systemd makes for a unit is in no file.
fn named(uid: u32) -> String {
    let users = fs::read_to_string("/etc/passwd").unwrap_or_default();
    name_of(&users, uid).map_or_else(|| format!("uid {uid}"), |name| format!("{name} (uid {uid})"))
}

/// The name of a user in the lines of `/etc/passwd`.
fn name_of(users: &str, uid: u32) -> Option<&str> {
    let wanted = uid.to_string();
    users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let (name, _password, own) = (fields.next()?, fields.next()?, fields.next()?);
        (own == wanted).then_some(name)
    })
}

/// By which user's rights this process opens files; `None` where the system does not say.
fn own_uid() -> Option<u32> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let ids = status.lines().find_map(|line| line.strip_prefix("Uid:"))?;
    // The real, the effective, the saved one and that of the file system.
    ids.split_whitespace().nth(1)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_has_the_name_of_its_number() {
        let users = "root:x:0:0:root:/root:/bin/sh\nodd\nstictiond:x:998:10:::\n";
        assert_eq!(name_of(users, 998), Some("stictiond"));
        assert_eq!((name_of(users, 0), name_of(users, 10), name_of(users, 99)), (Some("root"), None, None));
    }

    #[test]
    fn what_is_refused_is_told_with_folder_user_and_remedy() {
        let folder = std::env::temp_dir().join(format!("stictiond-rights-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("the temporary folder is writable");
        let (file, own) = (folder.join("audit.log"), fs::metadata(&folder).expect("there").uid());
        let told = |path: &Path, kind: io::ErrorKind| remedy(path, &kind.into());
        let shown = folder.display();
        let refused = told(&file, io::ErrorKind::PermissionDenied);
        let whose = format!("the folder {shown} belongs to {}, mode ", named(own));
        assert!(refused.contains(&whose) && !refused.contains("the file to"), "{refused}");
        assert!(refused.contains(&format!("runs as {};", named(own))), "{refused}");
        assert!(refused.contains(&format!("`chown -R {own} {shown}`")), "{refused}");
        fs::write(&file, "").expect("writable");
        let refused = told(&file, io::ErrorKind::PermissionDenied);
        assert!(refused.contains(&format!(", the file to {}, mode ", named(own))), "{refused}");
        let missing = told(&folder.join("none/audit.log"), io::ErrorKind::NotFound);
        assert!(missing.contains(&format!("{shown}/none is not there: make it")), "{missing}");
        let read_only = told(&file, io::ErrorKind::ReadOnlyFilesystem);
        assert!(read_only.contains(&format!("the folder {shown} is read-only")), "{read_only}");
        assert_eq!(told(&file, io::ErrorKind::NotFound), "", "the folder is there");
        assert_eq!(told(&file, io::ErrorKind::StorageFull), "");
        fs::remove_dir_all(&folder).expect("ours");
    }

    #[test]
    fn a_folder_in_which_no_file_can_be_made_is_known_at_the_start() {
        let folder = std::env::temp_dir().join(format!("stictiond-rights-try-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("the temporary folder is writable");
        try_folder(&folder.join("audit.log")).expect("writable");
        assert_eq!(fs::read_dir(&folder).expect("there").count(), 0, "nothing is left behind");
        fs::remove_dir_all(&folder).expect("ours");
        // There no file can be made, whoever asks.
        let refused = try_folder(Path::new("/sys/audit.log")).expect_err("it is refused").to_string();
        assert!(refused.starts_with("audit log /sys/audit.log: "), "{refused}");
        assert!(refused.contains("the folder /sys ") && refused.contains("as "), "{refused}");
    }
}
