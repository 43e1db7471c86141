//! What the cells of one tag are, counted over the whole file.

use super::error::{TableError, shown};
use super::evidence::Evidence;
use super::layout::Long;
use super::number::{self, Decimal};
use super::says::{are_letters, behind_number, measured};
use super::source::{Cell, Rows};
use super::stamp;
use super::words::Words;
use crate::signal::Role;

/// Different units behind the numbers of one column that are told apart.
const UNITS: usize = 8;
/// Cells with another unit than the rest that are left out: one in so many.
const ODD: u64 = 50;

/// Fewer steps in a mode than these may be an operator's own.
const FEW_STEPS: u64 = 20;

/// A tag as the table names it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Tag {
    /// Its loop, where the table says so.
    pub owner: String,
    /// Its name.
    pub name: String,
    /// Where its samples came from at first, where the table says so.
    pub source: Option<String>,
    /// The unit of its values.
    pub unit: Option<String>,
}

impl Tag {
    /// The tag of a row of a long table.
    pub(super) fn of_row(rows: &dyn Rows, long: &Long) -> Self {
        let text = |at: Option<usize>| {
            let text = at.map(|at| rows.cell(at).shown()).unwrap_or_default();
            meant(&text).to_string()
        };
        let some = |at: Option<usize>| Some(text(at)).filter(|text| !text.is_empty());
        Self {
            owner: text(long.owner),
            name: text(Some(long.tag)),
            source: some(long.source),
            unit: some(long.unit),
        }
    }
}

/// What a spreadsheet would take for a formula has a quote before it in our own exports, which is none of the name.
fn meant(text: &str) -> &str {
    const FORMULA: [char; 16] =
        ['=', '+', '-', '@', '\t', '\r', '\n', '＝', '＋', '－', '＠', '﹦', '﹢', '﹣', '﹫', '−'];
    const HIDDEN: [char; 6] = ['\'', ' ', '\u{a0}', '\u{3000}', '\u{200b}', '\u{feff}'];
    let formula = |rest: &&str| rest.trim_start_matches(HIDDEN).starts_with(FORMULA);
    text.strip_prefix('\'').filter(formula).unwrap_or(text)
}

/// Steps of a value from one row to the next.
#[derive(Clone, Copy, Debug, Default)]
pub struct Steps {
    all: u64,
    /// Those that change it.
    moved: u64,
}

impl Steps {
    pub fn add(&mut self, moved: bool) {
        self.all += 1;
        self.moved += u64::from(moved);
    }

    /// Whether the value changes by itself: in a fifth of the steps.
    pub fn moves(self) -> bool {
        self.moved * 5 > self.all
    }

    /// Whether there are more of them than an operator's own.
    pub fn are_many(self) -> bool {
        self.all > FEW_STEPS
    }

    /// Whether the value stays where it is: in all of many steps but one in fifty.
    pub fn rests(self) -> bool {
        self.are_many() && self.moved * 50 <= self.all
    }
}

/// What was counted of a tag.
#[derive(Clone, Debug)]
pub struct Channel {
    /// The tag.
    pub tag: Tag,
    /// What it is to the loop.
    pub role: Option<Role>,
    /// Its loop, where every tag of a table is taken and its name or an option tells it.
    pub control_loop: Option<String>,
    /// Its column from 1; 0 in a long table.
    pub column: usize,
    /// Cells that are not blank.
    pub cells: u64,
    /// Cells that are numbers under some decimal sign.
    pub numbers: u64,
    /// From each number to the next.
    steps: Steps,
    /// The same in rows whose mode is 0, and in those where it is 1.
    steps_in: [Steps; 2],
    /// What its numbers prove of the decimal sign.
    pub evidence: Evidence,
    /// The first cell that is no number: its line and what stands there.
    pub first_bad: Option<(u64, String)>,
    /// Units behind the numbers: how many cells have each, and the first one's line.
    units: Vec<(String, u64, u64)>,
    /// Its words, where it is a mode.
    pub words: Option<Words>,
    /// Its cells that are no numbers, where it is none.
    pub texts: Words,
    /// All its cells, where it is a tag that says whether the value of another is good.
    pub quality: Option<Words>,
    /// Whether it says of another tag if that is good, and nothing else.
    pub says_of_another: bool,
    /// Those that say it of this one, by their place in the plan.
    pub said_by: Vec<usize>,
    /// Cells that are stamps, and others than that of their row.
    pub other_times: u64,
    last: Option<f64>,
}

impl Channel {
    pub fn new(tag: Tag, role: Option<Role>, column: usize) -> Self {
        Self {
            tag,
            role,
            control_loop: None,
            column,
            cells: 0,
            numbers: 0,
            steps: Steps::default(),
            steps_in: [Steps::default(); 2],
            evidence: Evidence::default(),
            first_bad: None,
            units: Vec::new(),
            words: (role == Some(Role::Mode)).then(Words::default),
            texts: Words::default(),
            quality: None,
            says_of_another: false,
            said_by: Vec::new(),
            other_times: 0,
            last: None,
        }
    }

