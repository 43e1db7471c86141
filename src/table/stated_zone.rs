//! The zone that a table states beside its times: in a line above the header, `Time zone: Europe/Berlin`, or in a column,
//! `UTC offset`. It is that of times without an offset, unless their own header says one or somebody tells it.

use super::error::{TableError, shown};
use super::header_zone::HeaderZone;
use super::layout::{Layout, SeenRow};
use super::names::Name;
use super::number;
use super::options::Told;
use super::source::{Cell, Rows, TimeBase};
use super::stamp;
use super::time::WhatKind;

/// Names of a zone, in a few languages.
const NAMES: [&str; 24] = [
    "time zone",
    "timezone",
    "tz",
    "wwtimezone",
    "ww timezone",
    "timezone name",
    "time zone name",
    "utc offset",
    "utcoffset",
    "gmt offset",
    "gmtoffset",
    "timezone offset",
    "time zone offset",
    "offset from utc",
    "zeitzone",
    "fuseau horaire",
    "zona horaria",
    "fuso orario",
    "fuso horário",
    "tijdzone",
    "tidszon",
    "часовой пояс",
    "时区",
    "タイムゾーン",
];

fn is_name(name: &str) -> bool {
    NAMES.contains(&Name::new(name).plain())
}

/// Gives a layout the zone that is stated in the first rows of its table.
pub fn state(layout: &mut Layout, rows: &[SeenRow]) {
    let above = rows.iter().take_while(|(line, _)| *line < layout.line).find_map(|(_, row)| {
        let cells: Vec<&str> = row.iter().map(|cell| cell.text.as_str()).collect();
        above(&cells)
    });
    layout.zone = above.or_else(|| beside(layout, rows)).and_then(|text| HeaderZone::stated(&text));
}

/// The zone in a line above the header: `Time zone: Europe/Berlin` in one cell, or the name and the zone in two.
fn above(cells: &[&str]) -> Option<String> {
    let next = |at: usize| cells[at + 1..].iter().map(|cell| cell.trim()).find(|cell| !cell.is_empty());
    let of_cell = |at: usize| {
        let cell = cells[at].trim().trim_start_matches(['#', '*', '/', ';', ' ']);
        let divided = cell.split_once([':', '=']).filter(|(name, _)| is_name(name));
        let first = divided.map(|(_, zone)| zone.trim()).filter(|zone| !zone.is_empty());
        match first {
            // Commas within the zone have divided it: `(UTC+01:00) Amsterdam, Berlin`.
            Some(first) if matches!(HeaderZone::stated(first), Some(HeaderZone::Words(_))) => {
                let rest = cells[at + 1..].iter().map(|cell| cell.trim()).filter(|cell| !cell.is_empty());
                Some([first].into_iter().chain(rest).collect::<Vec<_>>().join(", "))
            }
            Some(first) => Some(first.to_string()),
            None if divided.is_some() || is_name(cell) => next(at).map(str::to_string),
            None => None,
        }
    };
    (0..cells.len()).find_map(of_cell)
}

/// The first zone in a column of zones.
fn beside(layout: &Layout, rows: &[SeenRow]) -> Option<String> {
    let at = column(layout)?;
    let mut cells = rows.iter().filter(|(line, _)| *line > layout.line).filter_map(|(_, row)| row.get(at));
    let first = cells.find(|cell| cell.kind != WhatKind::Blank)?;
    // `TZ` may be the tag of a temperature.
    let is_tag = layout.names[at].plain() == "tz" && first.kind == WhatKind::Number;
    (!is_tag).then(|| first.text.trim().to_string())
}

/// The column of zones.
fn column(layout: &Layout) -> Option<usize> {
    if layout.pairs.is_some() {
        return None;
    }
    (0..layout.names.len()).find(|at| *at != layout.time && NAMES.contains(&layout.names[*at].plain()))
}

/// Whether a column of zones says the same in every row.
pub struct ZoneColumn {
    at: Option<usize>,
    first: Option<String>,
}

impl ZoneColumn {
    /// Nothing is looked at where somebody told the zone.
    pub fn of(layout: &Layout, told: &Told) -> Self {
        let is_told = told.zone.name.is_some() && !told.is_default("tz");
        let at = if is_told { None } else { column(layout) };
        Self { at, first: None }
    }

    /// One more row.
    ///
    /// # Errors
    /// It says another zone than the first, and its time has no offset.
    pub fn add(&mut self, rows: &dyn Rows, layout: &Layout, line: u64) -> Result<(), TableError> {
        let Some(at) = self.at.filter(|at| !rows.cell(*at).is_blank()) else { return Ok(()) };
        let own = rows.cell(at).shown();
        let first = self.first.get_or_insert_with(|| own.clone());
        // A temperature is another in every row.
        if *first == own || layout.names[at].plain() == "tz" && number::scan(&own).is_some() {
            return Ok(());
        }
        if !is_open(&rows.cell(layout.time)) {
            return Ok(());
        }
        Err(TableError::refused(format!(
            "{} {line}, column {} ({}): {:?} where {:?} was, and the times have no offset; write it behind each of them, or say \
             their zone with --tz, such as Europe/Berlin",
            rows.row_name(),
            at + 1,
            layout.names[at].full,
            shown(&own),
            shown(first)
        )))
    }
}

/// Whether a zone that the file states beside a time applies to it.
fn is_open(time: &Cell<'_>) -> bool {
    match time {
        Cell::Text(text) => stamp::scan(text).is_some_and(|own| own.has_date() && own.offset.is_none()),
        // Only a zone given by an option applies to INT96.
        Cell::Moment { base, .. } => *base == TimeBase::Civil,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zone_beside_times_moves_those_without_an_offset_alone() {
        let moment = |base| is_open(&Cell::Moment { ns: 0, base });
        assert!(moment(TimeBase::Civil) && !moment(TimeBase::Utc) && !moment(TimeBase::Int96));
        assert!(is_open(&Cell::Text("2026-06-01 06:00:00")));
        assert!(!is_open(&Cell::Text("2026-06-01T06:00:00+02:00")) && !is_open(&Cell::Number(1.0)));
    }

    #[test]
    fn lines_above_the_header_state_a_zone() {
        for (cells, expected) in [
            (&["Time Zone", "Europe/Berlin"][..], Some("Europe/Berlin")),
            (&["Time zone:", "Europe/Berlin", "User:", "me"], Some("Europe/Berlin")),
            (&["# timezone: America/Chicago"], Some("America/Chicago")),
            (&["Timezone: UTC+02:00"], Some("UTC+02:00")),
            (&["User", "me", "UTC offset", "+02:00"], Some("+02:00")),
            (&["Time zone: (UTC+01:00) Amsterdam", " Berlin"], Some("(UTC+01:00) Amsterdam, Berlin")),
            (&["Time zone"], None),
            (&["Exported: 2026-06-15 10:00", "tz"], None),
            (&[], None),
        ] {
            assert_eq!(above(cells).as_deref(), expected, "{cells:?}");
        }
    }
}
