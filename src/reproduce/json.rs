//! The report for machines.

use super::report::{Cell, Report, Section, relative};
use crate::plot::Plot;
use serde_json::{Map, Value, json};

/// The report as one JSON object, `sections` by id: `rows` of the table by column key, `plots` with their points.
/// A number that does not exist is null.
pub fn json(report: &Report) -> Value {
    let sections: Map<String, Value> =
        report.sections.iter().map(|s| (s.id.to_owned(), section(s))).collect();
    json!({
        "paper": "Ivan & Lakshminarayanan, Ind. Eng. Chem. Res. 2009, 48, 3474-3483",
        "version": env!("CARGO_PKG_VERSION"),
        "sections": sections,
    })
}

fn section(section: &Section) -> Value {
    let rows: Vec<Value> = section
        .table
        .iter()
        .flat_map(|table| {
            table.rows.iter().map(|row| {
                let cells = table.columns.iter().zip(row);
                Value::Object(cells.map(|((key, _), value)| ((*key).to_owned(), cell(value))).collect())
            })
        })
        .collect();
    let columns: Map<String, Value> = section
        .table
        .iter()
        .flat_map(|table| table.columns.iter().map(|(key, title)| ((*key).to_owned(), json!(title))))
        .collect();
    json!({
        "title": section.title,
        "text": section.text,
        "columns": columns,
        "rows": rows,
        "plots": section.plots.iter().map(plot).collect::<Vec<_>>(),
    })
}

fn cell(cell: &Cell) -> Value {
    match cell {
        Cell::Text(text) => json!(text),
        Cell::Number(number, _) => json!(number),
        Cell::Versus { ours, paper, .. } => {
            json!({ "ours": ours, "paper": paper, "relative_difference": relative(*ours, *paper) })
        }
        Cell::Range { of, .. } => match of {
            Some([low, median, high]) => json!({ "least": low, "median": median, "largest": high }),
            None => Value::Null,
        },
    }
}

fn plot(plot: &Plot) -> Value {
    let series = plot.panels.iter().flat_map(|panel| {
        panel.series.iter().map(|series| {
            let (x, y): (Vec<f64>, Vec<f64>) = series.points.iter().copied().unzip();
            json!({ "name": series.name, "axis": panel.y, "x": x, "y": y })
        })
    });
    json!({ "title": plot.title, "x": plot.x, "series": series.collect::<Vec<_>>() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::report::{Style, Table};

    #[test]
    fn numbers_that_do_not_exist_are_null() {
        let row = vec![
            Cell::Number(Some(f64::NAN), Style::Power),
            Cell::Versus { ours: Some(3.0), paper: Some(0.0), style: Style::Power },
            Cell::range(&[], Style::Power),
        ];
        let table = Some(Table { columns: vec![("a", "A"), ("b", "B"), ("c", "C")], rows: vec![row] });
        let report = Report { sections: vec![Section { id: "one", table, ..Section::default() }] };
        let rows = &json(&report)["sections"]["one"]["rows"];
        assert_eq!(
            rows,
            &json!([{ "a": null, "b": { "ours": 3.0, "paper": 0.0, "relative_difference": null }, "c": null }])
        );
    }
}
