//! What somebody has told of the times, beside what the table says of them: the zone that holds, what the two contradict each other in, and
//! what was told for nothing.

use super::super::error::{TableError, shown};
use super::super::header_format;
use super::super::header_zone::HeaderZone;
use super::super::options::{self, Format, Told, Unit, Zone};
use super::super::source::TimeBase;
use super::decide::{Column, letters};
use super::reading::{How, Reading};
use super::tally::{Numbers, Times};
use jiff::tz::TimeZone;

/// The zone of times without an offset.
pub(super) struct Chosen {
    pub zone: Zone,
    /// In words.
    pub said: String,
    /// What the table says against it, in words; empty for nothing.
    pub against: String,
}

impl Times {
    /// The zone of times without an offset: that of an option, else that which the table states, else that of a configuration's
    /// defaults, else UTC.
    ///
    /// # Errors
    /// Letters or words that do not say whose zone it is, where no option does.
    pub(super) fn zone(&self, column: &Column<'_>, told: &Told) -> Result<Chosen, TableError> {
        let is_told = told.zone.name.is_some();
        let by_option =
            || Chosen { zone: told.zone.clone(), said: zone_said(&told.zone), against: String::new() };
        // INT96 is UTC unless an option gives its zone: Spark writes UTC beside a column with the zone of the plant.
        if self.base == Some(TimeBase::Int96) {
            return Ok(by_option());
        }
        let own = column.unit.and_then(HeaderZone::behind_times);
        let is_utc = own.is_none() && column.unit.is_some_and(HeaderZone::is_utc);
        let (place, stated) = match own.as_ref() {
            Some(own) => ("header", Some(own)),
            None => ("table", column.zone.filter(|_| !is_utc)),
        };
        let found = match (stated, is_utc) {
            (Some(HeaderZone::Offset(name)), _) => options::zone(name).map(|rules| (name.as_str(), rules)),
            (_, true) => Some(("UTC", TimeZone::UTC)),
            _ => None,
        };
        match found {
            Some((name, rules)) if told.zone.rules.as_ref() != Some(&rules) => {
                let is_default = is_told && told.is_default("tz");
                if is_told && !is_default {
                    let place = if stated.is_some() { place } else { "header" };
                    return Ok(Chosen {
                        against: format!(", the {place} says {}", shown(name)),
                        ..by_option()
                    });
                }
                if !is_told && is_utc {
                    return self.not_by_words(column, stated, false).map(|()| by_option());
                }
                let said = format!(" ({} by the header)", shown(name));
                let zone = Zone { name: Some(name.to_string()), rules: Some(rules) };
                Ok(Chosen { zone, said, against: String::new() })
            }
            Some(_) => Ok(by_option()),
            None if is_told => Ok(by_option()),
            None => self.not_by_words(column, stated, own.is_some()).map(|()| by_option()),
        }
    }

    /// Refuses letters and words that do not say whose zone it is, where times have no offset.
    fn not_by_words(
        &self,
        column: &Column<'_>,
        stated: Option<&HeaderZone>,
        is_own: bool,
    ) -> Result<(), TableError> {
        let Column { row_name, number, name, .. } = column;
        let days = |numbers: &Numbers| numbers.serial.max(numbers.date_num) * 2 > self.rows;
        let is_needed = self.offsets[1].is_some()
            || self.moments.count + self.formatted.count > 0
            || self.numbers.iter().any(days);
        match stated {
            Some(HeaderZone::Letters(letters)) if is_own || is_needed => Err(TableError::refused(format!(
                "column {number} ({name}): {letters} alone is no zone; say which with --tz, such as Europe/Berlin or +02:00"
            ))),
            Some(HeaderZone::Words(words)) if is_needed => Err(TableError::refused(format!(
                "column {number} ({name}): the table says {:?} of its times, which does not tell whose clock it is; say the zone with \
                 --tz, such as Europe/Berlin, +02:00 or UTC",
                shown(words)
            ))),
            _ => match &self.letters {
                Some((line, cell)) => Err(TableError::refused(format!(
                    "{row_name} {line}, column {number} ({name}): the letters in {cell:?} are those of several zones; say which with \
                     --tz, such as America/New_York or -05:00"
                ))),
                None => Ok(()),
            },
        }
    }

    /// Whether the zone moves any time.
    pub(super) fn has_open_times(&self, how: &How) -> bool {
        match how {
            How::Number(_, unit) => matches!(unit, Unit::Days | Unit::DateNum | Unit::Mjd),
            How::Dated(_) => self.offsets[1].is_some(),
            How::Moment => self.base != Some(TimeBase::Utc),
            How::Pattern(_) => true,
            How::Clock | How::Minutes | How::Elapsed => false,
        }
    }

    /// What the table says against the options, and options that nothing was read by, in words. A configuration's defaults are for tables
    /// of all kinds.
    pub(super) fn remarks(
        &self,
        reading: &Reading,
        column: &Column<'_>,
        told: &Told,
        against: &str,
    ) -> String {
        let (mut said, mut unused) = (String::new(), Vec::new());
        if self.has_open_times(&reading.how) {
            said += against;
        } else if told.zone.name.is_some() {
            unused.push("tz");
        }
        match (&reading.how, told.unit) {
            (How::Number(_, unit), Some(_)) => {
                let header = column.unit.filter(|own| Unit::of(own).is_some_and(|own| own != *unit));
                said += &header.map_or_else(String::new, |own| format!(", the header says {}", shown(own)));
            }
            (_, Some(_)) => unused.push("time_unit"),
            (_, None) => {}
        }
        match (&reading.how, &told.format) {
            (How::Dated(own), Some(Format::Order(_))) if self.open || self.dotted => {
                let header = column.unit.and_then(header_format::order).filter(|order| order != own);
                let says = |order| format!(", the header says {}", letters(order));
                said += &header.map_or_else(String::new, says);
            }
            (_, Some(Format::Order(_))) => unused.push("time_format"),
            _ => {}
        }
        said + &changes_nothing(unused.into_iter().filter(|name| !told.is_default(name)))
    }
}

/// That options have decided nothing, in words; empty for none.
pub fn changes_nothing<'n>(names: impl Iterator<Item = &'n str>) -> String {
    let names: Vec<String> = names.map(|name| format!("--{}", name.replace('_', "-"))).collect();
    match names.as_slice() {
        [] => String::new(),
        [one] => format!(", {one} changes nothing here"),
        all => format!(", {} change nothing here", all.join(" and ")),
    }
}

fn zone_said(zone: &Zone) -> String {
    zone.name.as_ref().map_or_else(|| " (UTC)".to_string(), |name| format!(" ({} by --tz)", shown(name)))
}
