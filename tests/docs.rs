//! What the documents say, held against the program: keys and defaults of the configuration, excerpts that must load,
//! the routes of the API, the constants of the method, the metrics in alert rules, and links that lead somewhere.

#[path = "docs/constants.rs"]
mod constants;
#[path = "docs/filters.rs"]
mod filters;
#[path = "docs/links.rs"]
mod links;
#[path = "docs/measured.rs"]
mod measured;
#[path = "docs/tables.rs"]
mod tables;

use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use std::fs;
use std::path::PathBuf;
use stictiond::collect::{modbus, mqtt, opcua};
use stictiond::config::{self, LoopConfig};
use stictiond::{
    access, alarm, audit, diagnosis, fleet, history, notify, schedule, serve, store, table, work, writeback,
};

const DOCUMENTS: &[&str] = &[
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "docs/acquisition.md",
    "docs/alarms.md",
    "docs/api.md",
    "docs/backfill.md",
    "docs/benchmark.md",
    "docs/commissioning.md",
    "docs/configuration.md",
    "docs/closing-the-loop.md",
    "docs/constants.md",
    "docs/dashboard.md",
    "docs/notifications.md",
    "docs/diagnosis.md",
    "docs/fleet.md",
    "docs/method.md",
    "docs/mqtt.md",
    "docs/opcua.md",
    "docs/plantwide.md",
    "docs/reliability.md",
    "docs/replay.md",
    "docs/security.md",
    "docs/reproduce.md",
    "docs/store.md",
    "docs/tables.md",
    "docs/user-guide.md",
    "docs/writeback.md",
    "deploy/README.md",
];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The cells of every table row below `heading`, up to the next heading, without the head of the table.
fn rows(document: &str, heading: &str) -> Vec<Vec<String>> {
    let text = read(document);
    let below = text.split_once(&format!("\n## {heading}\n"));
    let (_, below) = below.unwrap_or_else(|| panic!("{document} has no section {heading}"));
    let section = below.split("\n## ").next().unwrap_or_default();
    let cells = |line: &str| line.trim_matches('|').split(" | ").map(|c| c.trim().to_string()).collect();
    let rows: Vec<Vec<String>> = section.lines().filter(|line| line.starts_with('|')).map(cells).collect();
    assert!(rows.len() > 2, "{document}, {heading}: no table");
    rows[2..].to_vec()
}

/// The keys that a struct knows, in serde's own words.
fn known<T: DeserializeOwned + Debug>() -> BTreeSet<String> {
    let error = toml::from_str::<T>("no_such_key = 0").expect_err("an unknown key is refused").to_string();
    let (_, expected) = error.split_once("expected").expect("serde lists what it expects");
    expected.split('`').skip(1).step_by(2).map(str::to_string).collect()
}

/// Key and default of every row of a section, both out of their back-ticks.
fn documented(heading: &str) -> Vec<(String, String)> {
    let plain = |cell: &str| cell.trim_matches('`').to_string();
    rows("docs/configuration.md", heading).iter().map(|row| (plain(&row[0]), plain(&row[1]))).collect()
}

/// Every key is documented, no other is, and the defaults are the program's: written out they change nothing.
fn agrees<T: DeserializeOwned + Debug + PartialEq>(heading: &str, required: &str) {
    let documented = documented(heading);
    let keys: BTreeSet<String> = documented.iter().map(|(key, _)| key.clone()).collect();
    assert_eq!(keys, known::<T>(), "the keys of {heading}");
    let needed: toml::Table = required.parse().expect("TOML");
    for (key, default) in &documented {
        assert_eq!(default == "required", needed.contains_key(key), "{heading}: is {key} required?");
    }
    let defaults: String = documented
        .iter()
        .filter(|(_, default)| default != "required" && default != "–")
        .map(|(key, default)| format!("{key} = {default}\n"))
        .collect();
    // Values before tables, as TOML wants it.
    let written: T = toml::from_str(&(defaults + required)).unwrap_or_else(|e| panic!("{heading}: {e}"));
    let left_out: T = toml::from_str(required).unwrap_or_else(|e| panic!("{heading}: {e}"));
    assert_eq!(written, left_out, "the defaults of {heading}");
}

