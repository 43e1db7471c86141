//! The report for people: one page without a script, nothing loaded from anywhere, light and dark.

use super::report::{Cell, Report, Section, Style, Table, relative};
use crate::plot::{self, COLOURS, STYLE, escape};
use std::fmt::Write;

/// The report as a page. Where ours is off by more than a factor of 2 the difference is set in red.
pub fn page(report: &Report) -> String {
    let mut out = HEAD.replace("@COLOURS@", COLOURS).replace("@STYLE@", STYLE);
    out.push_str("<header><h1>The paper reproduced</h1><p>Ivan &amp; Lakshminarayanan, Ind. Eng. Chem. Res. 2009, 48, 3474–3483: \
                  its tables and figures, ours beside theirs</p><p>stictiond ");
    out.push_str(env!("CARGO_PKG_VERSION"));
    out.push_str("</p></header>\n<nav>");
    for section in &report.sections {
        let short = section.title.split(':').next().unwrap_or_default();
        put(&mut out, format_args!("<a href=\"#{}\">{}</a> ", section.id, escape(short)));
    }
    out.push_str("</nav>\n<main>\n");
    for section in &report.sections {
        put_section(&mut out, section);
    }
    out.push_str("</main></body></html>\n");
    out
}

/// Writing to a string cannot fail.
fn put(out: &mut String, what: std::fmt::Arguments) {
    let _ = out.write_fmt(what);
}

fn put_section(out: &mut String, section: &Section) {
    put(out, format_args!("<section id=\"{}\"><h2>{}</h2>\n", section.id, escape(&section.title)));
    for paragraph in &section.text {
        put(out, format_args!("<p>{}</p>\n", escape(paragraph)));
    }
    if let Some(table) = &section.table {
        put_table(out, table);
    }
    if !section.plots.is_empty() {
        out.push_str("<div class=\"plots\">\n");
        for plot in &section.plots {
            put(
                out,
                format_args!(
                    "<figure><figcaption>{}</figcaption>{}</figure>\n",
                    escape(&plot.title),
                    plot::draw(plot)
                ),
            );
        }
        out.push_str("</div>\n");
    }
    out.push_str("</section>\n");
}

