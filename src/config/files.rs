//! Files that a configuration names: whether they are there, and why one cannot be read, in words.

use super::Config;
use std::io;
use std::path::{Path, PathBuf};

impl Config {
    /// What is named and not there. It is read when it is needed, so that it may still come; until then its part fails.
    pub fn missing_files(&self) -> Vec<String> {
        let there = |path: &Path| path.try_exists().unwrap_or(true);
        let told = |(whose, key, path): &(String, &str, Option<PathBuf>)| {
            let path = path.as_deref().filter(|path| !there(path))?;
            Some(told(whose, key, path))
        };
        self.files().iter().filter_map(told).collect()
    }

    /// Why `run` could not write its audit logs, so that it would not start.
    pub fn unwritable(&self) -> Vec<String> {
        let changes = self.audit.as_ref().map(|own| ("[audit] file", &own.file));
        // Without a loop that is enabled nothing is written there.
        let writes = self.loops.iter().any(|own| own.writeback.as_ref().is_some_and(|own| own.enabled));
        let terms = self.writeback.audit_file.as_ref().filter(|_| writes);
        let terms = terms.map(|file| ("[writeback] audit_file", file));
        let told = |(key, file): (&str, &PathBuf)| {
            let why = match file.parent().filter(|folder| *folder != Path::new("")) {
                _ if file.is_dir() => "is a folder: name the file in it",
                Some(folder) if !folder.is_dir() => "lies in a folder that is not there: make it",
                _ => return None,
            };
            Some(format!("{key} = {:?} {why}", file.display().to_string()))
        };
        changes.into_iter().chain(terms).filter_map(told).collect()
    }

    /// Why the store could not be made, so that nothing would outlive a restart.
    pub fn no_store(&self) -> Option<String> {
        let folder = &self.store.as_ref()?.folder;
        let text = folder.display().to_string();
        let there = folder.ancestors().find(|path| *path != Path::new("") && path.exists());
        let why = match there {
            _ if text.starts_with('~') || text.contains('$') => "is taken as it is: write the whole path",
            _ if text.contains('\\') => "has backslashes, which are no path here: write one with /",
            Some(there) if !there.is_dir() && there == folder => "is a file: name a folder",
            Some(there) if !there.is_dir() => "lies below a file: name another folder",
            _ => return None,
        };
        Some(format!("[store] folder = {text:?} {why}; nothing would outlive a restart"))
    }

