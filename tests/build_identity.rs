//! The identity of a build is another where anything is that may decide what a diagnosis finds, and the same elsewhere.

#[path = "../build.rs"]
#[expect(dead_code, reason = "cargo calls its main function")]
mod build;

use std::fs;
use std::path::{Path, PathBuf};

/// A small package in a folder of this name.
fn package(name: &str) -> PathBuf {
    let root = std::env::temp_dir().join(format!("stictiond-build-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&root);
    for (file, text) in [
        ("Cargo.lock", "lock"),
        ("Cargo.toml", "manifest"),
        ("numerics/Cargo.toml", "manifest of numerics"),
        ("tables/Cargo.toml", "manifest of tables"),
        ("src/lib.rs", "mod fit;"),
        ("src/fit.rs", "fn fit() {}"),
        ("src/fit/tests.rs", "fn test() {}"),
        ("src/main.rs", "fn main() {}"),
        ("src/cli/mod.rs", "fn cli() {}"),
        ("src/page/style.css", "a {}"),
    ] {
        write(&root, file, text);
    }
    root
}

fn write(root: &Path, file: &str, text: &str) {
    let path = root.join(file);
    fs::create_dir_all(path.parent().expect("below the root")).expect("writable");
    fs::write(path, text).expect("writable");
}

fn identity(root: &Path) -> u64 {
    build::identity(root, "rustc 1").expect("readable").0
}

#[test]
fn the_identity_is_another_exactly_where_a_diagnosis_may_be() {
    let (one, other) = (package("one"), package("other"));
    let before = identity(&one);
    assert_eq!(identity(&other), before, "a folder is no part of it");
    assert_ne!(build::identity(&one, "rustc 2").expect("readable").0, before, "another compiler");

    for (file, text) in [
        ("src/fit/tests.rs", "fn another() {}"),
        ("src/cli/mod.rs", "fn another() {}"),
        ("src/main.rs", "fn another() {}"),
        ("src/page/style.css", "b {}"),
    ] {
        write(&one, file, text);
        assert_eq!(identity(&one), before, "{file}");
    }
    let mut known = vec![before];
    for (file, text) in [
        ("src/fit.rs", "fn fit() { }"),
        ("src/lib.rs", "mod fit; "),
        ("src/fit/late.rs", ""),
        ("Cargo.lock", "lock of another dependency"),
        ("numerics/Cargo.toml", "another feature"),
    ] {
        write(&one, file, text);
        let now = identity(&one);
        assert!(!known.contains(&now), "{file}");
        known.push(now);
    }
    // What moves from one file into the next is another source.
    write(&other, "src/fit.rs", "fn fit() {}mod fit;");
    write(&other, "src/lib.rs", "");
    assert_ne!(identity(&other), before);
    [one, other].iter().for_each(|root| fs::remove_dir_all(root).expect("there"));
}

#[test]
fn the_sources_of_this_package_are_what_decides_it() {
    let (_, files) = build::identity(Path::new(env!("CARGO_MANIFEST_DIR")), "").expect("readable");
    for file in ["Cargo.lock", "src/app.rs", "src/numerics.rs", "src/sysid/mod.rs"] {
        assert!(files.iter().any(|own| own == file), "{file}");
    }
    assert!(files.iter().all(|own| !own.starts_with("src/cli") && !own.contains("/tests")), "{files:?}");
}
