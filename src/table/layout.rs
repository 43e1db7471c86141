//! Where the header is, and what stands in which column.

use super::error::TableError;
use super::header_zone::HeaderZone;
use super::names::{Meaning, Name, as_unit};
use super::options::Options;
use super::pairs::{self, PairRows, Pairs};
use super::part::of_part;
use super::qualities::{owners, speaks};
use super::roles::{Roles, Trouble, roles, told};
use super::several;
use super::source::Rows;
use super::time::{What, WhatKind};
use super::time_columns::{parts, seconds, times};
use super::two_rows::{goes_on, named, no_part, under_loops};
use super::vocabulary::TAGS;
use super::why_none::{along_a_row, blocks, none};

/// Most columns of a table.
pub const MAX_COLUMNS: usize = 1 << 12;
/// Lines above the header: a title, who exported it, and when.
pub const PREAMBLE: usize = 200;
/// Rows between the header and the first sample: units, descriptions, limits.
const BELOW: usize = 4;
/// Rows looked at.
pub const LOOKED_AT: usize = 400;

/// A cell of the first rows.
#[derive(Clone, Debug)]
pub struct Seen {
    /// What stands there.
    pub text: String,
    /// What it can be.
    pub kind: WhatKind,
}

/// A row of them and its line.
pub type SeenRow = (u64, Vec<Seen>);

/// The first rows of a table.
pub fn first_rows(rows: &mut dyn Rows) -> Result<Vec<SeenRow>, TableError> {
    let mut out = Vec::new();
    while out.len() < LOOKED_AT {
        let Some(line) = rows.next()? else { break };
        let seen = |at| {
            let cell = rows.cell(at);
            let kind = if cell.is_blank() { WhatKind::Blank } else { What::of(&cell, None).kind() };
            Seen { text: cell.shown(), kind }
        };
        out.push((line, (0..rows.len().min(MAX_COLUMNS + 1)).map(seen).collect()));
    }
    Ok(out)
}

/// What stands in which column.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Line of the header.
    pub line: u64,
    /// Rows from the first to the last one above the samples.
    pub skip: usize,
    /// Names of all columns.
    pub names: Vec<Name>,
    /// The column of times.
    pub time: usize,
    /// The column of the time of day, where the other is the date only.
    pub clock: Option<usize>,
    /// The column of milliseconds or other parts of a second, where the times are whole seconds.
    pub millis: Option<usize>,
    /// The unit of times, from the header or below it.
    pub time_unit: Option<String>,
    /// The zone of times, where a line above the header or a column states it.
    pub zone: Option<HeaderZone>,
    /// Where the samples are.
    pub body: Body,
    /// The columns of each tag, where each has its own times.
    pub pairs: Option<Pairs>,
}

impl Layout {
    /// The rows as this layout has them.
    pub fn rows<'r>(&'r self, rows: Box<dyn Rows + 'r>) -> Result<Box<dyn Rows + 'r>, TableError> {
        Ok(match &self.pairs {
            Some(pairs) => Box::new(PairRows::new(rows, pairs)?),
            None => rows,
        })
    }

    /// Whether the table is an export of our own, which has a column that nobody else has.
    pub fn is_ours(&self) -> bool {
        self.names.iter().any(|name| name.plain() == "era")
    }

    /// Whether tags are called as a store calls them: in an export of our own, and in the form that the documents describe.
    pub fn keeps_names(&self) -> bool {
        let Body::Long(long) = &self.body else { return false };
        let is = |at: usize, name: &str| self.names[at].plain() == name;
        let described =
            long.owner.is_some_and(|at| is(at, "loop")) && is(long.tag, "tag") && is(self.time, "t");
        self.is_ours() || described && is(long.value, "value")
    }

    /// The columns of a long table of which nothing is made.
    pub fn beside(&self, long: &Long) -> Vec<usize> {
        let used = [Some(long.tag), Some(long.value), Some(self.time), self.clock, self.millis];
        let told = [long.owner, long.source, long.unit];
        let is_used =
            |at: usize| used.contains(&Some(at)) || told.contains(&Some(at)) || long.qualities.contains(&at);
        (0..self.names.len()).filter(|at| !is_used(*at) && !self.names[*at].is_none()).collect()
    }

    /// One more row stands above the header.
    pub fn lower(&mut self) {
        match &mut self.pairs {
            Some(pairs) => pairs.lower(),
            None => self.skip += 1,
        }
    }
}

