//! The work list, for printing and for a spreadsheet.

use super::super::dto::plantwide::{MeasureItem, WorkItem, WorkListing};
use super::super::words::{percent, short};
use super::{document, when};
use crate::plantwide::Part;
use crate::plot::escape;
use std::fmt::Write;

/// The list as a page.
pub fn of_work(listing: &WorkListing) -> String {
    let watched = match listing.watched {
        1 => "1 suspicion that has not lasted yet".to_string(),
        many => format!("{many} suspicions that have not lasted yet"),
    };
    let mut body = format!(
        "<h1>Work list</h1><p class=\"faint\">stictiond {}, {}</p><p>{} to do, {} not at rest for an unknown cause, {watched}.</p>",
        env!("CARGO_PKG_VERSION"),
        when(listing.time.as_deref()),
        listing.standing,
        listing.unknown
    );
    if listing.standing == 0 {
        body += "<p>There is nothing to do.</p>";
    }
    for part in Part::ALL {
        let items = listing.items.iter().filter(|item| item.part == Some(part.as_str()));
        let items: Vec<&WorkItem> = items.collect();
        if !items.is_empty() {
            of_part(&mut body, part, &items);
        }
    }
    document("Work list", &body)
}

/// One part of the list.
fn of_part(body: &mut String, part: Part, items: &[&WorkItem]) {
    let note = part.note().map(|note| format!("<p class=\"faint\">{note}</p>")).unwrap_or_default();
    let _ = write!(body, "<h2>{}</h2>{note}", part.heading());
    *body += "<table><thead><tr><th>Loop</th><th>State</th><th>Cause</th><th>Why</th><th>May calm down with it</th>\
             <th class=\"number\">Cost</th><th>By, remark</th></tr></thead><tbody>";
    items.iter().for_each(|item| row(body, item));
    *body += "</tbody></table>";
}

fn row(out: &mut String, item: &WorkItem) {
    let cause = format!(
        "{}{}",
        item.cause.unwrap_or("–"),
        item.probability.map(|p| format!(", {}", escape(&percent(p)))).unwrap_or_default()
    );
    let _ = write!(
        out,
        "<tr><td>{}</td><td>{}<br><span class=\"faint\">{}</span></td><td>{cause}</td><td>{}{}</td><td>{}</td>\
         <td class=\"number\">{}</td><td>{}</td></tr>",
        escape(&item.id),
        item.state,
        when(item.since.as_deref()),
        escape(&item.why),
        escape(&helped(item)),
        escape(&item.victims.join(", ")),
        cost(item),
        escape(&[&item.by, &item.note].into_iter().flatten().cloned().collect::<Vec<_>>().join(": ")),
    );
}

/// What a repair changed, where that is known. An order may be open again for long: it is not said how the loop is now.
fn helped(item: &WorkItem) -> String {
    let sd = |own: &Option<MeasureItem>| own.as_ref().and_then(|own| own.error_sd);
    match (sd(&item.before), sd(&item.after)) {
        (Some(before), Some(after)) => {
            format!(
                " The error's standard deviation was {} before the repair and {} after it.",
                short(before),
                short(after)
            )
        }
        _ => String::new(),
    }
}

fn cost(item: &WorkItem) -> String {
    let unit = item.cost_unit.as_deref().unwrap_or_default();
    item.cost.map_or_else(|| "–".into(), |cost| format!("{} {}", short(cost), escape(unit)))
}

/// The list as CSV after RFC 4180. A cell that a spreadsheet would take for a formula begins with an apostrophe.
pub fn work_csv(listing: &WorkListing) -> String {
    let mut out = "loop,state,since,first,cause,probability,why,victims,cost,cost_unit,by,note,reopened,sd_before,sd_after,part\r\n".to_string();
    for item in &listing.items {
        let number = |x: Option<f64>| x.map(|x| x.to_string()).unwrap_or_default();
        let text = |x: &Option<String>| x.clone().unwrap_or_default();
        let sd = |own: &Option<MeasureItem>| number(own.as_ref().and_then(|own| own.error_sd));
        let cells = [
            item.id.clone(),
            item.state.to_string(),
            text(&item.since),
            text(&item.first),
            item.cause.unwrap_or_default().to_string(),
            number(item.probability),
            item.why.clone(),
            item.victims.join(" "),
            number(item.cost),
            text(&item.cost_unit),
            text(&item.by),
            text(&item.note),
            item.reopened.to_string(),
            sd(&item.before),
            sd(&item.after),
            item.part.unwrap_or_default().to_string(),
        ];
        let _ = write!(out, "{}\r\n", cells.map(|cell| quoted(&cell)).join(","));
    }
    out
}

