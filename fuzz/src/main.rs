//! Hands what libFuzzer thinks of to one target, named by `FUZZ_TARGET`, and holds it to the target's bound of memory.
#![no_main]

mod targets;

use libfuzzer_sys::fuzz_target;
use peak_alloc::PeakAlloc;
use std::backtrace::Backtrace;
use std::fs;
use std::panic::PanicHookInfo;
use std::sync::OnceLock;
use targets::{TARGETS, Target};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

static TARGET: OnceLock<&Target> = OnceLock::new();

/// Libraries whose panics are caught where they are called: the panic is an error there.
const CAUGHT: [&str; 2] = ["/calamine-", "/parquet-"];

/// Ends the process at a panic, on whatever thread, so that none is taken for an answer.
fn end(panic: &PanicHookInfo) {
    let place = panic.location().map_or("", |place| place.file());
    if !CAUGHT.iter().any(|library| place.contains(library)) {
        eprintln!("{panic}\n{}", Backtrace::force_capture());
        std::process::abort();
    }
}

fn chosen() -> &'static Target {
    TARGET.get_or_init(|| {
        let name = std::env::var("FUZZ_TARGET").unwrap_or_default();
        TARGETS.iter().find(|target| target.name == name).unwrap_or_else(|| {
            let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
            panic!("FUZZ_TARGET is {name:?}; there are {}", names.join(", "))
        })
    })
}

/// Lays the long input of a target where `scripts/fuzz` lets the fuzzer begin with it.
fn lay_out(target: &Target) {
    let Some(large) = target.large else { return };
    let folder = targets::root().join("large").join(target.name);
    let written = fs::create_dir_all(&folder).and_then(|()| fs::write(folder.join("input"), large()));
    written.expect("a folder for what is fuzzed");
}

fuzz_target!(init: {
    std::panic::set_hook(Box::new(end));
    // What a target makes once is not counted as an input's.
    (chosen().run)(b"");
    lay_out(chosen());
}, |data: &[u8]| {
    let target = chosen();
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    (target.run)(data);
    let most = MEMORY.peak_usage().saturating_sub(before);
    let bound = target.most_mib << 20;
    assert!(most <= bound, "{}: {} bytes held {most} bytes, more than {bound}", target.name, data.len());
});
