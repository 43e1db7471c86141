//! Headers in two rows: names of loops above those of their columns, and cells that are merged over several columns; and headers
//! that have no name for the first column.

use super::error::{TableError, listed};
use super::layout::{Seen, SeenRow};
use super::names::{Meaning, Name, as_unit};
use super::roles::Trouble;
use super::time::WhatKind;
use super::vocabulary;
use std::collections::BTreeSet;

/// Rows by which a table of R is known.
const R_ROWS: usize = 3;
/// Rows in which a column without a name has to hold something.
const HOLD: usize = 20;

/// The names of a header. R and pandas have no name for the first column, which numbers the rows or has their times. `#` with a blank
/// behind it is a mark of the whole line, as numpy writes it: `# t op pv`.
pub fn named(header: &[Seen], below: &[SeenRow]) -> Vec<Name> {
    let first = &below[..below.len().min(R_ROWS)];
    let is_shorter = |(_, cells): &SeenRow| cells.len() + 1 == header.len();
    let header = match header {
        [mark, names @ ..]
            if mark.text.trim() == "#" && !first.is_empty() && first.iter().all(is_shorter) =>
        {
            names
        }
        all => all,
    };
    let longer = first.len() == R_ROWS && first.iter().all(|(_, cells)| cells.len() == header.len() + 1);
    let names: Vec<Name> = header.iter().map(|cell| Name::new(&cell.text)).collect();
    let is_time = |name: &Name| name.said().is_some_and(|said| said.meaning == Meaning::Time);
    let numbered =
        |(row, (_, cells)): (usize, &SeenRow)| cells[0].text.trim_matches('"') == (row + 1).to_string();
    let dated = |(_, cells): &SeenRow| cells[0].kind == WhatKind::Dated;
    let index = longer
        && (first.iter().enumerate().all(numbered) || !names.iter().any(is_time) && first.iter().all(dated));
    index.then(|| Name::new("")).into_iter().chain(names).collect()
}

/// Text that is no unit.
fn is_word(cell: &Seen) -> bool {
    // `Min` is the least of something here.
    let is_unit = as_unit(&cell.text).is_some_and(|unit| !unit.eq_ignore_ascii_case("min"));
    cell.kind == WhatKind::Nothing && !is_unit
}

/// Whether a name is that of a part of what a tag has: its value, how good that is, or the least of many.
fn is_part(name: &Name) -> bool {
    const OF_MANY: [&str; 8] = ["min", "max", "minimum", "maximum", "avg", "average", "mean", "std"];
    let plain = name.plain();
    vocabulary::VALUES.contains(&plain)
        || name.quality_of().is_some()
        || OF_MANY.contains(&plain)
        || plain == "bad"
}

/// Whether the names of a header go on in the first row below: `FIC101.OP,,FIC101.PV,` over `Value,Confidence,Value,Confidence`.
/// A column to the right of a name has none itself, holds something, and has a word there.
pub fn goes_on(header: &[Seen], below: &[SeenRow]) -> bool {
    let Some(((_, next), samples)) = below.split_first() else { return false };
    let blank = |at: usize| header.get(at).is_none_or(|cell| cell.kind == WhatKind::Blank);
    let holds = |at: usize| {
        let mut rows = samples.iter().take(HOLD).filter_map(|(_, row)| row.get(at));
        rows.any(|cell| !matches!(cell.kind, WhatKind::Blank))
    };
    let names = header.iter().filter(|cell| cell.kind == WhatKind::Nothing).count();
    let words = next.iter().filter(|cell| is_word(cell)).count();
    let numbers =
        next.iter().any(|cell| matches!(cell.kind, WhatKind::Number | WhatKind::Dated | WhatKind::Clock));
    let parts = || next.iter().any(|cell| is_part(&Name::new(&cell.text)));
    // What takes longest is asked last.
    names > 1
        && words > 1
        && !numbers
        && (1..next.len()).any(|at| blank(at) && is_word(&next[at]) && holds(at))
        && parts()
}

/// The names of a header below a row of loops, `FIC101.OP`; a cell that is merged over several columns names the first of them.
/// `None` where the row above does not name two.
pub fn under_loops(above: &[Seen], header: &[Seen]) -> Option<Vec<Name>> {
    fn text(cell: &Seen) -> Option<&str> {
        (cell.kind == WhatKind::Nothing).then_some(cell.text.trim())
    }
    let is_known = |name: &Name| name.said().is_some();
    if header.iter().any(|cell| matches!(cell.kind, WhatKind::Number | WhatKind::Dated | WhatKind::Clock)) {
        return None;
    }
    let (mut loops, mut owner) = (BTreeSet::new(), None);
    let name = |(at, cell): (usize, &Seen)| {
        owner = above.get(at).and_then(text).or(owner);
        loops.extend(owner);
        let own = Name::new(&cell.text);
        let is_time = own.said().is_some_and(|said| said.meaning == Meaning::Time);
        match owner {
            Some(owner) if cell.kind != WhatKind::Blank && !is_time => {
                Name::new(&format!("{owner}.{}", cell.text))
            }
            // `FIC101.OP` above nothing, or `Time`.
            _ if own.is_none() => above.get(at).and_then(text).map(Name::new).filter(is_known).unwrap_or(own),
            _ => own,
        }
    };
    let names = header.iter().enumerate().map(name).collect();
    (loops.len() > 1).then_some(names)
}

/// What is said where no column of a header in two rows is OP or PV: `FIC101.OP.Min` is neither.
pub fn no_part(trouble: Trouble, names: &[Name]) -> Trouble {
    match trouble {
        Trouble::Missing(missing) => Trouble::Refused(TableError::refused(format!(
            "the header has two rows, and no column {}: it has {}; name them with --time, --op and --pv, by number from 1",
            missing.join(", "),
            listed(names.iter().map(|name| name.full.as_str()))
        ))),
        refused => refused,
    }
}
