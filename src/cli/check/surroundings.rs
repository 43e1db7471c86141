//! What `run` needs beside the configuration: audit logs that it can go on with, a folder for the store, secrets. Nothing is
//! changed, and whatever is made to find out is gone at once.

use std::ffi::OsString;
use std::fs::{self, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use stictiond::audit;
use stictiond::config::{Config, without_number};

/// The audit logs that `run` would go on with, or begin, and the keys that name them.
fn logs(config: &Config) -> impl Iterator<Item = (&'static str, &PathBuf)> {
    let changes = config.audit.as_ref().map(|own| ("[audit] file", &own.file));
    let writes = config.loops.iter().any(|own| own.writeback.as_ref().is_some_and(|own| own.enabled));
    let terms = config.writeback.audit_file.as_ref().filter(|_| writes);
    let terms = terms.map(|file| ("[writeback] audit_file", file));
    // Where a log's folder is not there, the configuration says so itself.
    changes.into_iter().chain(terms).filter(|(_, file)| !file.is_dir() && folder_of(file).is_dir())
}

/// Why `run` could not write its audit logs, so that it would not start.
pub fn unwritable_logs(config: &Config) -> Vec<String> {
    let told = |(key, file): (&str, &PathBuf)| Some(format!("{key}: {}", unwritable(file)?));
    logs(config).filter_map(told).collect()
}

fn unwritable(file: &Path) -> Option<String> {
    let told = |path: &Path, error: io::Error| {
        let (why, remedy) = (without_number(&error.to_string()), audit::remedy(file, &error));
        format!("{} cannot be written by the user that runs check: {why}{remedy}", path.display())
    };
    let cannot = |path: &Path| Some(told(path, try_to_write(path).err()?));
    // A log that is full is moved, and the next one made. A disk that is full keeps no log from going on.
    let folder = || {
        let error = try_to_make(folder_of(file)).err();
        Some(told(folder_of(file), error.filter(|error| !audit::remedy(file, error).is_empty())?))
    };
    cannot(file).or_else(|| cannot(&beside(file, ".head"))).or_else(folder)
}

/// What was changed in the audit logs, so that `run` would refuse what needs an entry in them.
pub fn damaged_logs(config: &Config) -> Vec<String> {
    let told = |(key, file): (&str, &PathBuf)| Some(format!("{key}: {}", damage(file)?));
    logs(config).filter_map(told).collect()
}

fn damage(file: &Path) -> Option<String> {
    let has_lines = |path: &Path| fs::metadata(path).is_ok_and(|about| about.len() > 0);
    // Where only a head says that there were lines, they are missing.
    if ["", ".1", ".head"].iter().all(|end| !has_lines(&beside(file, end))) {
        return None;
    }
    let broken = audit::verify(file).err()?;
    (broken.path != file || !is_torn(file, broken.line)).then(|| broken.to_string())
}

/// Whether a line is the last one and has no end: a crash cut it off, and `run` takes it out.
fn is_torn(file: &Path, line: usize) -> bool {
    let bytes = fs::read(file).unwrap_or_default();
    let lines = bytes.split_inclusive(|&byte| byte == b'\n');
    bytes.last().is_some_and(|&byte| byte != b'\n') && lines.count() == line
}

/// Whether a file that is there can be opened for writing, and one that is not can be made.
fn try_to_write(path: &Path) -> io::Result<()> {
    match path.exists() {
        true => OpenOptions::new().append(true).open(path).map(drop),
        false => try_to_make(folder_of(path)),
    }
}

/// Makes a file in a folder and removes it: rights alone do not tell of a disk that can only be read.
fn try_to_make(folder: &Path) -> io::Result<()> {
    let path = folder.join(format!(".stictiond-check-{:016x}", getrandom::u64().unwrap_or_default()));
    OpenOptions::new().write(true).create_new(true).open(&path)?;
    fs::remove_file(path)
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}

fn beside(file: &Path, suffix: &str) -> PathBuf {
    let mut name: OsString = file.into();
    name.push(suffix);
    name.into()
}

/// What may be otherwise where stictiond starts, and what would fail if it is not.
pub fn remarks(config: &Config) -> Vec<String> {
    let unset = |(whose, key, name): (&str, &str, &String)| {
        let is_set = std::env::var_os(name).is_some_and(|value| !value.is_empty());
        (!is_set)
            .then(|| format!("{whose}: {key} = {name:?} is not set here; it must be where stictiond starts"))
    };
    let store = config.store.as_ref().and_then(|own| {
        // It is made where it is not there: then the nearest folder above it counts.
        let here =
            |path: &'_ Path| if path.as_os_str().is_empty() { PathBuf::from(".") } else { path.into() };
        let there =
            own.folder.ancestors().map(here).find(|path| path.exists()).filter(|path| path.is_dir())?;
        let error = try_to_make(&there).err()?;
        let (folder, why) = (own.folder.display().to_string(), without_number(&error.to_string()));
        Some(format!("[store] folder = {folder:?} cannot be written by the user that runs check: {why}"))
    });
    variables(config).into_iter().filter_map(unset).chain(store).collect()
}

/// Environment variables that hold secrets: whose, by which key, and which.
fn variables(config: &Config) -> Vec<(&str, &'static str, &String)> {
    let notify = &config.notify;
    let opcua = config.opcua.iter().map(|own| (own.name.as_str(), &own.password_env));
    let mqtt = config.mqtt.iter().map(|own| (own.name.as_str(), &own.password_env));
    let store = config.store.iter().map(|own| ("[store]", &own.password_env));
    let publisher = notify.mqtt.iter().map(|own| ("[notify.mqtt]", &own.password_env));
    let alertmanagers = notify.alertmanager.iter().map(|own| (own.name.as_str(), &own.password_env));
    let mails = notify.smtp.iter().map(|own| (own.name.as_str(), &own.password_env));
    let passwords = opcua.chain(mqtt).chain(store).chain(publisher).chain(alertmanagers).chain(mails);
    let passwords = passwords.filter_map(|(whose, name)| Some((whose, "password_env", name.as_ref()?)));
    let secrets = notify.webhook.iter();
    let secrets = secrets.filter_map(|own| Some((own.name.as_str(), "secret_env", own.secret_env.as_ref()?)));
    passwords.chain(secrets).collect()
}