const TAG: &str = "device = 'd'\nregister = 'coil'\naddress = 1\n";

#[test]
fn how_sure_an_effect_is_said_to_be_is_documented() {
    let api = read("docs/api.md");
    for (least, word) in stictiond::results::words::SURE {
        assert!(api.contains(&format!("| {least} | {word} | ")), "{word}");
    }
    let costly = format!("| {} | very likely | the same |", stictiond::results::words::COSTLY_FROM);
    assert!(
        api.contains(&costly)
            && api.contains("| 0.75 | probably | what to look at first, which costs nothing |")
    );
}

#[test]
fn the_reference_of_the_configuration_is_the_configuration() {
    agrees::<serve::Config>("`[server]`", "");
    agrees::<serve::TlsConfig>("`[server.tls]`", "cert_file = 'c'\nkey_file = 'k'\n");
    agrees::<access::Config>("`[access]`", "file = 'x'\n");
    agrees::<audit::Config>("`[audit]`", "file = 'x'\n");
    agrees::<history::Config>("`[history]`", "");
    agrees::<store::Config>("`[store]`", "folder = 'x'\n");
    agrees::<table::Config>("`[tables]`", "");
    agrees::<table::Options>("`[tables.defaults]`", "");
    agrees::<schedule::Config>("`[schedule]`", "");
    agrees::<diagnosis::Config>("`[diagnosis]`", "");
    agrees::<alarm::Config>("`[alarm]`", "");
    agrees::<alarm::RisingConfig>("`[alarm.f_rising]`", "");
    agrees::<alarm::NotIdentifiableConfig>("`[alarm.not_identifiable]`", "");
    agrees::<alarm::TagBadConfig>("`[alarm.tag_bad]`", "");
    agrees::<alarm::CollectorDownConfig>("`[alarm.collector_down]`", "");
    agrees::<alarm::TrippedConfig>("`[alarm.compensation_tripped]`", "");
    agrees::<alarm::UnexplainedConfig>("`[alarm.unexplained_residual]`", "");
    agrees::<work::Config>("`[plantwide]`", "");
    agrees::<fleet::Config>("`[fleet]`", "servers = ['nats://d:4222']\n");
    agrees::<work::CostConfig>("`[loop.cost]`", "per_sd = 1.0\n");
    agrees::<modbus::Config>("`[[modbus]]`", "name = 'd'\naddress = 'd:502'\naddress_base = 0\n");
    agrees::<opcua::Config>("`[[opcua]]`", "name = 'd'\nurl = 'opc.tcp://d:4840/'\n");
    agrees::<opcua::TagConfig>("A tag of an OPC UA server", "device = 'd'\n");
    agrees::<mqtt::Config>("`[[mqtt]]`", "name = 'd'\naddress = 'd:1883'\n");
    agrees::<mqtt::TagConfig>("A tag at an MQTT broker", "device = 'd'\n");
    agrees::<notify::Config>("`[notify]`", "");
    agrees::<notify::webhook::Config>("`[[notify.webhook]]`", "name = 'd'\nurl = 'https://d'\n");
    agrees::<notify::alertmanager::Config>("`[[notify.alertmanager]]`", "name = 'd'\nurl = 'https://d'\n");
    let mail = "name = 'd'\naddress = 'd:25'\nfrom = 'a@b'\nto = ['a@b']\n";
    agrees::<notify::smtp::Config>("`[[notify.smtp]]`", mail);
    agrees::<notify::Filter>("`filter` of a receiver", "");
    agrees::<notify::Pace>("`pace` of a webhook or of mails", "");
    agrees::<notify::Retry>("`retry` of a webhook or of mails", "");
    agrees::<notify::mqtt::Config>("`[notify.mqtt]`", "address = 'd:1883'\n");
    agrees::<LoopConfig>("`[[loop]]`", &format!("id = 'A'\n[op]\n{TAG}[pv]\n{TAG}"));
    agrees::<modbus::TagConfig>("A tag", TAG);
    agrees::<writeback::Config>("`[writeback]`", "");
    let example = blocks("docs/writeback.md", "toml").concat();
    let (_, own) = example.split_once("[loop.writeback]\nenabled = false\n").expect("an example");
    agrees::<writeback::LoopConfig>("`[loop.writeback]`", own);
}

