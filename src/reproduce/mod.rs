//! The paper reproduced (Ivan & Lakshminarayanan, Ind. Eng. Chem. Res. 2009, 48, 3474): its tables and figures,
//! ours beside theirs, and constant reinforcement against its rivals. Computes and renders to text; touches no
//! file. Everything is seeded: the same version writes the same report.

mod bench;
mod choices;
mod contest;
mod figures;
mod html;
mod json;
mod measured;
pub mod report;
mod srinivasan;
mod tables;

pub use html::page;
pub use json::json;
pub use measured::Measured;

use crate::sim::SpecError;
use report::{Report, Section};

/// One part of the report.
type Part = fn() -> Result<Section, SpecError>;

/// What the report is made of, in reading order.
const PARTS: [(&str, Part); 12] = [
    ("Table 2", tables::table_2),
    ("Table 3", tables::table_3),
    ("Table 4", tables::table_4),
    ("Table 5", tables::table_5),
    ("Figure 7", figures::figure_7),
    ("Figure 8", figures::figure_8),
    ("Figure 9", figures::figure_9),
    ("Figure 10", figures::figure_10),
    ("Figure 11", figures::figure_11),
    ("Rivals", || contest::contest(false)),
    ("Rivals under noise", || contest::contest(true)),
    ("Open choices", choices::open_choices),
];

/// Everything, on every core; `progress` is told the part about to be computed: its place from 0, of how many, its name.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn reproduce(
    records: &[Measured],
    mut progress: impl FnMut(usize, usize, &str),
) -> Result<Report, SpecError> {
    let parts = PARTS.len() + 1;
    let mut report = Report::default();
    for (at, (name, part)) in PARTS.iter().enumerate() {
        progress(at, parts, name);
        report.sections.push(part()?);
    }
    progress(PARTS.len(), parts, "Table 6");
    report.sections.push(measured::measured(records));
    Ok(report)
}
