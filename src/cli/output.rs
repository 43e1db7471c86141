//! Files that a command makes beside what it prints: a picture, a page.

use super::{Failure, print};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// What a command makes.
pub struct Kind {
    /// What its names end in.
    ends: &'static [&'static str],
    /// What it begins with, in small letters.
    begins: &'static str,
}

/// A picture.
pub const PICTURE: &Kind = &Kind { ends: &["svg"], begins: "<svg" };
/// A page.
pub const PAGE: &Kind = &Kind { ends: &["html", "htm"], begins: "<!doctype html" };

/// What a shell calls the stdout of a process.
const STDOUT: [&str; 3] = ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"];

fn is_stdout(path: &Path) -> bool {
    STDOUT.iter().any(|own| path == Path::new(own))
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}

/// Refuses before the work a file that could not be made after it, and one that is there and is something else: with `--plot *.csv` it
/// would be a record.
pub fn may_be_made(path: Option<&Path>, kind: &Kind) -> Result<(), Failure> {
    let Some(path) = path.filter(|path| !is_stdout(path)) else { return Ok(()) };
    let is_called_so =
        || path.extension().is_some_and(|own| kind.ends.iter().any(|end| own.eq_ignore_ascii_case(end)));
    if path.is_dir() {
        return Err(Failure::in_file(path, "is a folder: name the file in it"));
    }
    if !folder(path).is_dir() {
        return Err(Failure::in_file(path, "lies in a folder that is not there: make it"));
    }
    if path.is_file() && !is_called_so() && !is_empty_or(path, kind).unwrap_or(false) {
        let why = format!("is there already and is no .{}: name another file", kind.ends.join(" or ."));
        return Err(Failure::in_file(path, why));
    }
    Ok(())
}

/// Whether nothing stands in a file, as in one of `mktemp`, or what an earlier run made.
fn is_empty_or(path: &Path, kind: &Kind) -> io::Result<bool> {
    let mut first = Vec::new();
    File::open(path)?.take(kind.begins.len() as u64).read_to_end(&mut first)?;
    Ok(first.is_empty() || first.eq_ignore_ascii_case(kind.begins.as_bytes()))
}

/// Writes the whole text, or leaves what was there.
pub fn write(path: &Path, text: &str) -> Result<(), Failure> {
    if is_stdout(path) {
        // Opened by its name, a file behind it would lose what was printed.
        return print(text);
    }
    let to = behind_links(path);
    let written = match fs::metadata(&to) {
        // A device or a pipe cannot be replaced.
        Ok(about) if !about.is_file() => {
            OpenOptions::new().write(true).open(&to).and_then(|mut file| file.write_all(text.as_bytes()))
        }
        _ => replace(&to, text),
    };
    written.map_err(|error| Failure::Failed(format!("{}: {error}", path.display())))
}

/// The file that a link leads to, also where it is not there yet: the link stays.
fn behind_links(path: &Path) -> PathBuf {
    let linked = || fs::read_link(path).map(|to| folder(path).join(to));
    fs::canonicalize(path).or_else(|_| linked()).unwrap_or_else(|_| path.to_path_buf())
}

/// Writes beside a file, and puts that in its place with the rights it had.
fn replace(path: &Path, text: &str) -> io::Result<()> {
    let mut new = path.as_os_str().to_owned();
    new.push(format!(".new{}", std::process::id()));
    let new = PathBuf::from(new);
    let rights = match OpenOptions::new().write(true).open(path) {
        Ok(before) => Some(before.metadata()?.permissions()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        // Nobody is to write it.
        Err(error) => return Err(error),
    };
    let mut file = OpenOptions::new().write(true).create_new(true).open(&new)?;
    let written = rights
        .map_or(Ok(()), |rights| file.set_permissions(rights))
        .and_then(|()| file.write_all(text.as_bytes()))
        .and_then(|()| fs::rename(&new, path));
    if written.is_err() {
        // That it cannot be removed is no news beside the error itself.
        let _ = fs::remove_file(&new);
    }
    written
}