/// A wrong default and a forgotten key are what the test above is for.
#[test]
fn a_default_that_differs_is_noticed() {
    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Other {
        samples_per_tag: usize,
    }
    impl Default for Other {
        fn default() -> Self {
            Self { samples_per_tag: 1 }
        }
    }
    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct More {
        #[serde(default)]
        samples_per_tag: usize,
        #[serde(default)]
        forgotten: usize,
    }
    assert!(std::panic::catch_unwind(|| agrees::<Other>("`[history]`", "")).is_err());
    assert!(std::panic::catch_unwind(|| agrees::<More>("`[history]`", "")).is_err());
}

/// The text of every fenced block of a language.
fn blocks(document: &str, language: &str) -> Vec<String> {
    let text = read(document);
    let fence = format!("```{language}\n");
    text.split(&fence).skip(1).filter_map(|rest| Some(rest.split_once("```")?.0.to_string())).collect()
}

#[test]
fn every_configuration_in_the_documents_is_accepted() {
    let found: Vec<(&str, String)> =
        DOCUMENTS.iter().flat_map(|name| blocks(name, "toml").into_iter().map(move |b| (*name, b))).collect();
    assert!(found.iter().any(|(name, _)| *name == "README.md"), "the README shows no configuration");
    for (name, text) in found {
        if let Err(errors) = config::parse(name, &text) {
            panic!("{}", errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"));
        }
    }
    for entry in fs::read_dir(root().join("config")).expect("config can be read").flatten() {
        let loaded = config::load(&entry.path());
        assert!(loaded.is_ok(), "{:?}", loaded.err());
    }
}

#[test]
fn the_record_that_the_readme_diagnoses_is_what_it_says() {
    let file = root().join("docs/example.csv");
    let record = stictiond::table::record(&file).expect("the example is a record");
    let found = diagnosis::diagnose(&record, &diagnosis::Settings::default());
    assert_eq!(found.verdict, diagnosis::Verdict::Stiction, "{}", found.reason);
    // Made with the demo's loop FIC103: S/2 = 0.5 % OP.
    let estimate = found.estimate.expect("a verdict has an estimate");
    assert!(estimate.f_ci95[0] < 0.5 && 0.5 < estimate.f_ci95[1], "{:?}", estimate.f_ci95);
}

/// The report that the README shows is what the program prints.
#[test]
fn the_readme_shows_what_is_printed() {
    const COMMAND: &str = "    cargo run --release -- diagnose docs/example.csv --format text\n\n";
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["diagnose", "docs/example.csv", "--format", "text"])
        .current_dir(root())
        .output()
        .expect("runs");
    let printed = String::from_utf8(output.stdout).expect("text");
    let block: String = printed.lines().map(|line| format!("    {line}\n")).collect();
    let readme = read("README.md");
    let (before, rest) = readme.split_once(COMMAND).expect("the README shows a report");
    let (shown, after) = rest.split_once("\n\n").expect("the report ends");
    if std::env::var_os("STICTIOND_WRITE_DOCS").is_some() {
        let text = format!("{before}{COMMAND}{}\n\n{after}", block.trim_end_matches('\n'));
        fs::write(root().join("README.md"), text).expect("writable");
    } else {
        assert_eq!(
            shown,
            block.trim_end_matches('\n'),
            "STICTIOND_WRITE_DOCS=1 cargo test --test docs makes it"
        );
    }
}

/// Whether a route is one of this build.
fn built_in(row: &[String]) -> bool {
    writeback::BUILT_IN || !row[1].contains("feature `writeback`")
}

/// The words in back-ticks.
fn ticked(cell: &str) -> BTreeSet<String> {
    cell.split('`').skip(1).step_by(2).flat_map(str::split_whitespace).map(str::to_string).collect()
}