fn put_table(out: &mut String, table: &Table) {
    out.push_str("<div class=\"scroll\"><table><thead><tr>");
    let kind = |column: usize| table.rows.first().map(|row| &row[column]);
    for (at, (_, title)) in table.columns.iter().enumerate() {
        let title = escape(title);
        out.push_str(&match kind(at) {
            Some(Cell::Text(_)) | None => format!("<th>{title}</th>"),
            Some(Cell::Versus { .. }) => format!(
                "<th class=\"n\">{title}: ours</th><th class=\"n\">paper</th><th class=\"n\">difference</th>"
            ),
            Some(_) => format!("<th class=\"n\">{title}</th>"),
        });
    }
    out.push_str("</tr></thead><tbody>\n");
    let mut last = None;
    for row in &table.rows {
        // A rule where the first column changes, and its name only there.
        let first = Some(&row[0]);
        let same = last == first && matches!(row[0], Cell::Text(_));
        last = first;
        out.push_str(if same { "<tr class=\"same\">" } else { "<tr>" });
        for cell in row {
            put_cell(out, cell);
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

fn put_cell(out: &mut String, cell: &Cell) {
    match cell {
        Cell::Text(text) => put(out, format_args!("<td>{}</td>", escape(text))),
        Cell::Number(value, style) => {
            put(out, format_args!("<td class=\"n\">{}</td>", number(*value, *style)))
        }
        Cell::Versus { ours, paper, style } => {
            let difference = relative(*ours, *paper);
            let far = difference.is_some_and(|d| !(-0.5..=1.0).contains(&d));
            put(
                out,
                format_args!(
                    "<td class=\"n ours\">{}</td><td class=\"n\">{}</td><td class=\"n{}\">{}</td>",
                    number(*ours, *style),
                    number(*paper, *style),
                    if far { " far" } else { "" },
                    difference.map_or("–".into(), percent),
                ),
            );
        }
        Cell::Range { of, style } => match of {
            Some([low, median, high]) => put(
                out,
                format_args!(
                    "<td class=\"n\">{} <small>{} … {}</small></td>",
                    number(Some(*median), *style),
                    number(Some(*low), *style),
                    number(Some(*high), *style),
                ),
            ),
            None => out.push_str("<td class=\"n\">–</td>"),
        },
    }
}

/// A relative difference; what rounds to nothing has no sign.
fn percent(difference: f64) -> String {
    let text = format!("{:+.1} %", 100.0 * difference);
    if text.trim_start_matches(['+', '-']) == "0.0 %" { "0.0 %".into() } else { text.replace('-', "−") }
}

/// A number as the tables write it.
fn number(value: Option<f64>, style: Style) -> String {
    match (value.filter(|v| v.is_finite()), style) {
        (None, _) => "–".into(),
        (Some(v), Style::Fixed(digits)) => format!("{v:.digits$}"),
        (Some(0.0), Style::Power) => "0".into(),
        (Some(v), Style::Power) if (0.01..1000.0).contains(&v.abs()) => format!("{v:.3}"),
        (Some(v), Style::Power) => {
            let text = format!("{v:.1e}");
            match text.split_once('e') {
                Some((mantissa, exponent)) => {
                    format!("{mantissa}·10<sup>{}</sup>", exponent.replace('-', "−"))
                }
                None => text,
            }
        }
    }
}

const HEAD: &str = r##"<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>stictiond: the paper reproduced</title>
<style>
@COLOURS@* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); font: 14px/1.45 system-ui, sans-serif; }
header { display: flex; flex-wrap: wrap; gap: 0 1.5rem; align-items: baseline; padding: .6rem 1rem; border-bottom: 1px solid var(--rule); }
header p { margin: 0; color: var(--faint); }
h1 { font-size: 1.1rem; margin: 0; } h2 { font-size: 1.05rem; margin: 0; }
nav { padding: .4rem 1rem; } nav a { margin-right: .8rem; color: var(--op); }
main { padding: 0 1rem 1rem; display: grid; gap: 1rem; max-width: 90rem; }
section { background: var(--sheet); border: 1px solid var(--rule); padding: .8rem; min-width: 0; }
section > p { max-width: 52rem; margin: .5rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: .6rem 0; }
th, td { text-align: left; padding: .2rem .6rem; border-top: 1px solid var(--rule); vertical-align: baseline; }
th { color: var(--faint); font-weight: normal; border-top: 0; vertical-align: bottom; }
.n { text-align: right; font-variant-numeric: tabular-nums; } td.n { white-space: nowrap; }
td:first-child { min-width: 7rem; } td.ours { font-weight: 600; } td.far { color: var(--look); } small { color: var(--faint); }
sup { line-height: 0; }
tr.same td { border-top-color: transparent; } tr.same td:first-child { color: transparent; }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(26rem, 1fr)); gap: 1rem; }
figure { margin: 0; min-width: 0; } figcaption { color: var(--faint); margin: .4rem 0 .2rem; }
svg { display: block; width: 100%; height: auto; }
@STYLE@@media print { section { break-inside: avoid; } }
</style></head><body>
"##;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_by_hand() {
        assert_eq!(number(Some(0.00341), Style::Power), "3.4·10<sup>−3</sup>");
        assert_eq!(number(Some(0.0341), Style::Power), "0.034");
        assert_eq!(number(Some(2.498), Style::Fixed(2)), "2.50");
        assert_eq!(number(Some(f64::NAN), Style::Power), "–");
        assert_eq!([percent(-1e-4), percent(-0.52), percent(8.8)], ["0.0 %", "−52.0 %", "+880.0 %"]);
    }

    #[test]
    fn whatever_a_loop_is_called_stays_text() {
        let section = Section { id: "x", title: "<script>\"&".into(), ..Section::default() };
        let page = page(&Report { sections: vec![section] });
        assert!(page.contains("&lt;script&gt;&quot;&amp;") && !page.contains("<script"));
    }
}