/// How samples stand in a table.
#[derive(Clone, Debug)]
pub enum Body {
    /// A column for each tag.
    Wide(Wide),
    /// A row for each sample.
    Long(Long),
}

/// A column for each tag.
#[derive(Clone, Debug)]
pub struct Wide {
    /// Where each value stands.
    pub columns: Vec<usize>,
    /// What it is to the loop; `None` for a tag.
    pub roles: Roles,
    /// Its unit, from the header or below it.
    pub units: Vec<Option<String>>,
    /// Columns that say whether the value of one of `columns`, or of all, is good.
    pub qualities: Vec<(usize, Option<usize>)>,
    /// The column that says of which loop a row is.
    pub owner: Option<usize>,
}

/// A row for each sample.
#[derive(Clone, Debug)]
pub struct Long {
    pub tag: usize,
    pub value: usize,
    pub owner: Option<usize>,
    /// Columns that say whether the value is good.
    pub qualities: Vec<usize>,
    pub source: Option<usize>,
    pub unit: Option<usize>,
}

/// What was found in the first rows under one separator.
pub struct Looked {
    /// The layout, or why there is none.
    pub layout: Result<Layout, TableError>,
    /// Names that are known in the best header.
    pub known: usize,
    /// The share of rows below the header that have as many cells.
    pub even: f64,
    /// Cells of the header.
    pub cells: usize,
    /// The first row holds numbers and no name.
    numbers_only: bool,
}

/// Looks for the header in the first rows; `part`: OP or PV may be in another file.
pub fn look(rows: &[SeenRow], options: &Options, row_name: &str, part: bool) -> Looked {
    if options.tag.is_none()
        && options.value.is_none()
        && let Some(layout) = pairs::look(rows, options.time.is_some())
    {
        let cells = rows.iter().map(|(_, row)| row.len()).max().unwrap_or(0);
        return Looked { layout, known: cells, even: 1.0, cells, numbers_only: false };
    }
    let comment = |row: &[Seen]| row.first().is_some_and(|cell| cell.text.trim_start().starts_with('#'));
    let mut best: Option<(usize, usize)> = None;
    let mut refused = None;
    // LabVIEW writes properties above the header, times among them, and says where they end.
    let ends = |row: &[Seen]| row.first().is_some_and(|cell| cell.text.trim() == "***End_of_Header***");
    let from = rows.iter().take(PREAMBLE).rposition(|(_, row)| ends(row)).map_or(0, |at| at + 1);
    // The second time a comment may be the header: `# t, op, pv`. The third time the table has none, and its columns are told by
    // number: then the first sample stands in its place.
    for (comments, bare) in [(false, false), (true, false), (false, true)] {
        for (at, (line, row)) in rows.iter().enumerate().take(PREAMBLE).skip(from) {
            if comment(row) != comments || is_sample(row, options) != bare || comments && by_number(options) {
                continue;
            }
            let names: Vec<Name> = match bare {
                true => (1..=row.len()).map(|number| Name::new(&format!("column {number}"))).collect(),
                false => named(row, &rows[at + 1..]),
            };
            let of_times = |name: &Name| name.said().is_some_and(|said| said.meaning == Meaning::Time);
            let names_times = names.iter().any(of_times);
            let below = &rows[at + usize::from(!bare)..];
            let headed = |names: Vec<Name>| header(names, below, options, part);
            if !bare && goes_on(row, below) {
                continue;
            }
            let above = at.checked_sub(1).filter(|_| !bare).map(|above| &rows[above].1);
            let (found, known) = match above.filter(|above| goes_on(above, &rows[at..])) {
                Some(above) => {
                    let both = under_loops(above, row).unwrap_or_else(|| names.clone());
                    let known = known(&both, options);
                    let found = headed(names);
                    let again = |_| headed(both.clone()).map_err(|own| no_part(own, &both));
                    (found.or_else(again), known)
                }
                None => {
                    let known = known(&names, options);
                    // Two columns for OP: the row above may say of which loop each is.
                    let again = |error| match above.and_then(|above| under_loops(above, row)) {
                        Some(names) if matches!(error, Trouble::Refused(_)) => headed(names),
                        _ => Err(error),
                    };
                    (headed(names).or_else(again), known)
                }
            };
            // A sample is no header, though its tag is known.
            let of_names = if !bare && holds_samples(row) && !names_times { 0 } else { known };
            if best.is_none_or(|(most, _)| of_names > most) {
                best = Some((of_names, at));
            }
            match found {
                // A sample is no header, though columns may be told by their numbers.
                Ok(layout) if !bare && is_time(row, layout.time) => {}
                Ok(mut layout) => {
                    layout.line = *line;
                    layout.skip += at + usize::from(!bare);
                    let cells = layout.names.len();
                    let even = even(&rows[at + 1..], cells);
                    return Looked { layout: Ok(layout), known, even, cells, numbers_only: false };
                }
                // Nothing is called so among the samples.
                Err(Trouble::Refused(_)) if !bare && known == 0 && holds_samples(row) => {}
                Err(Trouble::Refused(error)) => {
                    refused.get_or_insert((error, *line, known, row.len()));
                }
                Err(Trouble::Missing(_)) => {}
            }
        }
    }
    if let Some((error, line, known, cells)) = refused {
        let error = TableError::refused(format!("{row_name} {line}: {error}"));
        return Looked { layout: Err(error), known, even: 1.0, cells, numbers_only: false };
    }
    let (known, at) = best.unwrap_or_default();
    let (line, row): (u64, &[Seen]) = rows.get(at).map_or((1, &[]), |(line, row)| (*line, row));
    let numbers_only = known == 0 && row.iter().any(|cell| cell.kind == WhatKind::Number);
    if let Some(error) = along_a_row(line, row, row_name).or_else(|| blocks(rows, row_name)) {
        return Looked { layout: Err(error), known: known.max(2), even: 1.0, cells: 2, numbers_only: false };
    }
    let layout = Err(none(line, row, numbers_only, options, row_name));
    Looked {
        layout,
        known,
        even: even(&rows[rows.len().min(at + 1)..], row.len()),
        cells: row.len(),
        numbers_only,
    }
}

