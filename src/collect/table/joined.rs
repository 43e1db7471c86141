//! Qualities that are tags of their own in a table with a row for each sample: `FIC101.PV.Quality` beside `FIC101.PV`.
//!
//! Such a tag may have samples only where it changes, and stand above or below its value in the file. It is read before the values,
//! and what it says holds until its next sample.

use super::channel::Channel;
use super::error::TableError;
use super::names::Name;
use super::says::Says;
use super::vocabulary::VALUES;
use crate::signal::Quality;
use std::collections::HashMap;

/// The quality of a tag over time, as another tag says it.
pub struct Joined {
    /// The channel that says it.
    pub by: usize,
    /// How it is said.
    pub says: Says,
    /// From when (s) it is so, in the order of time once all are taken.
    pub since: Vec<(f64, Quality)>,
}

impl Joined {
    /// What was said last at or before `t` (s); before the first, what the first says.
    pub fn quality(&self, t: f64) -> Option<Quality> {
        let after = self.since.partition_point(|(since, _)| *since <= t);
        self.since.get(after.saturating_sub(1)).map(|(_, quality)| *quality)
    }

    /// Puts them in the order of time; of two at one time the later row counts.
    pub fn sort(&mut self) {
        self.since.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.since.dedup_by_key(|(_, quality)| *quality);
    }
}

/// Whether a tag of this name may say if the value of another is good.
pub fn is_quality(name: &str) -> bool {
    Name::new(name).quality_of().is_some_and(|of| !of.is_empty())
}

/// The tags that say of others whether they are good; both channels know of it then.
///
/// # Errors
/// One of which nobody knows how it says it, where its value is needed: it belongs to the loop that is read, or to any where `all` are.
pub fn find(channels: &mut [Channel], told: Option<&[String]>, all: bool) -> Result<Vec<Joined>, TableError> {
    let says = |own: &Channel| own.role.is_none() && own.quality.is_some();
    if !channels.iter().any(says) {
        return Ok(Vec::new());
    }
    let mut values: HashMap<(&str, String), Vec<usize>> = HashMap::new();
    for (at, own) in channels.iter().enumerate().filter(|(_, own)| !says(own)) {
        let name = Name::new(&own.tag.name);
        let short = |word: &&str| name.plain().strip_suffix(*word)?.strip_suffix(' ').map(str::to_string);
        let keys = VALUES.iter().filter_map(short).chain([name.plain().to_string()]);
        for key in keys.filter(|key| !key.is_empty()) {
            values.entry((own.tag.owner.as_str(), key)).or_default().push(at);
        }
    }
    let is_needed =
        |value: &Channel| value.role.is_some() || all && Name::new(&value.tag.name).said().is_some();
    let mut found: Vec<(Vec<usize>, Joined)> = Vec::new();
    for (by, own) in channels.iter().enumerate().filter(|(_, own)| says(own)) {
        let of = Name::new(&own.tag.name).quality_of().unwrap_or_default();
        let Some(of) = values.get(&(own.tag.owner.as_str(), of)).cloned() else { continue };
        let Some(words) = &own.quality else { continue };
        let needed = of.iter().any(|at| is_needed(&channels[*at]));
        // Good values that are not among these are meant for others.
        match Says::decide(words, told.filter(|good| words.more || words.any_of(good)), &own.tag.name) {
            Ok(Some(says)) => found.push((of, Joined { by, says, since: Vec::new() })),
            Err(error) if needed => return Err(error),
            Ok(None) | Err(_) => {}
        }
    }
    for (place, (of, own)) in found.iter().enumerate() {
        channels[own.by].says_of_another = true;
        of.iter().for_each(|at| channels[*at].said_by.push(place));
    }
    Ok(found.into_iter().map(|(_, own)| own).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::BadReason;

    #[test]
    fn what_is_said_holds_until_the_next() {
        let bad = Quality::Bad(BadReason::DeviceException);
        let says = Says::Words(false);
        let since = vec![(20.0, Quality::Good), (10.0, bad), (15.0, bad), (10.0, Quality::Good), (20.0, bad)];
        let mut own = Joined { by: 1, says, since };
        own.sort();
        let at = |t| own.quality(t);
        assert_eq!(
            [5.0, 10.0, 14.9, 15.0, 19.9, 20.0, 99.0].map(at),
            [Some(bad), Some(Quality::Good), Some(Quality::Good), Some(bad), Some(bad), Some(bad), Some(bad)]
        );
    }
}