/// Every route, no other, and every parameter of its query.
#[test]
fn the_document_of_the_api_lists_every_route() {
    let api = serde_json::to_value(serve::openapi()).expect("the description is JSON");
    let paths = api["paths"].as_object().expect("paths");
    // What is at the root too is said once.
    let shown = |path: &String| path.starts_with("/api/v1/") && !paths.contains_key(&path["/api/v1".len()..]);
    let mut routes: BTreeMap<String, BTreeSet<String>> = paths
        .iter()
        .filter(|(path, _)| shown(path) || !path.starts_with("/api/v1/"))
        .flat_map(|(path, methods)| {
            let methods = methods.as_object().expect("methods");
            methods.iter().map(move |(method, route)| {
                let taken = route["parameters"].as_array().into_iter().flatten();
                let of_query = taken.filter(|own| own["in"] == "query");
                let names = of_query.filter_map(|own| own["name"].as_str().map(str::to_string));
                (format!("{} {path}", method.to_uppercase()), names.collect::<BTreeSet<String>>())
            })
        })
        .collect();
    routes.insert("GET /openapi.json".to_string(), BTreeSet::new());
    assert!(routes["GET /api/v1/loops"].contains("verdict"), "the description has no query");
    let rows = rows("docs/api.md", "Routes");
    let listed: BTreeMap<String, BTreeSet<String>> = rows
        .iter()
        .filter(|row| built_in(row))
        .map(|row| (row[0].trim_matches('`').to_string(), ticked(&row[1])))
        .collect();
    assert_eq!(listed.keys().collect::<Vec<_>>(), routes.keys().collect::<Vec<_>>());
    for (route, query) in &routes {
        let untold: Vec<_> = query.difference(&listed[route]).collect();
        assert!(untold.is_empty(), "docs/api.md, {route}: {untold:?} is not told");
    }
}

/// Whether a path is one of a route, whose parts in braces stand for anything; an alarm's name may have a slash in it.
fn is_of(path: &str, route: &str) -> bool {
    let named = |text: &str| text.replace("/tag_bad/", "%2Ftag_bad/");
    let (path, route) = (named(path), route.to_string());
    let (mut own, mut other) = (path.split('/'), route.split('/'));
    loop {
        match (own.next(), other.next()) {
            (None, None) => return true,
            (Some(a), Some(b)) if a == b || b.starts_with('{') && !a.is_empty() => {}
            _ => return false,
        }
    }
}

#[test]
fn the_document_of_the_api_asks_every_route() {
    let lines: Vec<(String, String)> = blocks("docs/api.md", "sh")
        .concat()
        .lines()
        .filter_map(|line| {
            let method = line.split_once("-X ").and_then(|(_, rest)| rest.split(' ').next()).unwrap_or("GET");
            let path = line.split_once("http://127.0.0.1:8080")?.1;
            let end = path.find([' ', '?', '\'']).unwrap_or(path.len());
            Some((method.to_string(), path[..end].to_string()))
        })
        .collect();
    for (method, path, _) in serve::RULES {
        let at_root = ["/healthz", "/readyz", "/metrics", "/openapi.json"].contains(path);
        let route = if at_root { path.to_string() } else { format!("/api/v1{path}") };
        let asked = lines.iter().any(|(verb, own)| verb == method && is_of(own, &route));
        assert!(asked, "docs/api.md does not ask {method} {route}");
    }
    assert!(!is_of("/api/v1/loops", "/api/v1/loops/{id}") && !is_of("/api/v1/alarms", "/api/v1/loops"));
}

#[test]
fn the_roles_in_the_security_document_are_those_of_the_router() {
    let rules: BTreeSet<(String, String)> = serve::RULES
        .iter()
        .map(|(method, path, need)| {
            let root = ["/healthz", "/readyz", "/metrics", "/openapi.json"].contains(path);
            let below = if root { "" } else { "/api/v1" };
            (format!("{method} {below}{path}"), need.as_str().to_string())
        })
        .collect();
    let plain = |cell: &str| cell.split(';').next().unwrap_or_default().trim_matches('`').to_string();
    let listed: BTreeSet<(String, String)> =
        rows("docs/security.md", "Roles").iter().map(|row| (plain(&row[0]), plain(&row[1]))).collect();
    assert_eq!(listed, rules);
}