    /// Whose, by which key, and where.
    pub fn files(&self) -> Vec<(String, &'static str, Option<PathBuf>)> {
        let mut all = Vec::new();
        let mut add = |whose: &str, files: &[(&'static str, &Option<PathBuf>)]| {
            all.extend(files.iter().map(|(key, path)| (whose.to_string(), *key, (*path).clone())));
        };
        for own in &self.opcua {
            let secured = own.security_policy != crate::collect::opcua::SecurityPolicy::None;
            let pki = own.pki_dir.clone().filter(|_| secured);
            let user = [("user_certificate", &own.user_certificate), ("user_key", &own.user_key)];
            let files = [("pki_dir", &pki), ("password_file", &own.password_file), user[0], user[1]];
            add(&own.name, &files);
        }
        for own in &self.mqtt {
            let tls = [("certificate_file", &own.certificate_file), ("key_file", &own.key_file)];
            add(&own.name, &[("ca_file", &own.ca_file), ("password_file", &own.password_file)]);
            add(&own.name, &tls);
        }
        if let Some(own) = &self.notify.mqtt {
            let tls = [("certificate_file", &own.certificate_file), ("key_file", &own.key_file)];
            add("[notify.mqtt]", &[("ca_file", &own.ca_file), ("password_file", &own.password_file)]);
            add("[notify.mqtt]", &tls);
        }
        for own in &self.notify.webhook {
            add(&own.name, &[("ca_file", &own.ca_file), ("secret_file", &own.secret_file)]);
        }
        for own in &self.notify.alertmanager {
            add(&own.name, &[("ca_file", &own.ca_file), ("password_file", &own.password_file)]);
        }
        for own in &self.notify.smtp {
            add(&own.name, &[("ca_file", &own.ca_file), ("password_file", &own.password_file)]);
        }
        if let Some(own) = &self.store {
            add("[store]", &[("ca_file", &own.ca_file), ("password_file", &own.password_file)]);
        }
        if let Some(own) = &self.fleet {
            let login = [("credentials_file", &own.credentials_file), ("nkey_file", &own.nkey_file)];
            let tls = [("certificate_file", &own.certificate_file), ("key_file", &own.key_file)];
            add("[fleet]", &login);
            add("[fleet]", &[("ca_file", &own.ca_file), ("password_file", &own.password_file)]);
            add("[fleet]", &tls);
        }
        add("[tables]", &[("folder", &self.tables.folder)]);
        all
    }
}

fn told(whose: &str, key: &str, path: &Path) -> String {
    let from = match path.is_relative() {
        true => "; it is looked for from the folder in which stictiond starts",
        false => "",
    };
    format!(
        "{whose}: {key} = {:?} is not there: make it, or correct the path{from}",
        path.display().to_string()
    )
}

/// Why a file cannot be read, in words and with what to do.
pub fn in_words(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::NotFound => "No such file: look at the path and at the folder it is read from".into(),
        io::ErrorKind::PermissionDenied => {
            "Permission denied: let the user that runs stictiond read it".into()
        }
        io::ErrorKind::IsADirectory => "Is a directory: name the file in it".into(),
        _ => without_number(&error.to_string()),
    }
}

/// A message without the numbers that the operating system gives its errors.
pub fn without_number(message: &str) -> String {
    let mut out = message.to_string();
    while let Some(begin) = out.find(" (os error ") {
        let Some(length) = out[begin..].find(')') else { break };
        out.replace_range(begin..=begin + length, "");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_run_could_not_write_is_known_before() {
        let folder = std::env::temp_dir().join(format!("stictiond-files-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("writable");
        let file = folder.join("file");
        std::fs::write(&file, "").expect("writable");
        let config = |text: String| super::super::parse("f", &text).expect("right");
        let a_loop = "[[mqtt]]\nname = \"b\"\naddress = \"h:1\"\n[[loop]]\nid = \"A\"\n\
                      op = { device = \"b\", topic = \"o\" }\npv = { device = \"b\", topic = \"p\" }\n";
        let audit = |path: &Path| config(format!("[audit]\nfile = {path:?}\n{a_loop}")).unwritable();
        let store = |path: &Path| config(format!("[store]\nfolder = {path:?}\n{a_loop}")).no_store();
        assert_eq!(audit(&folder.join("audit.log")), Vec::<String>::new());
        assert_eq!(store(&folder.join("new/store")), None);
        for (told, why) in [
            (audit(&folder).pop(), "is a folder"),
            (audit(&folder.join("none/audit.log")).pop(), "is not there"),
            (store(&file), "is a file"),
            (store(&file.join("store")), "below a file"),
            (store(Path::new("~/store")), "whole path"),
        ] {
            assert!(told.as_ref().is_some_and(|told| told.contains(why)), "{told:?}: {why}");
        }
        let same = format!("[access]\nfile = {file:?}\n[audit]\nfile = {file:?}\n{a_loop}");
        let same = super::super::parse("f", &same).expect_err("one file for both").remove(0).to_string();
        assert!(same.contains("is the file of [access] too"), "{same}");
        std::fs::remove_dir_all(&folder).expect("ours");
    }

    #[test]
    fn numbers_of_errors_are_left_out() {
        let said = "a: No such file or directory (os error 2); b: Permission denied (os error 13)";
        assert_eq!(without_number(said), "a: No such file or directory; b: Permission denied");
        assert_eq!(without_number("(os error 2"), "(os error 2");
        assert_eq!(in_words(&io::Error::other("odd")), "odd");
    }
}
