//! Rows that are no samples, and rows by which a table is another than it seems.

use super::blanks::TOO_WIDE;
use super::error::{TableError, shown};
use super::layout::{Body, Layout};
use super::names::{Name, as_unit, controller};
use super::number;
use super::source::{Cell, Rows};
use super::stamp;
use super::time;
use crate::signal::Role;

/// A comment, or the header once more.
pub fn passed_over(rows: &dyn Rows, layout: &Layout) -> bool {
    is_header_again(rows, layout) || rows.cell(0).is_comment() || is_ruler(rows)
}

/// Whether the name of the times stands where a time should be.
pub fn is_header_again(rows: &dyn Rows, layout: &Layout) -> bool {
    let header = layout.names[layout.time].full.as_str();
    let again =
        matches!(rows.cell(layout.time), Cell::Text(text) if text.trim().trim_matches('"').trim() == header);
    again && !header.is_empty()
}

/// Words that stand in the place of a value in a row of totals or averages.
const TOTALS: [&str; 22] = [
    "total",
    "totals",
    "grand total",
    "subtotal",
    "sum",
    "average",
    "mean",
    "avg",
    "summe",
    "gesamt",
    "gesamtsumme",
    "zwischensumme",
    "mittelwert",
    "durchschnitt",
    "somme",
    "moyenne",
    "totale",
    "media",
    "promedio",
    "suma",
    "итого",
    "среднее",
];

/// Whether a row has the word of a total or an average where others have OP or PV: the numbers beside it are none of its time.
pub fn is_total(rows: &dyn Rows, layout: &Layout) -> bool {
    let Body::Wide(wide) = &layout.body else { return false };
    let is_word = |text: &str| {
        let own = text.trim().trim_end_matches(':');
        own.starts_with(char::is_alphabetic) && TOTALS.contains(&own.to_lowercase().as_str())
    };
    let mut columns = wide.columns.iter().zip(&wide.roles);
    columns.any(|(at, role)| {
        let is_value = matches!(role, Some(Role::Op | Role::Pv));
        is_value && matches!(rows.cell(*at), Cell::Text(text) if is_word(text))
    })
}

/// Refuses the header once more with its columns in another order: two tables in one file.
pub fn same_header(rows: &dyn Rows, layout: &Layout, line: u64) -> Result<(), TableError> {
    if rows.cell(0).is_comment() || is_ruler(rows) || rows.len() != layout.names.len() {
        return Ok(());
    }
    let other = (0..rows.len()).find(|at| Name::new(&rows.cell(*at).shown()).full != layout.names[*at].full);
    other.map_or(Ok(()), |at| {
        Err(TableError::refused(format!(
            "line {line}: the header comes again with {:?} where {:?} was: two tables in one file; save them apart",
            shown(&rows.cell(at).shown()),
            shown(&layout.names[at].full)
        )))
    })
}

/// Whether a cell of times may be none: it is blank, or begins with a letter.
pub fn begins_with_a_word(cell: &Cell<'_>) -> bool {
    match cell {
        Cell::Text(text) => !stamp::unmarked(text).trim_start().starts_with(|c: char| c.is_ascii_digit()),
        other => other.is_blank(),
    }
}

/// The tag of a controller in a row that has nothing else: a title of what stands below it.
pub fn title(rows: &dyn Rows) -> Option<String> {
    let mut filled = (0..rows.len()).map(|at| rows.cell(at)).filter(|cell| !cell.is_blank());
    let (Some(Cell::Text(text)), None) = (filled.next(), filled.next()) else { return None };
    controller(Name::new(text).plain())
}

/// Whether a row is none of the table: words, such as the number of a page, where others have a time, and nothing in OP and PV.
pub fn is_no_sample(rows: &dyn Rows, layout: &Layout) -> bool {
    let first = rows.cell(layout.time);
    let words = matches!(&first, Cell::Text(text) if text.trim_start().starts_with(char::is_alphabetic));
    let second = layout.clock.map(|at| rows.cell(at));
    let is_time = || time::What::of(&first, second.as_ref()).kind() != time::WhatKind::Nothing;
    let has_number = |at: usize| match rows.cell(at) {
        Cell::Text(text) => number::scan(text).is_some(),
        own => !own.is_blank(),
    };
    let holds = || match &layout.body {
        Body::Wide(wide) => {
            let columns = wide.columns.iter().zip(&wide.roles);
            columns
                .filter(|(_, role)| matches!(role, Some(Role::Op | Role::Pv)))
                .any(|(at, _)| has_number(*at))
        }
        Body::Long(long) => has_number(long.value),
    };
    words && !is_time() && !holds()
}