/// Whether all columns that a record needs are told by their numbers: then no comment is their header.
fn by_number(options: &Options) -> bool {
    let all = [&options.time, &options.op, &options.pv];
    all.iter().all(|told| told.as_ref().is_some_and(|told| told.parse::<usize>().is_ok()))
}

/// Whether times or numbers stand in a row.
fn holds_samples(row: &[Seen]) -> bool {
    row.iter().any(|cell| matches!(cell.kind, WhatKind::Number | WhatKind::Dated | WhatKind::Clock))
}

/// Whether a date or a time of day stands in this column.
fn is_time(row: &[Seen], at: usize) -> bool {
    row.get(at).is_some_and(|cell| matches!(cell.kind, WhatKind::Dated | WhatKind::Clock))
}

/// Whether a row has a time where the option says, by number, that times stand.
fn is_sample(row: &[Seen], options: &Options) -> bool {
    let number = options.time.as_ref().and_then(|time| time.parse::<usize>().ok());
    let cell = number.and_then(|number| row.get(number.checked_sub(1)?));
    cell.is_some_and(|cell| matches!(cell.kind, WhatKind::Number | WhatKind::Dated))
}

impl Looked {
    /// How well a separator divides: a layout first, then even rows, then names that are known, then cells.
    pub fn worth(&self) -> (bool, bool, usize, usize) {
        (self.layout.is_ok(), self.even >= 0.5 && self.cells > 1, self.known, self.cells)
    }

    /// Whether there is but one column.
    pub fn single(&self) -> bool {
        self.cells < 2
    }

    /// Whether numbers stand where the header should be.
    pub fn headless(&self) -> bool {
        self.numbers_only
    }
}

/// How many names are known, or told by an option.
pub fn known(names: &[Name], options: &Options) -> usize {
    let told = |name: &Name| {
        ["t", "op", "pv", "tag", "value"]
            .iter()
            .any(|role| options.column(role).is_some_and(|own| name.is(own)))
    };
    names.iter().filter(|name| name.said().is_some() || told(name)).count()
}

/// The share of rows that have so many cells, blank ones at the end not counted.
fn even(rows: &[SeenRow], cells: usize) -> f64 {
    let filled =
        |row: &[Seen]| row.iter().rposition(|cell| cell.kind != WhatKind::Blank).map_or(0, |at| at + 1);
    let same = |row: &&SeenRow| filled(&row.1) <= cells && row.1.len() >= 2 && row.1.len() + 2 > cells;
    let all = rows.len().max(1) as f64;
    rows.iter().filter(same).count() as f64 / all
}

