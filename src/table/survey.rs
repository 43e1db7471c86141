//! The first reading of a table: everything is counted, then what the table means is decided.

mod checks;

use super::blanks::Blanks;
use super::by_words;
use super::channel::{Channel, Tag};
use super::dialect::dialect;
use super::error::TableError;
use super::evidence;
use super::joined::{self, Joined};
use super::layout::{Body, Layout, Long, Wide};
use super::loops;
use super::mixed::Mixed;
use super::names::{Meaning, Name};
use super::number::Decimal;
use super::odd_rows::{
    another_table, begins_with_a_word, is_total, not_even, passed_over, same_header, title, too_many,
    too_wide,
};
use super::options::{Options, Told};
use super::owner::Owner;
use super::qualities::{Others, Quality};
use super::repeats::Repeats;
use super::rests::Rests;
use super::says::Says;
use super::several;
use super::source::{Kind, Rows, Source};
use super::stated_zone::ZoneColumn;
use super::time::{self, Groups, Reading, Times};
use super::time_columns::one_of_loop;
use super::titles::Titles;
use super::words::{Modes, Words, two_state, word};
use crate::signal::Role;
use std::collections::HashMap;

/// Most tags of a long table.
const MAX_TAGS: usize = 1 << 16;

/// What a table is and means: all that the second reading needs.
pub struct Plan {
    /// How a row is called.
    pub row_name: &'static str,
    pub kind: Kind,
    pub separator: u8,
    pub layout: Layout,
    pub reading: Reading,
    pub decimal: Decimal,
    /// Whether any cell has a decimal sign or thousands.
    pub signs: bool,
    pub channels: Vec<Channel>,
    /// Where the channel of a tag of a long table is.
    pub tags: HashMap<Tag, usize>,
    /// The unit behind the numbers of each channel.
    pub units: Vec<String>,
    /// Whether letters behind numbers say how good these are.
    pub letters: bool,
    /// What the words of each channel mean, where it is a mode.
    pub modes: Vec<Option<Modes>>,
    /// Columns of quality: where, of which channel, and how they say it.
    pub qualities: Vec<(usize, Option<usize>, Says)>,
    /// Tags that say whether others are good.
    pub joined: Vec<Joined>,
    /// Which rows are the loop's, where a column names loops.
    pub owner: Option<Owner>,
    /// Columns of a long table that nothing is made of.
    pub unused: Vec<usize>,
}

/// Reads a table for the first time. `whole` wants OP and PV of one loop, else every tag is taken as it is.
pub fn survey(source: Source<'_>, options: &Options, whole: bool) -> Result<Plan, TableError> {
    let told = options.told()?;
    let head = source.head()?;
    let kind = Kind::of(source, &head, options.sheet.as_deref(), told.encoding, true)?;
    let divided = |part: bool| dialect(source, &kind, &head, options, &told, part);
    // A store takes OP of one file and PV of another.
    let (separator, layout) = match divided(false) {
        Err(_) if !whole => divided(true),
        found => found,
    }?;
    if options.several.is_some() && matches!(layout.body, Body::Long(_)) {
        return Err(TableError::refused(
            "each row is a sample of one tag, not of all: take the table into a store with `stictiond store import`, and read that",
        ));
    }
    let mut counting = Counting::new(&layout, options);
    let row_name = {
        let blanks = Blanks::of(separator);
        let mut rows = layout.rows(kind.rows(source, separator)?)?;
        counting.all(rows.as_mut(), &layout, &told, blanks)?;
        if counting.owner.as_ref().is_some_and(Owner::is_none) {
            counting = Counting { owner: None, ..Counting::new(&layout, options) };
            rows = layout.rows(kind.rows(source, separator)?)?;
            counting.all(rows.as_mut(), &layout, &told, blanks)?;
        }
        counting.owner.as_ref().map_or(Ok(()), Owner::decided)?;
        if let Some(owner) = counting.mixed.owner(&layout, options)? {
            counting = Counting { owner: Some(owner), ..Counting::new(&layout, options) };
            rows = layout.rows(kind.rows(source, separator)?)?;
            counting.all(rows.as_mut(), &layout, &told, blanks)?;
            counting.mixed.refuse(&layout)?;
        }
        rows.row_name()
    };
    counting.plan(kind, separator, layout, options, &told, row_name, whole)
}

