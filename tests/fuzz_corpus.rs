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
        let inputs = corpus(target.name);
        assert!(inputs.len() >= 2, "{}: a target needs something to begin with", target.name);
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
