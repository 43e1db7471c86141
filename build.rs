//! Gives the build an identity: a digest of all that decides what a diagnosis finds. Two builds of one version of the package may
//! find something else in the same samples, so parts of a fleet compare this and not the version.
//!
//! The library's sources without its tests, the manifests with the exact versions of all dependencies, the compiler with its flags, and
//! the target: the same of these is the same identity, on any machine and without a repository.

use std::error::Error;
use std::path::Path;
use std::process::Command;
use std::{env, fs, io};

/// What of the package is no part of its library.
const LEFT_OUT: [&str; 2] = ["src/cli", "src/main.rs"];
/// What decides it beside the sources.
const MANIFESTS: [&str; 4] = ["Cargo.lock", "Cargo.toml", "numerics/Cargo.toml", "tables/Cargo.toml"];

fn main() -> Result<(), Box<dyn Error>> {
    let (identity, files) = identity(Path::new(&env::var("CARGO_MANIFEST_DIR")?), &compiler()?)?;
    println!("cargo::rustc-env=STICTIOND_BUILD={identity:016x}");
    // File by file: of a folder every change would count, as of a test or of the dashboard, and the library be built anew.
    for file in files {
        println!("cargo::rerun-if-changed={file}");
    }
    Ok(())
}

/// What compiles, and for what. The host says nothing of the result.
fn compiler() -> Result<String, Box<dyn Error>> {
    let said = Command::new(env::var("RUSTC")?).arg("-vV").output()?;
    let said = String::from_utf8(said.stdout)?;
    let mut compiler: Vec<String> =
        said.lines().filter(|line| !line.starts_with("host:")).map(str::to_string).collect();
    for name in ["TARGET", "OPT_LEVEL", "CARGO_CFG_TARGET_FEATURE", "CARGO_ENCODED_RUSTFLAGS"] {
        compiler.push(format!("{name}={}", env::var(name).unwrap_or_default()));
    }
    Ok(compiler.join("\n"))
}

/// The identity of what is below `root`, and the files that decide it.
pub fn identity(root: &Path, compiler: &str) -> io::Result<(u64, Vec<String>)> {
    let mut files = MANIFESTS.map(str::to_string).to_vec();
    walk(root, "src", &mut files)?;
    files.sort();
    let mut digest = Digest::new();
    digest.add(compiler.as_bytes());
    for file in &files {
        digest.add(file.as_bytes());
        digest.add(&fs::read(root.join(file))?);
    }
    Ok((digest.0, files))
}

fn walk(root: &Path, folder: &str, files: &mut Vec<String>) -> io::Result<()> {
    for entry in fs::read_dir(root.join(folder))? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = format!("{folder}/{name}");
        let is_test = name == "tests" || name == "tests.rs" || name.ends_with("_tests.rs");
        if is_test || LEFT_OUT.contains(&path.as_str()) {
            continue;
        }
        if entry.file_type()?.is_dir() {
            walk(root, &path, files)?;
        } else if name.ends_with(".rs") {
            files.push(path);
        }
    }
    Ok(())
}

/// FNV-1a with 64 bits: that of std may be another in each release of Rust. Nobody is kept from making two builds with one
/// identity on purpose; who could do that could also lie about it.
struct Digest(u64);

impl Digest {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    /// Some bytes, behind their number: where one file ends and the next begins counts too.
    fn add(&mut self, bytes: &[u8]) {
        for byte in (bytes.len() as u64).to_le_bytes().iter().chain(bytes) {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}