/// What is counted of a table.
struct Counting {
    times: Times,
    groups: Groups,
    channels: Vec<Channel>,
    tags: HashMap<Tag, usize>,
    /// Words of the columns of quality.
    words: Vec<Words>,
    quality_columns: Vec<Quality>,
    /// The columns that may be anything.
    others: Others,
    /// Columns of OP and PV, and what stood there in the row before.
    moving: Vec<(usize, String)>,
    /// Which rows are the loop's.
    owner: Option<Owner>,
    /// Columns that may tell loops apart, whatever they are called.
    mixed: Mixed,
    /// Rows of a long table that cannot all be samples.
    repeats: Repeats,
    mode_name: Option<String>,
    /// The column of the mode in a wide table.
    mode_at: Option<usize>,
    /// Columns of a wide table that may be the mode under any name.
    rests: Rests,
    /// Columns of a long table that nothing is made of, and whether they hold anything.
    unused: Vec<(usize, bool)>,
}

impl Counting {
    fn new(layout: &Layout, options: &Options) -> Self {
        let mut own = Self {
            times: Times::default(),
            groups: Groups::default(),
            channels: Vec::new(),
            tags: HashMap::new(),
            words: Vec::new(),
            quality_columns: Vec::new(),
            others: Others::default(),
            repeats: Repeats::default(),
            moving: Vec::new(),
            mode_name: options.mode.clone(),
            mode_at: None,
            rests: Rests::default(),
            unused: Vec::new(),
            owner: Owner::of(layout, options),
            mixed: Mixed::default(),
        };
        match &layout.body {
            Body::Wide(wide) => own.wide(wide, layout),
            Body::Long(long) => {
                own.quality_columns = long.qualities.iter().map(|at| (*at, None)).collect();
                own.unused = layout.beside(long).into_iter().map(|at| (at, false)).collect();
            }
        }
        own.words = vec![Words::default(); own.quality_columns.len()];
        own.others = Others::of(layout, &own.quality_columns);
        own.mixed = Mixed::of(layout, &own.quality_columns);
        own
    }

    fn wide(&mut self, wide: &Wide, layout: &Layout) {
        for ((at, role), unit) in wide.columns.iter().zip(&wide.roles).zip(&wide.units) {
            let name = layout.names[*at].full.clone();
            let tag = Tag { name, unit: unit.clone(), ..Tag::default() };
            self.channels.push(Channel::new(tag, *role, at + 1));
            if matches!(role, Some(Role::Op | Role::Pv)) {
                self.moving.push((*at, String::new()));
            }
            if *role == Some(Role::Mode) {
                self.mode_at = Some(*at);
            }
        }
        // Which of the modes of several loops is asked cannot be said of every column.
        if wide.roles.iter().filter(|role| **role == Some(Role::Mode)).count() > 1 {
            self.mode_at = None;
        }
        self.quality_columns.clone_from(&wide.qualities);
        self.rests = Rests::of(wide);
    }

