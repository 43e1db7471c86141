//! Words between samples: a title above a header that comes again, or a header of another kind, says that another table begins there.
//! Titles and footers of pages come again and again.

use super::error::{TableError, shown};
use super::layout::{Body, Layout, VALUES};
use super::names::{Meaning, Name};
use super::number;
use super::odd_rows::is_header_again;
use super::source::{Cell, Rows};
use super::stamp;
use crate::signal::Role;
use std::collections::{BTreeMap, BTreeSet};

/// Titles that are remembered: a table of more has one in every few rows.
const MOST: usize = 1024;
/// Characters by which titles are told apart.
const LONGEST: usize = 200;
/// Words of a line that numbers its page.
const PAGES: [&str; 16] = [
    "page",
    "pages",
    "pg",
    "seite",
    "blatt",
    "página",
    "pagina",
    "sida",
    "side",
    "strona",
    "strana",
    "sivu",
    "sayfa",
    "страница",
    "页",
    "ページ",
];

/// A line of words: its text as it stands there, and that by which it is compared.
struct Title {
    line: u64,
    written: String,
    text: String,
}

/// The titles of a table with a column for each tag.
#[derive(Default)]
pub struct Titles {
    /// Lines above the samples.
    above: BTreeSet<String>,
    /// Lines between them, and how often each comes.
    between: BTreeMap<String, u64>,
    /// The first line of words since the last sample that is none of a page.
    last: Option<Title>,
    /// Those that stand above a header.
    found: Vec<Title>,
}

impl Titles {
    /// A row above the samples.
    pub fn above(&mut self, rows: &dyn Rows) {
        self.above.insert(compared(&text(rows)));
    }

    /// A row between samples that is none.
    ///
    /// # Errors
    /// It is a header with other names than the first.
    pub fn add(&mut self, rows: &dyn Rows, layout: &Layout, line: u64) -> Result<(), TableError> {
        let written = text(rows);
        let text = compared(&written);
        if self.above.contains(&text) {
            return Ok(());
        }
        if is_header(rows) {
            return Err(TableError::refused(format!(
                "line {line}: {:?} is a second header: two tables in one file; save them apart",
                shown(&written)
            )));
        }
        if matches!(layout.body, Body::Long(_)) || text.is_empty() || is_of_a_page(&text) {
            return Ok(());
        }
        if self.between.len() < MOST || self.between.contains_key(&text) {
            *self.between.entry(text.clone()).or_default() += 1;
        }
        self.last.get_or_insert(Title { line, written, text });
        Ok(())
    }

    /// A row that is passed over, which may be the header once more.
    pub fn pass(&mut self, rows: &dyn Rows, layout: &Layout) {
        if self.found.len() < MOST && is_header_again(rows, layout) {
            self.found.extend(self.last.take());
        }
    }

    /// A sample.
    pub fn sample(&mut self) {
        self.last = None;
    }

    /// Refuses a title of its own above a header that comes again.
    ///
    /// # Errors
    /// Where it stands.
    pub fn decide(&self) -> Result<(), TableError> {
        let is_one = |title: &&Title| self.between.get(&title.text).is_none_or(|count| *count == 1);
        self.found.iter().find(is_one).map_or(Ok(()), |title| {
            Err(TableError::refused(format!(
                "line {}: {:?} stands above the header that comes again, so that the rows below it are of another table; save each \
                 table as a file",
                title.line,
                shown(&title.written)
            )))
        })
    }
}

/// The cells of a row as one text.
fn text(rows: &dyn Rows) -> String {
    let cells: Vec<String> = (0..rows.len()).map(|at| rows.cell(at).shown()).collect();
    let words: Vec<&str> = cells.iter().flat_map(|cell| cell.split_whitespace()).collect();
    words.join(" ").chars().take(LONGEST).collect()
}

/// A title in small letters without dates and times of day: those of a report for each day differ in them alone. Other numbers stay, for
/// they may be those of loops.
fn compared(text: &str) -> String {
    let mut words: Vec<String> = Vec::new();
    let mut is_behind_time = false;
    for word in text.split_whitespace() {
        let bare = word.trim_matches(|c: char| !c.is_alphanumeric());
        let is_half_of_day =
            is_behind_time && ["am", "pm"].iter().any(|half| bare.eq_ignore_ascii_case(half));
        is_behind_time = is_time(bare);
        if !is_behind_time && !is_half_of_day {
            words.push(word.to_lowercase());
        }
    }
    words.join(" ")
}

/// Whether a word is a date or a time of day. `10-01-02` may as well be the number of a loop: a date has the four digits of a year.
fn is_time(word: &str) -> bool {
    let is_year = |digits: &str| digits.len() == 4 && (digits.starts_with("19") || digits.starts_with("20"));
    let has_year = || word.split(|c: char| !c.is_ascii_digit()).filter(|part| !part.is_empty()).any(is_year);
    stamp::scan(word).is_some_and(|stamp| if stamp.has_date() { has_year() } else { word.contains(':') })
}

/// Whether a text has the word of a page in it: `Trend of unit 10, page 2`.
fn is_of_a_page(text: &str) -> bool {
    text.split(|c: char| !c.is_alphabetic()).any(|word| PAGES.contains(&word))
}

/// Whether a row names the columns of a table: times, and OP, PV or values.
fn is_header(rows: &dyn Rows) -> bool {
    let (mut of_times, mut of_values) = (false, false);
    for cell in (0..rows.len()).map(|at| rows.cell(at)).filter(|cell| !cell.is_blank()) {
        let Cell::Text(text) = cell else { return false };
        if number::scan(text).is_some() {
            return false;
        }
        let name = Name::new(text);
        match name.said().map(|said| said.meaning) {
            Some(Meaning::Time) => of_times = true,
            Some(Meaning::Role(Role::Op | Role::Pv)) => of_values = true,
            _ => of_values |= VALUES.contains(&name.plain()),
        }
    }
    of_times && of_values
}