/// A row as the header of those below it; see [`look`] for `part`.
fn header(names: Vec<Name>, below: &[SeenRow], options: &Options, part: bool) -> Result<Layout, Trouble> {
    if names.len() > MAX_COLUMNS {
        let n = names.len();
        return Err(Trouble::Refused(TableError::refused(format!(
            "{n} columns, at most {MAX_COLUMNS} are read"
        ))));
    }
    let (time, clock) = times(&names, below, options)?;
    let millis = parts(&names, (time, clock), below, options)?;
    seconds(&names, time, below)?;
    let wide =
        |name: &Name, at: usize| at != time && Some(at) != clock && Some(at) != millis && !name.is_none();
    let masked: Vec<Name> =
        names.iter().enumerate().map(|(at, n)| if wide(n, at) { n.clone() } else { Name::new("") }).collect();
    let times = [Some(time), clock, millis];
    let roles = match &options.several {
        Some(listed) => several::roles(&masked, times, listed),
        None => roles(&masked, options, true),
    };
    let body = match (long(&names, time, below, options)?, roles) {
        // A table of tags and values has no columns of OP and PV.
        (Some(long), _) => Body::Long(long),
        (None, Ok(roles)) => Body::Wide(columns(&masked, &roles)),
        (None, Err(Trouble::Missing(missing))) if part => {
            Body::Wide(columns(&masked, &of_part(&masked, times, below, options, missing)?))
        }
        (None, Err(trouble)) => return Err(trouble),
    };
    let mut layout = Layout {
        line: 0,
        skip: 0,
        time,
        clock,
        millis,
        time_unit: names[time].unit_of_time(),
        zone: None,
        names,
        body,
        pairs: None,
    };
    units(&mut layout, below);
    Ok(layout)
}

/// Columns that hold the values of a long table.
pub const VALUES: [&str; 13] = [
    "value",
    "samplevalue",
    "sample value",
    "valeur",
    "valuey",
    "val",
    "wert",
    "messwert",
    "reading",
    "varvalue",
    "floatvalue",
    "ip trend value",
    "measure value double",
];

/// Whether the tags of a long table are called `OP` and `PV` alone, so that another column has to say of which loop they are.
fn are_bare(below: &[SeenRow], tag: usize) -> bool {
    let said = below.iter().filter_map(|(_, row)| Name::new(&row.get(tag)?.text).said());
    let mut owners = said.map(|said| said.owner);
    owners.next().is_some_and(|first| first.is_empty() && owners.all(|own| own.is_empty()))
}

/// The columns of a long table, where it is one.
fn long(names: &[Name], time: usize, below: &[SeenRow], options: &Options) -> Result<Option<Long>, Trouble> {
    let place =
        |wanted: &[&str]| (0..names.len()).find(|at| *at != time && wanted.contains(&names[*at].plain()));
    let told = |option: &str, known: &[&str]| match options.column(option) {
        Some(own) => told(names, own, option, true).map(Some).map_err(Trouble::Refused),
        None => Ok(place(known)),
    };
    let (tag, value) = (told("tag", &TAGS)?, told("value", &VALUES)?);
    let is_told = options.tag.is_some() || options.value.is_some();
    // Who names columns of OP and PV has no long table, unless they are names of tags.
    let named = ["op", "pv"]
        .iter()
        .any(|role| options.column(role).is_some_and(|own| names.iter().any(|name| name.is(own))));
    let (tag, value) = match (tag, value) {
        (Some(tag), Some(value)) if is_told || !named => (tag, value),
        (Some(_), None) if is_told => return Err(alone("tag", "value")),
        (None, Some(_)) if is_told => return Err(alone("value", "tag")),
        _ => return Ok(None),
    };
    if tag == value || tag == time || value == time {
        return Err(Trouble::Refused(TableError::refused(
            "--time, --tag and --value must be three columns: two of them are one",
        )));
    }
    let other = |wanted: &[&str]| place(wanted).filter(|at| ![tag, value].contains(at));
    // A source is where samples came from, and a second name says more of a tag.
    let names_loop =
        |name: &Name| name.is_owner() && !TAGS.contains(&name.plain()) && name.plain() != "source";
    let of_loop = || {
        let at = (0..names.len()).find(|at| names_loop(&names[*at]) && ![tag, value, time].contains(at));
        at.filter(|_| are_bare(below, tag))
    };
    Ok(Some(Long {
        tag,
        value,
        owner: other(&["loop"]).or_else(of_loop).or_else(|| other(&["measurement"])),
        qualities: qualities_of(names, value),
        source: other(&["source"]),
        unit: other(&["unit", "units", "uom"]),
    }))
}