    /// Counts every row below the header; `blanks` divide the cells of the table, or a sign does.
    fn all(
        &mut self,
        rows: &mut dyn Rows,
        layout: &Layout,
        told: &Told,
        blanks: Option<Blanks>,
    ) -> Result<(), TableError> {
        let (mut titled, mut titles) = (None, Titles::default());
        for _ in 0..layout.skip {
            rows.next()?;
            titled = title(rows).or(titled);
            titles.above(rows);
        }
        let time_name = layout.names[layout.time].full.as_str();
        let mut zones = ZoneColumn::of(layout, told);
        while let Some(line) = rows.next()? {
            if passed_over(rows, layout) {
                same_header(rows, layout, line)?;
                titles.pass(rows, layout);
                continue;
            }
            if self.owner.as_mut().is_some_and(|owner| !owner.takes(rows)) || is_total(rows, layout) {
                continue;
            }
            zones.add(rows, layout, line)?;
            let first = rows.cell(layout.time);
            if begins_with_a_word(&first) && another_table(rows, layout, line, titled.as_deref())? {
                titles.add(rows, layout, line)?;
                continue;
            }
            titles.sample();
            self.mixed.add(rows, layout);
            let second = layout.clock.map(|at| rows.cell(at));
            let tag = match &layout.body {
                Body::Wide(_) => 0,
                Body::Long(long) => self.tag(rows, long, line)?,
            };
            self.times.add((line, tag), &first, second.as_ref(), time_name, told);
            match blanks {
                Some(Blanks::Ruled) => too_wide(rows, line, &first)?,
                Some(_) => not_even(rows, layout, line, &first)?,
                None => {}
            }
            match &layout.body {
                Body::Wide(wide) => {
                    // A sheet may have remarks beside the table; in a text they are decimal commas.
                    if rows.row_name() == "line" {
                        too_many(rows, layout, line, &first)?;
                    }
                    if layout.millis.is_none() {
                        let moving = &mut self.moving;
                        self.groups.add(&first, second.as_ref(), |is_first| moves(moving, rows, is_first));
                    }
                    self.rests.add(rows);
                    let mode = self.mode_at.and_then(|at| two_state(&word(&rows.cell(at))));
                    for (channel, at) in self.channels.iter_mut().zip(&wide.columns) {
                        let cell = rows.cell(*at);
                        if channel.add(&cell, line, mode) && channel.role.is_none() {
                            channel.compare(&cell, &first);
                        }
                    }
                }
                Body::Long(long) => {
                    let value = rows.cell(long.value);
                    let millis = layout.millis.map(|at| rows.cell(at));
                    self.repeats.add(tag, &[Some(first.clone()), second, millis], &value);
                    if rows.cell(long.tag).is_blank() && !value.is_blank() {
                        self.repeats.nameless(line);
                    }
                    self.channels[tag].add(&value, line, None);
                    for (at, holds) in self.unused.iter_mut().filter(|(_, holds)| !holds) {
                        *holds = !rows.cell(*at).is_blank();
                    }
                }
            }
            self.others.add(rows, &first, line);
            for (words, (at, _)) in self.words.iter_mut().zip(&self.quality_columns) {
                let cell = rows.cell(*at);
                if !cell.is_blank() {
                    words.add(&cell);
                }
            }
        }
        titles.decide()
    }

    /// The channel of a row of a long table.
    fn tag(&mut self, rows: &dyn Rows, long: &Long, line: u64) -> Result<usize, TableError> {
        let tag = Tag::of_row(rows, long);
        Ok(match self.tags.get(&tag) {
            Some(at) => *at,
            None if self.tags.len() == MAX_TAGS => {
                return Err(TableError::refused(format!("line {line}: more than {MAX_TAGS} tags")));
            }
            None => {
                let name = Name::new(&tag.name);
                let mode = name.said().is_some_and(|said| said.meaning == Meaning::Role(Role::Mode))
                    || self.mode_name.as_ref().is_some_and(|own| name.is(own));
                let mut channel = Channel::new(tag.clone(), mode.then_some(Role::Mode), 0);
                channel.quality = (!mode && joined::is_quality(&tag.name)).then(Words::default);
                self.channels.push(channel);
                self.tags.insert(tag, self.channels.len() - 1);
                self.channels.len() - 1
            }
        })
    }

