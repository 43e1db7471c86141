//! What divides the cells of a text, decided by the header that it gives.

use super::blanks::Blanks;
use super::delimited::Lines;
use super::error::{TableError, shown};
use super::layout::{Layout, Looked, PREAMBLE, first_rows, look};
use super::options::{Options, Told};
use super::source::{Kind, Rows, Source};
use super::stated_zone::state;
use super::text::Encoding;

/// What divides cells, the usual ones.
const SEPARATORS: [u8; 4] = [b',', b';', b'\t', b'|'];
/// A sign that stands in no line, so that it is one cell.
const NO_SEPARATOR: u8 = 0x1f;

/// What divides cells, and the header that it gives; `part`: OP or PV may be in another file.
pub fn dialect(
    source: Source<'_>,
    kind: &Kind,
    head: &[u8],
    options: &Options,
    told: &Told,
    part: bool,
) -> Result<(u8, Layout), TableError> {
    let Kind::Text(encoding) = kind else {
        let mut rows = kind.rows(source, b',')?;
        let first = first_rows(rows.as_mut())?;
        let mut layout = look(&first, options, rows.row_name(), part).layout?;
        state(&mut layout, &first);
        return Ok((b',', layout));
    };
    // The last line of the head may be cut.
    let whole = head.iter().rposition(|byte| *byte == b'\n').filter(|_| head.len() >= 1 << 16);
    let head = &head[..whole.map_or(head.len(), |at| at + 1)];
    factor(head, encoding)?;
    let said = said_separator(head, encoding);
    let mut separators = match told.separator.or(said) {
        Some(one) => vec![one],
        None => SEPARATORS.to_vec(),
    };
    let open = separators.len() > 1;
    // Blanks divide where no sign does.
    let blanks = [Blanks::Ruled, Blanks::Two, Blanks::One].into_iter().filter(|_| open);
    let blanks = blanks.filter(|own| *own != Blanks::Ruled || encoding.is_ruled());
    separators.extend(blanks.map(Blanks::separator));
    let mut best: Option<(Looked, u8)> = None;
    for separator in separators {
        let by_sign = |(other, own): &(Looked, u8)| !other.single() && Blanks::of(*own).is_none();
        let by_run = |(other, own): &(Looked, u8)| !other.single() && *own == Blanks::Two.separator();
        let is_known =
            |best: &(Looked, u8)| by_sign(best) || separator == Blanks::One.separator() && by_run(best);
        if Blanks::of(separator).is_some() && best.as_ref().is_some_and(is_known) {
            continue;
        }
        let mut lines = Lines::new(head, encoding, separator);
        let mut first = first_rows(&mut lines)?;
        if said.is_some() && !first.is_empty() {
            first.remove(0);
        }
        let mut looked = look(&first, options, "line", part);
        if let (Ok(layout), true) = (&mut looked.layout, said.is_some()) {
            layout.lower();
        }
        if let Ok(layout) = &mut looked.layout {
            state(layout, &first);
        }
        if best.as_ref().is_none_or(|(other, _)| looked.worth() > other.worth()) {
            best = Some((looked, separator));
        }
    }
    let (looked, separator) = best.ok_or_else(|| TableError::refused("no separator"))?;
    if looked.single() && !looked.headless() && looked.layout.is_err() {
        return Err(one_column(head, encoding));
    }
    Ok((separator, looked.layout?))
}

/// `sep=;` in the first line, as spreadsheets want it.
fn said_separator(head: &[u8], encoding: &Encoding) -> Option<u8> {
    let mut lines = Lines::new(head, encoding, NO_SEPARATOR);
    lines.next().ok()??;
    let first = lines.cell(0).shown();
    let said = first.trim().trim_matches('"').strip_prefix("sep=")?.as_bytes().first().copied();
    // A tab at the end of the line is trimmed away.
    Some(said.filter(u8::is_ascii).unwrap_or(b'\t'))
}

/// Refuses the display of a matrix whose numbers have a common factor: `1.0e+03 *`.
fn factor(head: &[u8], encoding: &Encoding) -> Result<(), TableError> {
    let mut lines = Lines::new(head, encoding, NO_SEPARATOR);
    for _ in 0..PREAMBLE {
        let Some(line) = lines.next()? else { break };
        let text = lines.cell(0).shown();
        let number = text.trim().strip_suffix('*').map(str::trim).filter(|number| number.contains('e'));
        if number.is_some_and(|number| number.parse::<f64>().is_ok()) {
            return Err(TableError::refused(format!(
                "line {line}: {:?} is a common factor of all numbers, as MATLAB shows a matrix; save it with writematrix or writetable",
                shown(text.trim())
            )));
        }
    }
    Ok(())
}

/// Why a text of one column is no table.
fn one_column(head: &[u8], encoding: &Encoding) -> TableError {
    let mut lines = Lines::new(head, encoding, NO_SEPARATOR);
    let Ok(Some(line)) = lines.next() else { return TableError::refused("line 1: only one column") };
    let text = lines.cell(0).shown();
    let quoted = head.starts_with(b"\"") && SEPARATORS.iter().any(|sign| text.contains(char::from(*sign)));
    let hint = match quoted {
        true => "each line stands in quotes as a whole: take these quotes off",
        false => "cells are divided by comma, semicolon, tab, | or blanks, others with --separator",
    };
    TableError::refused(format!("line {line}: only one column, {:?}; {hint}", shown(&text)))
}
