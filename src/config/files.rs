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
    fn numbers_of_errors_are_left_out() {
        let said = "a: No such file or directory (os error 2); b: Permission denied (os error 13)";
        assert_eq!(without_number(said), "a: No such file or directory; b: Permission denied");
        assert_eq!(without_number("(os error 2"), "(os error 2");
        assert_eq!(in_words(&io::Error::other("odd")), "odd");
    }
}
