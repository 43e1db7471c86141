//! The analysis of Table 6 on records at hand: the paper's own are not public.

use super::bench::parallel;
use super::report::{Cell, Section, Style, Table};
use crate::diagnosis::{Settings, diagnose};
use crate::signal::Record;

/// A measured loop.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Its name.
    pub name: String,
    /// What is known of it, in words.
    pub label: String,
    /// The record.
    pub record: Record,
}

/// The paper's Table 6: f of its six loops [%].
const PAPER: [f64; 6] = [19.3, 33.4, 0.0, 47.3, 0.4, 5.0];

/// f of every record; without records the paper's numbers alone.
pub fn measured(records: &[Measured]) -> Section {
    let rows = parallel(records, |measured| {
        let diagnosis = diagnose(&measured.record, &Settings::default());
        let estimate = diagnosis.estimate.as_ref();
        vec![
            Cell::text(&measured.name),
            Cell::text(&measured.label),
            Cell::text(diagnosis.verdict.as_str()),
            Cell::Number(estimate.map(|e| e.f), Style::Fixed(3)),
            Cell::Number(estimate.map(|e| e.f_ci95[0]), Style::Fixed(3)),
            Cell::Number(estimate.map(|e| e.f_ci95[1]), Style::Fixed(3)),
            Cell::Number(estimate.map(|e| e.f_of_op_range), Style::Fixed(3)),
            Cell::Number(estimate.map(|e| e.delta_aic), Style::Fixed(0)),
            Cell::Text(diagnosis.reason),
        ]
    });
    let here = if records.is_empty() {
        "No records were given: --data DIR names a folder of CSV files, with or without an index.csv."
    } else {
        "Below is the same analysis on the records given. f in OP units, which are per cent of span where the \
         record says so."
    };
    Section {
        id: "table6",
        title: "In place of Table 6: measured loops".into(),
        text: vec![format!(
            "The paper's six industrial records are not public; their f were {} %. {here}",
            PAPER.map(|f| format!("{f:.1}")).join(", ")
        )],
        table: (!records.is_empty()).then(|| Table {
            columns: vec![
                ("loop", "loop"),
                ("label", "label"),
                ("verdict", "verdict"),
                ("f", "f [OP]"),
                ("f_low", "from"),
                ("f_high", "to"),
                ("f_of_op_range", "f / OP range"),
                ("evidence", "evidence ΔAIC"),
                ("reason", "reason"),
            ],
            rows,
        }),
        ..Section::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_records_it_says_how_to_give_some() {
        let section = measured(&[]);
        assert!(section.table.is_none());
        assert!(
            section.text[0].contains("19.3, 33.4, 0.0, 47.3, 0.4, 5.0") && section.text[0].contains("--data")
        );
    }
}