/// First characters by which a spreadsheet takes a cell for a formula.
const ACTS: [char; 16] =
    ['=', '+', '-', '@', '\t', '\r', '\n', '＝', '＋', '－', '＠', '﹦', '﹢', '﹣', '﹫', '−'];

fn quoted(cell: &str) -> String {
    let acts = cell.starts_with(ACTS);
    let cell = if acts { format!("'{cell}") } else { cell.to_string() };
    if cell.contains(['"', ',', '\n', '\r']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::Cause;
    use crate::serve::WorkLine;
    use crate::signal::LoopId;
    use crate::work::order::Look;
    use crate::work::{Measure, Order, State};

    /// Looks that suspected a cause with this probability.
    fn looks(cause: Cause, probability: Option<f64>) -> Vec<Look> {
        let (cause, measure) = (Some((cause, probability)), Measure::default());
        vec![Look { at: 0.0, from: 0.0, cause, worth: 1.0, measure }]
    }

    #[test]
    fn an_order_that_is_open_again_is_not_said_to_be_as_after_its_repair() {
        let sd = |sd| Measure { error_sd: Some(sd), ..Measure::default() };
        let verified = Order {
            state: State::Open,
            before: Some((sd(2.0), 0.0)),
            after: Some(sd(0.5)),
            looks: looks(Cause::Valve, Some(0.9)).into(),
            ..Order::new(LoopId::new("FIC101"), 0.0)
        };
        let watched = Order::new(LoopId::new("FIC102"), 0.0);
        let lines = [verified, watched].map(|order| WorkLine { order, cost: None });
        let page = of_work(&WorkListing::of(lines.into(), false, 0.0));
        assert!(page.contains("deviation was 2.00 before the repair and 0.500 after it."), "{page}");
        let counted =
            "<p>1 to do, 0 not at rest for an unknown cause, 1 suspicion that has not lasted yet.</p>";
        assert!(page.contains(counted), "{page}");
        assert!(page.contains("<h2>What to do first</h2><table>"), "nothing is between them: {page}");
        assert!(!page.contains("<h2>Perhaps</h2>"), "{page}");
    }

    #[test]
    fn a_loop_whose_cause_is_not_known_stands_apart() {
        let of = |name: &str, state, cause, probability| Order {
            state,
            looks: looks(cause, probability).into(),
            ..Order::new(LoopId::new(name), 0.0)
        };
        let orders = [
            of("FIC101", State::Unexplained, Cause::Unknown, None),
            of("FIC102", State::Open, Cause::Tuning, Some(0.6)),
        ];
        let lines = orders.map(|order| WorkLine { order, cost: None });
        let listing = WorkListing::of(lines.into(), false, 0.0);
        let page = of_work(&listing);
        let at = |text: &str| page.find(text).unwrap_or_else(|| panic!("{text} in {page}"));
        assert!(at("<h2>Perhaps</h2><p class=\"faint\">less likely than") < at("FIC102"), "{page}");
        assert!(at("FIC102") < at("<h2>Not at rest, cause unknown</h2>"), "{page}");
        assert!(at("<h2>Not at rest, cause unknown</h2>") < at("FIC101"), "{page}");
        assert!(!page.contains("<h2>What to do first</h2>"), "{page}");
        let csv = work_csv(&listing);
        assert!(
            csv.lines().any(|line| line.starts_with("FIC102,open,") && line.ends_with(",perhaps")),
            "{csv}"
        );
    }

    #[test]
    fn cells_are_quoted_and_no_formulas() {
        for (cell, written) in [
            ("FIC1", "FIC1"),
            ("a, b", "\"a, b\""),
            ("say \"no\"", "\"say \"\"no\"\"\""),
            ("=1+1", "'=1+1"),
            ("＝A1", "'＝A1"),
        ] {
            assert_eq!(quoted(cell), written);
        }
    }
}