#[test]
fn every_attempt_in_the_security_document_is_a_test() {
    let listed = rows("docs/security.md", "What was tried");
    assert!(listed.len() > 15, "only {}", listed.len());
    let mut known = BTreeSet::new();
    for module in ["access", "commands", "http", "names", "streams", "tls"] {
        let text = read(&format!("tests/security/{module}.rs"));
        let tests =
            text.split("test]\n").skip(1).filter_map(|rest| rest.split("fn ").nth(1)?.split('(').next());
        known.extend(tests.map(|name| format!("{module}::{name}")));
    }
    let named: BTreeSet<String> = listed.iter().map(|row| row[2].trim_matches('`').to_string()).collect();
    assert_eq!(named, known);
}

#[test]
fn the_commissioning_guide_has_a_line_for_every_reason() {
    let source = read("src/diagnosis/not_identifiable.rs");
    let codes = source.split_once("pub fn code(&self)").and_then(|(_, rest)| rest.split_once("\n    }\n"));
    let (codes, _) = codes.expect("the codes");
    let codes: BTreeSet<String> = codes.split('"').skip(1).step_by(2).map(str::to_string).collect();
    let rows = rows("docs/commissioning.md", "5. What to do with `not_identifiable`");
    let told: BTreeSet<String> = rows.iter().map(|row| row[0].trim_matches('`').to_string()).collect();
    assert_eq!(told, codes);
}

/// The files of a folder's source, its tests left out: path below `src`, and text.
fn sources(folder: &str) -> Vec<(String, String)> {
    let mut out = Vec::new();
    for entry in fs::read_dir(root().join("src").join(folder)).expect("the folder can be read").flatten() {
        let path = format!("{folder}/{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            out.extend(sources(&path));
        } else if path.ends_with(".rs") && !path.ends_with("/tests.rs") {
            let text = read(&format!("src/{path}"));
            let own = text.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            out.push((path, own.to_string()));
        }
    }
    out
}

/// What each hypothesis costs: its file, rate and alternatives in the source, and both as docs/method.md says them.
const COSTS: [(&str, [&str; 2], [&str; 2]); 13] = [
    (
        "load/oscillating_load.rs",
        ["FREQUENCY + 2.0 * REGULAR * self.harmonics.len() as f64", "PERIODIC_SHAPES"],
        ["3/2 + 1 for each harmonic", "4"],
    ),
    (
        "load/cornered_load.rs",
        ["FREQUENCY + REGULAR * (ORDER + 4) as f64", "PERIODIC_SHAPES"],
        ["3/2 + 7 · 1/2", "4"],
    ),
    (
        "load/measured_disturbance.rs",
        ["TAPS as f64 * REGULAR", "self.alternatives"],
        ["2 · 1/2", "tags × delays"],
    ),
    ("load/load_step.rs", ["REGULAR + THRESHOLD", "3.0"], ["1/2 + 1", "3"]),
    ("sensor/pv_offset.rs", ["REGULAR + THRESHOLD", "3.0"], ["1/2 + 1", "3"]),
    (
        "load/drift.rs",
        ["REGULAR + if self.from.is_some() { REGULAR } else { 0.0 }", "2.0"],
        ["1/2, + 1/2 from a time on", "2"],
    ),
    ("process/gain_change.rs", ["THRESHOLD + 2.0 * REGULAR", ""], ["1 + 2 · 1/2", "1"]),
    ("process/dead_time_change.rs", ["THRESHOLD", "2.0 * LONGEST as f64"], ["1", "2 · 8"]),
    ("process/gain_of_pv.rs", ["REGULAR", "2.0"], ["1/2", "2"]),
    ("valve/characteristic.rs", ["REGULAR", "2.0"], ["1/2", "2"]),
    ("valve/saturation.rs", ["REGULAR", "4.0"], ["1/2", "4"]),
    ("valve/asymmetric_friction.rs", ["THRESHOLD", ""], ["1", "1"]),
    ("valve/friction_drift.rs", ["THRESHOLD", ""], ["1", "1"]),
];