/// Refuses a title of another loop between samples, and a row of other units than the first: two tables in one file. Else whether the
/// row is no sample.
pub fn another_table(
    rows: &dyn Rows,
    layout: &Layout,
    line: u64,
    first: Option<&str>,
) -> Result<bool, TableError> {
    let Body::Wide(wide) = &layout.body else { return Ok(is_no_sample(rows, layout)) };
    if let Some(own) = title(rows).filter(|own| first != Some(own.as_str())) {
        return Err(TableError::refused(format!(
            "line {line}: {} stands alone between samples, so that those below it are of another loop; save each loop as a file",
            own.to_uppercase()
        )));
    }
    for ((at, role), unit) in wide.columns.iter().zip(&wide.roles).zip(&wide.units) {
        let (Some(_), Some(unit), Cell::Text(text)) = (role, unit, rows.cell(*at)) else { continue };
        if let Some(other) = as_unit(text).filter(|other| !other.eq_ignore_ascii_case(unit)) {
            return Err(TableError::refused(format!(
                "line {line}, column {}: the unit is {other:?} from here on, and was {unit:?}: two tables in one file; save them apart",
                at + 1
            )));
        }
    }
    Ok(is_no_sample(rows, layout))
}

/// A row of dashes below the header, as tools for databases print it.
fn is_ruler(rows: &dyn Rows) -> bool {
    let dashes = |at: usize| {
        let text = rows.cell(at).shown();
        let text = text.trim();
        text.bytes().all(|byte| matches!(byte, b'-' | b'+' | b' ')).then_some(text.len())
    };
    let begins = matches!(rows.cell(0), Cell::Text(text) if text.trim_start().starts_with("--"));
    let Some(widths) = (0..rows.len()).map(dashes).collect::<Option<Vec<usize>>>() else { return false };
    // A single dash stands for no value, but for a column of one character, too.
    let single = widths.iter().filter(|width| **width == 1).count();
    begins && !widths.contains(&0) && 2 * single < widths.len()
}

/// More cells than the header has: a decimal comma in a table that commas divide.
pub fn too_many(rows: &dyn Rows, layout: &Layout, line: u64, first: &Cell<'_>) -> Result<(), TableError> {
    let (got, want) = (rows.len(), layout.names.len());
    let filled = |at: usize| !rows.cell(at).is_blank();
    if got <= want || first.is_blank() || !(want..got).any(filled) {
        return Ok(());
    }
    if time::What::of(first, None).kind() == time::WhatKind::Nothing {
        return Ok(());
    }
    Err(TableError::refused(format!(
        "line {line}: {got} cells where the header has {want}; decimal commas need quotes, or semicolons between cells"
    )))
}

/// A cell that is wider than its column, below a ruler: what comes behind it stands in other columns.
pub fn too_wide(rows: &dyn Rows, line: u64, first: &Cell<'_>) -> Result<(), TableError> {
    let wide =
        (0..rows.len()).find(|at| matches!(rows.cell(*at), Cell::Text(text) if text.contains(TOO_WIDE)));
    let Some(wide) = wide.filter(|_| time::What::of(first, None).kind() != time::WhatKind::Nothing) else {
        return Ok(());
    };
    Err(TableError::refused(format!(
        "line {line}, column {}: the cell is wider than its column by the ruler, so that the next cannot be told; save the \
         table with a sign between cells",
        wide + 1
    )))
}

/// Another number of cells than the header has, where blanks divide them: an empty cell has no place there.
pub fn not_even(rows: &dyn Rows, layout: &Layout, line: u64, first: &Cell<'_>) -> Result<(), TableError> {
    let (got, want) = (rows.len(), layout.names.len());
    if got == want || time::What::of(first, None).kind() == time::WhatKind::Nothing {
        return Ok(());
    }
    Err(TableError::refused(format!(
        "line {line}: {got} cells where the header has {want}; blanks divide them, so that none may be empty, and names have \
         none within; try --separator blank, or save the table with a sign between cells"
    )))
}