/// The columns that say whether the one of values is good: the first of them, and each that holds OPC's numbers beside it.
fn qualities_of(names: &[Name], value: usize) -> Vec<usize> {
    let of_value = |of: &String| VALUES.contains(&of.as_str()) || names[value].owns_quality(of);
    let says = |name: &Name| {
        let of_web_api = name.plain() == "good";
        of_web_api || name.quality_of().is_some_and(|of| of.is_empty() || of_value(&of))
    };
    let all = || (0..names.len()).filter(|at| says(&names[*at]));
    let first = all().next();
    all().filter(|at| Some(*at) == first || names[*at].is_detail()).collect()
}

/// One of the two options of a long table without the other.
fn alone(told: &str, missing: &str) -> Trouble {
    Trouble::Refused(TableError::refused(format!(
        "--{told} says that each row is one sample of one tag; name the column of {missing}s with --{missing}"
    )))
}

fn columns(names: &[Name], roles: &Roles) -> Wide {
    // One without a name may be told by its number.
    let named = |at: &usize| !names[*at].is_none() || roles[*at].is_some();
    let (says, values): (Vec<usize>, Vec<usize>) =
        (0..names.len()).filter(named).partition(|at| roles[*at].is_none() && speaks(names, *at));
    let owners = owners(names, &says, &values, roles);
    // The status of something else is a tag like any other.
    let others = owners.iter().filter(|(_, owner)| owner.is_none()).map(|(at, _)| *at);
    let mut columns: Vec<usize> = values.iter().copied().chain(others).collect();
    columns.sort_unstable();
    let place = |at: usize| columns.iter().position(|c| *c == at);
    let qualities = owners.iter().filter_map(|(at, owner)| Some((*at, (*owner)?.and_then(place)))).collect();
    let units = columns.iter().map(|at| names[*at].unit.clone()).collect();
    let taken: Vec<usize> = (0..roles.len()).filter(|at| roles[*at].is_some()).collect();
    let roles: Roles = columns.iter().map(|at| roles[*at]).collect();
    // Where the columns themselves name their loops, no other column does.
    let named = |at: &usize| names[*at].said().is_some_and(|said| !said.owner.is_empty());
    let by_name = taken.iter().any(named);
    let owner =
        values.into_iter().find(|at| names[*at].is_owner() && !taken.contains(at)).filter(|_| !by_name);
    Wide { columns, roles, units, qualities, owner }
}

/// Passes over the rows between header and samples, and takes units from them.
fn units(layout: &mut Layout, below: &[SeenRow]) {
    let is_sample = |row: &SeenRow| {
        row.1.get(layout.time).is_some_and(|cell| !matches!(cell.kind, WhatKind::Blank | WhatKind::Nothing))
    };
    let extra = below.iter().take(BELOW + 1).position(is_sample).unwrap_or(0);
    let is_comment =
        |row: &SeenRow| row.1.first().is_some_and(|cell| cell.text.trim_start().starts_with('#'));
    for (at, (_, row)) in below[..extra].iter().enumerate() {
        let are_types = at.checked_sub(1).is_some_and(|above| announces_types(&below[above].1));
        if is_comment(&below[at]) || are_types {
            continue;
        }
        let unit = |at: usize| row.get(at).and_then(|cell| as_unit(&cell.text)).map(str::to_string);
        if layout.time_unit.is_none() {
            layout.time_unit = unit(layout.time);
        }
        if let Body::Wide(wide) = &mut layout.body {
            for (own, at) in wide.units.iter_mut().zip(&wide.columns) {
                if own.is_none() {
                    *own = unit(*at);
                }
            }
        }
    }
    layout.skip = extra;
}

/// Whether a row says that the types of the columns stand below it, as Ignition writes them: `#TYPES` above `date,D,D`. `D` is a
/// number there, and no day.
fn announces_types(row: &[Seen]) -> bool {
    let mut cells = row.iter();
    let is_named = cells.next().is_some_and(|cell| cell.text.trim().eq_ignore_ascii_case("#types"));
    is_named && cells.all(|cell| cell.kind == WhatKind::Blank)
}
