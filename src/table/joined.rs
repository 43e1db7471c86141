//! Qualities that are tags of their own in a table with a row for each sample: `FIC101.PV.Quality` beside `FIC101.PV`.
//!
//! Such a tag may have samples only where it changes, and stand above or below its value in the file. It is read before the values,
//! and what it says holds until its next sample.

use super::channel::Channel;
use super::error::{TableError, shown};
use super::names::Name;
use super::says::Says;
use super::vocabulary::VALUES;
use super::words::Words;
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

/// The value of which a tag of this name says if it is good, and whether it does so by a word that means nothing else.
fn value_of(name: &Name) -> Option<(String, bool)> {
    let listed = name.quality_of().filter(|of| !of.is_empty());
    listed.map(|of| (of, true)).or_else(|| Some((name.may_qualify()?, false)))
}

/// Whether a tag of this name may say if the value of another is good.
pub fn is_quality(name: &str) -> bool {
    value_of(&Name::new(name)).is_some()
}

/// Whether a tag says so by its name and by what stands in it: `FIC101.PV_CODE` may be measured, and `FIC101.PV_STS` a text.
fn may_say(own: &Channel) -> bool {
    let by_name = value_of(&Name::new(&own.tag.name));
    let says = |words: &Words| {
        by_name.is_some_and(|(_, is_sure)| is_sure || words.speak_of_quality() || words.are_states())
    };
    own.role.is_none() && own.quality.as_ref().is_some_and(says)
}

/// How a tag says it; `None` where the good values that are told are not among its own, so that they are meant for others.
///
/// # Errors
/// Nobody knows how, or whether it does.
fn how(tag: &str, words: &Words, is_sure: bool, told: Option<&[String]>) -> Result<Option<Says>, TableError> {
    let meant = told.filter(|good| words.more || words.any_of(good));
    if is_sure || meant.is_some() || words.speak_of_quality() {
        return Says::decide(words, meant, tag);
    }
    if told.is_some() {
        return Ok(None);
    }
    Err(TableError::refused(format!(
        "tag {:?} may say which values are good: it holds {}; list the good ones with --good-values, or all of them where it says \
         nothing of the kind",
        shown(tag),
        words.listed()
    )))
}

/// The tags that say of others whether they are good; both channels know of it then.
///
/// # Errors
/// One of which nobody knows how it says it, where its value is needed: it belongs to the loop that is read, or to any where `all` are.
pub fn find(channels: &mut [Channel], told: Option<&[String]>, all: bool) -> Result<Vec<Joined>, TableError> {
    if !channels.iter().any(may_say) {
        return Ok(Vec::new());
    }
    let mut values: HashMap<(&str, String), Vec<usize>> = HashMap::new();
    for (at, own) in channels.iter().enumerate().filter(|(_, own)| !may_say(own)) {
        let name = Name::new(&own.tag.name);
        let short = |word: &&str| name.plain().strip_suffix(*word)?.strip_suffix(' ').map(str::to_string);
        // The letter of `FIC101.PV C` may be its unit, which its quality has not.
        let lettered = name.lettered().map(|(before, _)| before.plain().to_string());
        let keys = VALUES.iter().filter_map(short).chain([name.plain().to_string()]).chain(lettered);
        for key in keys.filter(|key| !key.is_empty()) {
            values.entry((own.tag.owner.as_str(), key)).or_default().push(at);
        }
    }
    let is_needed =
        |value: &Channel| value.role.is_some() || all && Name::new(&value.tag.name).said().is_some();
    let mut found: Vec<(Vec<usize>, Joined)> = Vec::new();
    for (by, own) in channels.iter().enumerate().filter(|(_, own)| may_say(own)) {
        let Some((of, is_sure)) = value_of(&Name::new(&own.tag.name)) else { continue };
        let Some(of) = values.get(&(own.tag.owner.as_str(), of)).cloned() else { continue };
        let Some(words) = &own.quality else { continue };
        let needed = of.iter().any(|at| is_needed(&channels[*at]));
        match how(&own.tag.name, words, is_sure, told) {
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
