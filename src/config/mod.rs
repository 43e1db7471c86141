//! The configuration file: composes the components' own `Config` structs, and reports everything wrong with a file at
//! once, each error with its line and column.

mod diagnostic;
mod doubts;
mod files;
mod keys;
mod neighbours;
mod plant;
mod remarks;
mod rules;
mod section;
mod source;
mod syntax;
mod tag;
mod unlikely;
mod wording;

pub use diagnostic::Diagnostic;
pub use files::without_number;
pub use neighbours::{Candidates, MOST_CANDIDATES, Neighbour};
pub use plant::{Plant, tags};
pub use tag::MODBUS_KEYS;
pub use tag::{ForwardedTag, TagConfig};
pub use wording::type_meant;

use crate::collect::{modbus, mqtt, opcua};
use crate::{
    access, alarm, audit, diagnosis, fleet, history, notify, schedule, serve, store, table, work, writeback,
};
use diagnostic::Report;
use serde::Deserialize;
use source::Source;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Largest configuration file read (bytes): 2,000 loops take about 2 MB.
const MAX_BYTES: u64 = 1 << 24;

/// Everything the daemon is told.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Config {
    /// `[server]`.
    pub server: serve::Config,
    /// `[access]`; without it there is no log-in.
    pub access: Option<access::Config>,
    /// `[audit]`; without it changes are only logged.
    pub audit: Option<audit::Config>,
    /// `[history]`.
    pub history: history::Config,
    /// `[store]`; without it nothing outlives a restart.
    pub store: Option<store::Config>,
    /// `[tables]`.
    pub tables: table::Config,
    /// `[schedule]`.
    pub schedule: schedule::Config,
    /// `[diagnosis]`.
    pub diagnosis: diagnosis::Config,
    /// `[alarm]`.
    pub alarm: alarm::Config,
    /// `[plantwide]`.
    pub plantwide: work::Config,
    /// `[writeback]`.
    pub writeback: writeback::Config,
    /// `[fleet]`; without it this machine is alone.
    pub fleet: Option<fleet::Config>,
    /// `[notify]`.
    pub notify: notify::Config,
    /// `[[modbus]]`, one per device.
    pub modbus: Vec<modbus::Config>,
    /// `[[opcua]]`, one per server.
    pub opcua: Vec<opcua::Config>,
    /// `[[mqtt]]`, one per broker.
    pub mqtt: Vec<mqtt::Config>,
    /// `[[loop]]`, one per control loop.
    pub loops: Vec<LoopConfig>,
    /// Collectors of edges, which a centre shows; no file has them.
    pub forwarded: Vec<String>,
}

/// One control loop, `[[loop]]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopConfig {
    /// The loop's name, as the plant writes it.
    pub id: String,
    /// What it controls, for people.
    #[serde(default)]
    pub description: String,
    /// What it belongs to (unit, area), for people.
    #[serde(default)]
    pub group: String,
    /// Time between two diagnoses (s), where it differs from `[schedule]`.
    #[serde(default)]
    pub period_s: Option<f64>,
    /// Span of OP (OP unit), 100 for per cent. Without it f is reported in OP units.
    #[serde(default)]
    pub op_span: Option<f64>,
    /// The controller's output limits (OP unit): saturation is judged against them.
    #[serde(default, deserialize_with = "crate::collect::pair::pair")]
    pub op_limits: Option<[f64; 2]>,
    /// A PV that has not changed for longer is flagged as stale (s).
    #[serde(default)]
    pub frozen_pv_s: Option<f64>,
    /// Controller output.
    pub op: TagConfig,
    /// Process variable.
    pub pv: TagConfig,
    /// Set point.
    #[serde(default)]
    pub sp: Option<TagConfig>,
    /// Automatic or not.
    #[serde(default)]
    pub mode: Option<TagConfig>,
    /// The valve's measured position.
    #[serde(default)]
    pub mv: Option<TagConfig>,
    /// Other measurements, `[[loop.tag]]`.
    #[serde(default)]
    pub tag: Vec<TagConfig>,
    /// Tags of other loops that may explain this one: `"auto"` for PV of its `group`, or names like `"FIC203.pv"`.
    #[serde(default)]
    pub candidates: Option<Candidates>,
    /// Loops whose stream enters this one, by their `id`.
    #[serde(default)]
    pub upstream: Vec<String>,
    /// What its swing costs, `[loop.cost]`.
    #[serde(default)]
    pub cost: Option<work::CostConfig>,
    /// Write-back, `[loop.writeback]`; off where it is left out.
    #[serde(default)]
    pub writeback: Option<writeback::LoopConfig>,
}