    /// One more cell of a row whose mode is 1, 0 or another; whether it may be a stamp: it is there, and neither a
    /// number nor a mode.
    pub fn add(&mut self, cell: &Cell<'_>, line: u64, mode: Option<bool>) -> bool {
        if cell.is_blank() {
            return false;
        }
        self.cells += 1;
        if let Some(words) = &mut self.quality {
            words.add(cell);
        }
        if let Some(words) = &mut self.words {
            words.add(cell);
            return false;
        }
        let value = match cell {
            Cell::Number(value) => Some(*value).filter(|value| value.is_finite()),
            Cell::Text(text) => measured(text).and_then(|number| {
                let value = number.value(Decimal::Point).or_else(|| number.value(Decimal::Comma))?;
                match self.column {
                    0 => self.evidence.add_of_tag(&number, line, &self.tag.name, text),
                    _ => self.evidence.add(&number, line, &self.tag.name, text),
                }
                self.unit(number.unit, line);
                Some(value)
            }),
            _ => None,
        };
        match value {
            Some(value) => {
                self.numbers += 1;
                if let Some(last) = self.last.replace(value) {
                    self.steps.add(last != value);
                    if let Some(one) = mode {
                        self.steps_in[usize::from(one)].add(last != value);
                    }
                }
            }
            None => {
                self.first_bad.get_or_insert_with(|| (line, shown(&cell.shown())));
                self.texts.add(cell);
            }
        }
        value.is_none()
    }

    /// Counts a stamp that is not that of its row.
    pub fn compare(&mut self, cell: &Cell<'_>, time: &Cell<'_>) {
        let other = match cell {
            Cell::Text(text) => {
                stamp::scan(text).is_some_and(|own| own.has_date()) && cell.shown() != time.shown()
            }
            Cell::Moment { ns, .. } => !matches!(time, Cell::Moment { ns: own, .. } if own == ns),
            _ => false,
        };
        self.other_times += u64::from(other);
    }

    fn unit(&mut self, unit: &str, line: u64) {
        match self.units.iter().position(|(own, ..)| own == unit) {
            Some(at) => self.units[at].1 += 1,
            None if self.units.len() < UNITS => self.units.push((unit.to_string(), 1, line)),
            None => {}
        }
    }

    /// Whether its value changes by itself.
    pub fn moves(&self) -> bool {
        self.steps.moves()
    }

    /// Whether its value changes by itself while the mode is 0, and not while it is 1.
    pub fn moves_in_zero(&self) -> bool {
        let [zero, one] = self.steps_in;
        zero.all > FEW_STEPS && zero.moves() && !one.moves()
    }

    /// Whether it does so while the mode is 1, and not while it is 0.
    pub fn moves_in_one(&self) -> bool {
        let [zero, one] = self.steps_in;
        one.all > FEW_STEPS && one.moves() && !zero.moves()
    }

    /// Whether it has cells and none of them can be used.
    pub fn is_text(&self) -> bool {
        let numbers = |words: &Words| words.numbers().is_some();
        self.cells > 0 && self.numbers == 0 && !self.words.as_ref().is_some_and(numbers)
    }

    /// What its cells have that keeps them from being numbers, in words; empty where it is not known.
    pub fn why_no_number(&self) -> String {
        let mark = self.first_bad.as_ref().and_then(|(_, cell)| number::mark(cell));
        mark.map_or_else(String::new, |mark| {
            format!(
                ": what {mark:?} behind a number means is not known; take it off, or write it into a column of its own, such as \
                 \"pv_status\", of which --good-values says what is good"
            )
        })
    }

    /// Whether the letters behind its numbers say how good these are.
    pub fn has_letters(&self) -> bool {
        let most = self.units.iter().max_by_key(|(_, count, _)| *count);
        let units = || self.units.iter().map(|(own, ..)| own.as_str());
        most.is_some_and(|(most, ..)| are_letters(units(), most))
    }

    /// Whether a word behind any of its numbers says how good it is; `letters` do so too.
    pub fn has_qualities(&self, letters: bool) -> bool {
        self.units.iter().any(|(own, ..)| behind_number(own, letters).1.is_some())
    }

    /// The unit behind its numbers; that of a tag which is no role may be anything.
    pub fn unit_or_none(&self, letters: bool) -> Result<String, TableError> {
        match self.unit_of_cells(letters) {
            Err(error) if self.role.is_some() => Err(error),
            unit => Ok(unit.unwrap_or("").to_string()),
        }
    }

    /// The unit behind its numbers, empty for none; `letters` of quality are none.
    ///
    /// # Errors
    /// Several, so that its numbers cannot be compared.
    fn unit_of_cells(&self, letters: bool) -> Result<&str, TableError> {
        let mut units: Vec<(&str, u64, u64)> = Vec::new();
        for (own, count, line) in &self.units {
            let unit = behind_number(own, letters).0;
            match units.iter_mut().find(|(known, ..)| *known == unit) {
                Some(known) => known.1 += count,
                None => units.push((unit, *count, *line)),
            }
        }
        let Some((unit, most, _)) = units.iter().copied().max_by_key(|(_, count, _)| *count) else {
            return Ok("");
        };
        let odd = units.iter().filter(|(own, ..)| *own != unit).min_by_key(|(.., line)| *line);
        let odd_ones: u64 = units.iter().map(|(_, count, _)| count).sum::<u64>() - most;
        match odd {
            Some((other, _, line)) if odd_ones * ODD > self.numbers => Err(TableError::refused(format!(
                "line {line}, column {} ({}): a number in {:?} among numbers in {unit:?}; make their unit one",
                self.column, self.tag.name, other
            ))),
            _ => Ok(unit),
        }
    }
}