#[test]
fn the_costs_of_the_hypotheses_are_those_of_the_source() {
    let rows = rows("docs/method.md", "3. What competes (`residual/hypotheses/`)");
    let of = |text: &str, name: &str| -> Vec<String> {
        let begin = format!("fn {name}(&self) -> f64 {{\n");
        let bodies = text.split(&begin).skip(1);
        bodies.filter_map(|rest| Some(rest.split_once("\n    }")?.0.trim().to_string())).collect()
    };
    let mut found = Vec::new();
    for (file, text) in sources("residual/hypotheses") {
        let (rates, alternatives) = (of(&text, "rate"), of(&text, "alternatives"));
        for (at, rate) in rates.into_iter().enumerate() {
            let file = file.trim_start_matches("residual/hypotheses/").to_string();
            found.push((file, rate, alternatives.get(at).cloned().unwrap_or_default()));
        }
    }
    let mut listed: Vec<_> =
        COSTS.iter().map(|(file, [r, a], _)| (file.to_string(), r.to_string(), a.to_string())).collect();
    found.sort();
    listed.sort();
    assert_eq!(found, listed, "a rate has changed: COSTS and docs/method.md say what it was");
    for (file, _, told) in COSTS {
        let row = rows.iter().find(|row| row[4].trim_matches('`') == file);
        let row = row.unwrap_or_else(|| panic!("docs/method.md: no row for {file}"));
        assert_eq!([row[2].as_str(), row[3].as_str()], told, "docs/method.md: {file}");
    }
    let of_valve = read("src/residual/valve_search/cost.rs");
    let cost = "(THRESHOLD + of_j, StopRule::ALL.len() as f64 * resolutions)";
    assert!(of_valve.contains(cost) && of_valve.contains("RESOLUTIONS: [f64; 7]"), "what a valve costs");
    let told =
        |row: &&Vec<String>| row[3] == "3, times 7 with a resolution" && row[0].starts_with("friction");
    assert_eq!(rows.iter().filter(told).count(), 2);
}

#[test]
fn the_penalty_of_a_parameter_is_computed_in_one_place() {
    let ways = ["counted().ln()", "rows.len() as f64).ln()", "(n as f64).ln()", "n.ln()"];
    let by_hand = |text: &str| ways.iter().any(|way| text.contains(way));
    let all = ["sysid", "residual"].into_iter().flat_map(sources);
    let found: Vec<String> = all.filter(|(_, text)| by_hand(text)).map(|(file, _)| file).collect();
    assert_eq!(found, ["sysid/criterion.rs"], "where ln N stands");
}

#[test]
fn the_effects_and_their_numbers_are_those_of_the_source() {
    let rows = rows("docs/closing-the-loop.md", "What it finds");
    let quoted =
        |cell: &str| -> Vec<String> { cell.split('`').skip(1).step_by(2).map(str::to_string).collect() };
    let kinds: Vec<String> = rows.iter().flat_map(|row| quoted(&row[0])).collect();
    let known: BTreeSet<&str> =
        stictiond::residual::Kind::ALL.into_iter().map(|kind| kind.as_str()).collect();
    assert_eq!(kinds.iter().map(String::as_str).collect::<BTreeSet<_>>(), known);
    assert_eq!(kinds.len(), known.len());
    let told: BTreeSet<String> = rows.iter().flat_map(|row| quoted(&row[2])).collect();
    let mut given = BTreeSet::new();
    for (_, text) in sources("residual") {
        let calls = text.split(".with(").skip(1).filter_map(|rest| rest.trim_start().strip_prefix('"'));
        let names = calls.filter_map(|rest| rest.split('"').next());
        given.extend(names.map(str::to_string));
    }
    // Saturation's name depends on the side.
    given.extend(["low", "high"].map(str::to_string));
    assert_eq!(told, given);
}

#[test]
fn every_metric_that_a_rule_reads_exists() {
    let metrics = read("src/serve/metrics.rs");
    let rules = read("deploy/prometheus/rules.yml");
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let used: BTreeSet<&str> =
        rules.split(|c| !is_part(c)).filter_map(|word| word.strip_prefix("stictiond_")).collect();
    assert!(used.len() > 4, "{used:?}");
    for name in used {
        let base = name.strip_suffix("_total").unwrap_or(name);
        assert!(metrics.contains(&format!("\"{base}\"")), "no metric stictiond_{name}");
    }
}