/// Reads a file.
///
/// # Errors
/// Everything wrong with it, in the order of the file.
pub fn load(path: &Path) -> Result<Config, Vec<Diagnostic>> {
    parse(&path.display().to_string(), &text(path)?)
}

/// The tables of a file as they stand, whatever is wrong with them or missing: at commissioning there is no loop yet.
///
/// # Errors
/// Why it cannot be read, or is no TOML.
pub fn tables(path: &Path) -> Result<toml::Table, Vec<Diagnostic>> {
    let (file, text) = (path.display().to_string(), text(path)?);
    let mut report = Report::new(&file, &text);
    Source::parse(&text, &mut report);
    let wrong = report.finish();
    if !wrong.is_empty() {
        return Err(wrong);
    }
    let unread = |error: toml::de::Error| vec![Diagnostic::of_file(&file, error.message().to_string())];
    text.parse().map_err(unread)
}

/// `[server]` of a file, and everything wrong with the file. A daemon that runs has refused a wrong one, and goes on with the one
/// before.
///
/// # Errors
/// As [`load`], where `[server]` cannot be read either.
pub fn server(path: &Path) -> Result<(serve::Config, Vec<Diagnostic>), Vec<Diagnostic>> {
    let (parts, wrong) = read(&path.display().to_string(), &text(path)?);
    match parts.server {
        Some(server) => Ok((server, wrong)),
        None => Err(wrong),
    }
}

/// The text of a file.
fn text(path: &Path) -> Result<String, Vec<Diagnostic>> {
    let file = path.display().to_string();
    let unreadable = |why: String| vec![Diagnostic::of_file(&file, format!("cannot read: {why}"))];
    let in_words = |error| unreadable(files::in_words(&error));
    let mut bytes = Vec::new();
    let opened = File::open(path).map_err(in_words)?;
    opened.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(in_words)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(unreadable(format!("larger than {MAX_BYTES} bytes")));
    }
    if is_utf16(&bytes) {
        let said = "this is UTF-16 text: save it as UTF-8, which editors offer when a file is saved";
        return Err(vec![Diagnostic { line: 1, column: 1, ..Diagnostic::of_file(&file, said.into()) }]);
    }
    String::from_utf8(bytes).map_err(|error| {
        let good = String::from_utf8_lossy(&error.as_bytes()[..error.utf8_error().valid_up_to()]);
        let mut report = Report::new(&file, &good);
        report.at(good.len(), "not UTF-8 text: save the file as UTF-8".into());
        report.finish()
    })
}

/// Whether a text is two bytes a sign, by its mark or by the zeros of its first two.
fn is_utf16(bytes: &[u8]) -> bool {
    let mark = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    mark || matches!(bytes, [0, low, 0, other, ..] | [low, 0, other, 0, ..] if *low > 0 && *other > 0)
}

/// Reads the text of a file that is called `file` in the errors.
///
/// # Errors
/// As [`load`].
pub fn parse(file: &str, text: &str) -> Result<Config, Vec<Diagnostic>> {
    let (parts, diagnostics) = read(file, text);
    match (parts.whole(), diagnostics.is_empty()) {
        (Some(config), true) => Ok(config),
        _ => Err(diagnostics),
    }
}

/// What of a text could be read, and everything wrong with it.
fn read(file: &str, text: &str) -> (section::Parts, Vec<Diagnostic>) {
    let mut report = Report::new(file, text);
    let source = Source::parse(text, &mut report);
    let whole = report.is_clean();
    let parts = section::parts(&source, &mut report);
    if whole {
        // Rules across sections would blame the wrong line in a file whose structure had to be guessed.
        rules::check(&source, &parts, &mut report);
    }
    (parts, report.finish())
}

#[cfg(test)]
mod tests;
