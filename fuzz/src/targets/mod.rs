//! What takes bytes from outside, each as a function of bytes. The fuzzer calls them with what it thinks of, the tests with
//! everything in `fuzz/corpus`.

mod archive;
mod blocks;
mod bundle;
mod config;
mod fleet;
mod http;
mod large;
mod ledger;
mod modbus;
mod mqtt;
mod opcua;
mod records;
mod tables;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// One way in.
pub struct Target {
    /// Its name, and that of its folder in `fuzz/corpus`.
    pub name: &'static str,
    /// Takes the bytes; whatever they are, it returns.
    pub run: fn(&[u8]),
    /// Most memory that one input may hold beside its own bytes (MiB).
    pub most_mib: usize,
    /// Makes a long input, where the daemon takes far longer ones than `fuzz/corpus` holds.
    pub large: Option<fn() -> Vec<u8>>,
}

const fn target(name: &'static str, run: fn(&[u8]), most_mib: usize) -> Target {
    Target { name, run, most_mib, large: None }
}

impl Target {
    const fn with(self, large: fn() -> Vec<u8>) -> Self {
        Self { large: Some(large), ..self }
    }
}

/// All of them.
pub const TARGETS: &[Target] = &[
    target("csv", tables::text, 64),
    target("parquet", tables::parquet, 64),
    target("excel", tables::excel, 64),
    target("config", config::run, 64),
    target("access", records::access, 64),
    target("modbus", modbus::run, 16),
    // The library reserves as much as the length of a structure says, and touches only what came of it.
    target("opcua", opcua::run, 2048 + 32).with(large::opcua),
    target("json", mqtt::json, 32).with(large::json),
    target("sparkplug", mqtt::sparkplug, 32).with(large::sparkplug),
    target("fleet", fleet::run, 1).with(large::fleet),
    target("blocks", blocks::run, 64),
    target("journal", ledger::journal, 64),
    target("ledger", ledger::files, 64),
    target("audit", records::audit, 32),
    target("bundle", bundle::run, 64),
    target("http", http::run, 64),
];

/// Where everything is that targets write: `FUZZ_SCRATCH`, or a folder of this process, in memory where the system has such a
/// place. Whoever runs targets removes it.
pub fn root() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| {
        let own = || {
            let memory = PathBuf::from("/dev/shm");
            let root = if memory.is_dir() { memory } else { std::env::temp_dir() };
            root.join(format!("stictiond-fuzz-{}", std::process::id()))
        };
        std::env::var_os("FUZZ_SCRATCH").map_or_else(own, PathBuf::from)
    })
}

fn scratch(name: &str) -> PathBuf {
    let folder = root().join(name);
    std::fs::create_dir_all(&folder).expect("a folder for what is fuzzed");
    folder
}

/// Waits for what needs a runtime, on this thread.
fn wait<T>(work: impl Future<Output = T>) -> T {
    thread_local! {
        static RUNTIME: tokio::runtime::Runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    }
    RUNTIME.with(|runtime| runtime.block_on(work))
}
