//! What follows for each column once all is counted: numbers that are missing, modes and qualities; and options that decide nothing.

use super::super::by_words;
use super::super::channel::Channel;
use super::super::error::{TableError, listed};
use super::super::joined::Joined;
use super::super::layout::{Body, Layout};
use super::super::options::{Options, Told};
use super::super::says::Says;
use super::super::words::{Modes, Moving, Words};
use super::Counting;
use crate::signal::Role;
use std::collections::HashMap;

impl Counting {
    /// What has texts alone, such as `----` or `No Data`, is no set point and no position of a valve: nothing was recorded. OP and PV
    /// of a table of one loop are needed, and so is what an option names.
    pub(super) fn without_data(&mut self, options: &Options, of_one: bool) {
        for channel in self.channels.iter_mut().filter(|channel| channel.is_text()) {
            let Some(role) = channel.role.filter(|role| *role != Role::Mode) else { continue };
            let needed = of_one && matches!(role, Role::Op | Role::Pv);
            if !needed && options.column(role.as_str()).is_none() {
                channel.role = None;
            }
        }
    }

    /// A role without a single number is refused.
    pub(super) fn numbers(&self, channel: &Channel, header: u64, row_name: &str) -> Result<(), TableError> {
        let needed = matches!(channel.role, Some(Role::Op | Role::Pv));
        let text_only = channel.numbers == 0 && channel.cells > 0 && channel.words.is_none();
        let nothing = needed && channel.cells == 0;
        if !(text_only || nothing) {
            return Ok(());
        }
        let at = match channel.column {
            0 => format!("tag {:?}", channel.tag.name),
            column => format!("column {column} ({})", channel.tag.name),
        };
        Err(TableError::refused(match &channel.first_bad {
            Some((line, cell)) => {
                let why = channel.why_no_number();
                format!(
                    "{row_name} {line}, {at}: no number in the whole column, it begins with {cell:?}{why}"
                )
            }
            None => format!("{row_name} {header}, {at}: nothing in the whole column"),
        }))
    }

    /// How each column of quality says it.
    ///
    /// # Errors
    /// One that nobody knows to read, unless OPC's numbers stand beside it.
    pub(super) fn qualities(
        &self,
        layout: &Layout,
        told: &Told,
    ) -> Result<Vec<(usize, Option<usize>, Says)>, TableError> {
        let good = told.good_values.as_deref();
        let columns = || self.words.iter().zip(&self.quality_columns);
        let has_detail = |of: Option<usize>| {
            columns().any(|(words, (at, own))| {
                let name = &layout.names[*at];
                *own == of && name.is_detail() && matches!(Says::decide(words, good, &name.full), Ok(Some(_)))
            })
        };
        // One list of good values is meant for one of two numberings.
        let meant = |words: &Words| good.is_none_or(|good| words.any_of(good));
        // A flag beside the column that the list is for says by itself what it means.
        let of_column = |words: &Words, name: &str| {
            let by_itself = || matches!(Says::decide(words, None, name), Ok(Some(_)));
            good.filter(|_| meant(words) || !by_itself())
        };
        let other_is_meant = |of: Option<usize>, at: usize| {
            columns().any(|(words, (other, own))| *own == of && *other != at && meant(words))
        };
        let any_detail = self.quality_columns.iter().any(|(at, _)| layout.names[*at].is_detail());
        let mut out = Vec::new();
        for (words, (at, of)) in columns() {
            if any_detail && !meant(words) && other_is_meant(*of, *at) {
                continue;
            }
            let name = &layout.names[*at].full;
            match Says::decide(words, of_column(words, name), name) {
                Ok(says) => out.extend(says.map(|says| (*at, *of, says))),
                Err(_) if has_detail(*of) => {}
                Err(error) => {
                    // A column of a long table is no tag, so that it can be no mode.
                    let is_wide = matches!(layout.body, Body::Wide(_));
                    let of_mode = by_words::under_quality(words, name).filter(|_| is_wide);
                    return Err(of_mode.unwrap_or(error));
                }
            }
        }
        Ok(out)
    }

    pub(super) fn modes(&self, told: &Told) -> Result<Vec<Option<Modes>>, TableError> {
        let ops = self.channels.iter().filter(|c| c.role == Some(Role::Op));
        let ops: HashMap<Option<&str>, &Channel> = ops.map(|c| (c.control_loop.as_deref(), c)).collect();
        let of = |channel: &Channel| match (&channel.words, channel.role) {
            (Some(words), Some(Role::Mode)) => {
                let op = ops.get(&channel.control_loop.as_deref()).copied();
                let moving = Moving {
                    at_all: op.is_some_and(Channel::moves),
                    in_zero: op.is_some_and(Channel::moves_in_zero),
                    in_one: op.is_some_and(Channel::moves_in_one),
                };
                Modes::decide(words, told.auto_values.as_deref(), moving, &channel.tag.name).map(Some)
            }
            _ => Ok(None),
        };
        self.channels.iter().map(of).collect()
    }

    /// Refuses an option that has nothing to decide: what it means would not be read.
    pub(super) fn unused_options(
        &self,
        layout: &Layout,
        joined: &[Joined],
        told: &Told,
        whole: bool,
    ) -> Result<(), TableError> {
        let is_mode = |own: &Channel| own.role == Some(Role::Mode);
        if told.auto_values.is_some() && !self.channels.iter().any(is_mode) {
            let place = if matches!(layout.body, Body::Wide(_)) { "column" } else { "tag" };
            return Err(TableError::refused(format!(
                "--auto-values: no {place} is the mode; name it with --mode"
            )));
        }
        let Some(good) = told.good_values.as_deref().filter(|_| whole) else { return Ok(()) };
        let mut of_tags = joined.iter().filter_map(|own| self.channels[own.by].quality.as_ref());
        if self.quality_columns.is_empty() && !of_tags.any(|words| words.may_hold(good)) {
            return Err(TableError::refused(
                "--good-values: no column says anything of quality, such as \"pv_status\" or \"Quality\": call it so",
            ));
        }
        match self.words.iter().zip(&self.quality_columns).next() {
            Some((words, (at, _))) if !self.words.iter().any(|words| words.may_hold(good)) => {
                Err(TableError::refused(format!(
                    "--good-values: none of {} is there; column {} ({}) holds {}",
                    listed(good.iter().map(String::as_str)),
                    at + 1,
                    layout.names[*at].full,
                    words.listed()
                )))
            }
            _ => Ok(()),
        }
    }

    /// Refuses values whose decimal commas divide the cells as well: all are whole numbers, and behind the columns with a name stand
    /// as many without one that hold digits.
    pub(super) fn divided_by_commas(&self, layout: &Layout) -> Result<(), TableError> {
        let Body::Wide(_) = &layout.body else { return Ok(()) };
        let mut values = self.channels.iter().filter(|own| own.numbers > 0);
        let count = values.clone().count();
        let are_whole = values.all(|own| !own.evidence.any());
        let last = layout.names.iter().rposition(|name| !name.is_none()).unwrap_or(0);
        let digits: Vec<usize> =
            self.others.nameless_digits(self.times.rows).filter(|at| *at > last).collect();
        // The times may have a fraction, too.
        let (Some(first), true) = (digits.first(), are_whole && [count, count + 1].contains(&digits.len()))
        else {
            return Ok(());
        };
        Err(TableError::refused(format!(
            "column {}: it has no name and holds whole numbers, as the values do: decimal commas may divide the cells, too; decimal \
             commas need quotes, or semicolons between cells; where the numbers are whole, give the column a name",
            first + 1
        )))
    }
}