    #[expect(clippy::too_many_arguments, reason = "the parts of a plan, each found by another step")]
    fn plan(
        mut self,
        kind: Kind,
        separator: u8,
        layout: Layout,
        options: &Options,
        told: &Told,
        row_name: &'static str,
        whole: bool,
    ) -> Result<Plan, TableError> {
        if self.times.rows == 0 {
            return Err(TableError::refused(format!(
                "{row_name} {}: no samples below the header",
                layout.line
            )));
        }
        if let Body::Long(long) = &layout.body {
            self.repeats.refuse(self.times.rows, long.tag)?;
        }
        let rows = matches!(layout.body, Body::Wide(_)).then_some(self.times.rows);
        if let Some(listed) = &options.several {
            several::owned(&mut self.channels, &layout, listed)?;
        }
        // Our own exports say which they are by a column that nobody else has, and how good each value is beside it.
        let own = layout.is_ours();
        match &layout.body {
            Body::Wide(_) if !whole => loops::of_one(&mut self.channels, options),
            Body::Wide(_) => {}
            Body::Long(long) if whole => loops::of_wanted(&mut self.channels, options, &layout.names, long)?,
            Body::Long(_) if layout.keeps_names() => {}
            Body::Long(_) => loops::of_many(&mut self.channels, options)?,
        }
        // A table with OP and PV of one loop, which lacks nothing that it needs.
        let of_one = (whole || rows.is_some()) && options.several.is_none();
        if options.mode.is_none() && of_one {
            let all: Vec<usize> = (0..self.channels.len()).collect();
            by_words::find_mode(&mut self.channels, &all, rows)?;
            self.rests.ask(&self.channels, &layout.names)?;
        }
        let joined = match own {
            true => Vec::new(),
            false => joined::find(&mut self.channels, told.good_values.as_deref(), !whole)?,
        };
        if separator == b',' && matches!(kind, Kind::Text(_)) {
            self.divided_by_commas(&layout)?;
        }
        let columns: Vec<&evidence::Evidence> =
            self.channels.iter().filter(|c| c.numbers * 2 > c.cells).map(|c| &c.evidence).collect();
        // Of the outputs of several loops one with signs shows what they mean.
        let ops = self.channels.iter().filter(|c| c.role == Some(Role::Op));
        let op = ops.max_by_key(|c| c.evidence.any());
        let decimal = match told.decimal {
            Some(decimal) => {
                let mut of_loop = self.channels.iter().filter(|c| c.role.is_some());
                of_loop.try_for_each(|channel| channel.evidence.allows(decimal, channel.numbers))?;
                decimal
            }
            None if own => Decimal::Point,
            None => {
                let mut used = self.channels.iter().filter(|c| c.role.is_some() || c.numbers * 2 > c.cells);
                used.try_for_each(|channel| channel.evidence.one_sign())?;
                let sign = matches!(kind, Kind::Text(_)).then_some(separator);
                evidence::decide(&columns, op.map(|c| &c.evidence), &self.times.evidence, sign)?
            }
        };
        let signs = columns.iter().any(|column| column.any());
        let name = layout.names[layout.time].full.as_str();
        let unit = layout.time_unit.as_deref();
        let zone = layout.zone.as_ref();
        let column = time::Column { row_name, number: layout.time + 1, name, unit, zone };
        let groups = matches!(layout.body, Body::Wide(_)).then(|| std::mem::take(&mut self.groups));
        let mut reading = self.times.decide(&column, told, decimal, groups)?;
        reading.by_tag |= layout.pairs.is_some();
        if options.sheet.is_some() && !matches!(kind, Kind::Sheet(_)) && !told.is_default("sheet") {
            reading.said += &time::changes_nothing(["sheet"].into_iter());
        }
        if matches!(&kind, Kind::Sheet(sheet) if sheet.since_1904) && reading.counts_days() {
            return Err(TableError::refused(format!(
                "column {} ({name}): numbers of days in a workbook that counts them from 1904, as Excel for the Macintosh did; give \
                 the column the format of a date, and save it again",
                layout.time + 1
            )));
        }
        // Where the letters behind one tag are its quality, those behind the others are no grams.
        let letters = self.channels.iter().any(Channel::has_letters);
        let units =
            self.channels.iter().map(|own| own.unit_or_none(letters)).collect::<Result<Vec<_>, _>>()?;
        one_of_loop(&self.channels, self.others.times(), &layout)?;
        self.without_data(options, of_one);
        for channel in self.channels.iter().filter(|c| of_one && c.role.is_some()) {
            self.numbers(channel, layout.line, row_name)?;
        }
        for (column, words) in
            std::mem::take(&mut self.others).qualities(&layout, told.good_values.as_deref())?
        {
            // Such a column is no tag any more.
            let is_it = |own: &&mut Channel| own.column == column.0 + 1 && own.role.is_none();
            self.channels.iter_mut().filter(is_it).for_each(|own| own.says_of_another = true);
            self.quality_columns.push(column);
            self.words.push(words);
        }
        self.unused_options(&layout, &joined, told, whole)?;
        let modes = self.modes(told)?;
        let qualities = self.qualities(&layout, told)?;
        let Self { channels, tags, owner, unused, .. } = self;
        let says = |at: usize| qualities.iter().any(|(own, ..)| *own == at);
        let unused = unused.into_iter().filter(|(at, holds)| *holds && !own && !says(*at)).map(|(at, _)| at);
        let unused = unused.collect();
        Ok(Plan {
            row_name,
            kind,
            separator,
            layout,
            reading,
            decimal,
            signs,
            channels,
            tags,
            units,
            letters,
            modes,
            qualities,
            joined,
            owner,
            unused,
        })
    }
}

/// Whether a row has other values than those before it under its stamp, in these columns with their last values.
fn moves(columns: &mut [(usize, String)], rows: &dyn Rows, is_first: bool) -> bool {
    let mut moved = false;
    for (at, before) in columns {
        if is_first {
            before.clear();
        }
        let cell = rows.cell(*at);
        if !cell.is_blank() {
            let shown = cell.shown();
            moved |= !before.is_empty() && *before != shown;
            *before = shown;
        }
    }
    moved
}
