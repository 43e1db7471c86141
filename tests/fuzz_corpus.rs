//! Everything in `fuzz/corpus` through the functions that are fuzzed: what once broke one is taken for good.

#[path = "../fuzz/src/targets/mod.rs"]
mod targets;

use std::fs;
use std::path::Path;

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let files = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let read = |entry: fs::DirEntry| {
        (entry.file_name().to_string_lossy().into_owned(), fs::read(entry.path()).expect("read"))
    };
    files.flatten().map(read).collect()
}

#[test]
fn every_input_of_the_corpus_is_taken() {
    let mut broken = Vec::new();
    for target in targets::TARGETS {
        let mut inputs = corpus(target.name);
        assert!(inputs.len() >= 2, "{}: a target needs something to begin with", target.name);
        inputs.extend(target.large.map(|large| ("its long input".to_string(), large())));
        assert!(target.most_mib > 0, "{}: a target needs a bound of memory", target.name);
        for (name, bytes) in inputs {
            let run = target.run;
            let ran = std::panic::catch_unwind(|| run(&bytes));
            if ran.is_err() {
                broken.push(format!("fuzz/corpus/{}/{name}", target.name));
            }
        }
    }
    fs::remove_dir_all(targets::root()).expect("targets write there");
    assert!(broken.is_empty(), "{broken:#?}");
}

/// How long an input of a target may be, where `scripts/fuzz` has a line of its own for it: `a | b) longest=7 ;; # why`.
fn longest(script: &str, name: &str) -> Option<usize> {
    script.lines().find_map(|line| {
        let (names, rest) = line.trim().split_once(") longest=")?;
        let number = rest.split(' ').next()?.parse().ok()?;
        names.split(" | ").any(|own| own == name).then_some(number)
    })
}

/// Else the fuzzer would cut it.
#[test]
fn every_long_input_is_longer_than_others_and_fits() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/fuzz");
    let script = fs::read_to_string(path).expect("there");
    let mut count = 0;
    for target in targets::TARGETS {
        let Some(large) = target.large else { continue };
        let most = longest(&script, target.name).expect("a line of its own");
        let length = large().len();
        assert!(length > 40 << 10 && length <= most, "{}: {length} bytes of {most}", target.name);
        count += 1;
    }
    assert_eq!(count, 4);
}

#[test]
fn the_corpus_is_small_and_has_no_folder_that_nobody_reads() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    for entry in fs::read_dir(folder).expect("there").flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        assert!(targets::TARGETS.iter().any(|target| target.name == name), "{name} is no target");
        let bytes: usize = corpus(&name).iter().map(|(_, bytes)| bytes.len()).sum();
        assert!(bytes <= 32 * 1024, "{name}: {bytes} bytes");
    }
}
