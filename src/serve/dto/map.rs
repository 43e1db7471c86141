//! The whole plant or fleet in a few letters a unit, for a map.

use super::params::AlarmState;
use super::rfc3339;
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Every loop as a letter, by unit.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PlantMap {
    /// When.
    pub time: Option<String>,
    /// Loops in all.
    pub total: usize,
    /// The units, by name.
    pub groups: Vec<MapGroup>,
}

/// The loops of a unit.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct MapGroup {
    /// What it is called; at a centre `site / unit`, or the site alone.
    pub group: String,
    /// A letter for each of its loops, worst first. By the alarm: `U` unacknowledged, `A` acknowledged, `R` returned and not
    /// acknowledged, `L` latched, `H` shelved, `X` suppressed or out of service. Where that is normal, by the verdict: `S`
    /// stiction, `N` not identifiable, `W` not diagnosed yet, `O` no stiction.
    pub loops: String,
}

/// Letters, worst first.
const WORST_FIRST: &str = "UASRLHXNWO";

/// How a loop looks.
fn letter(alarm: AlarmState, verdict: Option<&str>) -> char {
    match (alarm, verdict) {
        (AlarmState::Unacknowledged, _) => 'U',
        (AlarmState::Acknowledged, _) => 'A',
        (AlarmState::ReturnedUnacknowledged, _) => 'R',
        (AlarmState::LatchedUnacknowledged | AlarmState::LatchedAcknowledged, _) => 'L',
        (AlarmState::Shelved, _) => 'H',
        (AlarmState::SuppressedByDesign | AlarmState::OutOfService, _) => 'X',
        (AlarmState::Normal, Some("stiction")) => 'S',
        (AlarmState::Normal, Some("no_stiction")) => 'O',
        (AlarmState::Normal, Some(_)) => 'N',
        (AlarmState::Normal, None) => 'W',
    }
}

impl PlantMap {
    /// The map of loops, each with its unit, its alarm's state and its verdict.
    pub fn of<'a>(loops: impl Iterator<Item = (&'a str, AlarmState, Option<&'a str>)>, now: f64) -> Self {
        let mut groups: BTreeMap<&str, Vec<char>> = BTreeMap::new();
        let mut total = 0;
        for (group, alarm, verdict) in loops {
            groups.entry(group).or_default().push(letter(alarm, verdict));
            total += 1;
        }
        let group = |(group, mut loops): (&str, Vec<char>)| {
            loops.sort_by_key(|letter| WORST_FIRST.find(*letter));
            MapGroup { group: group.to_string(), loops: loops.into_iter().collect() }
        };
        Self { time: rfc3339(now), total, groups: groups.into_iter().map(group).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_letter_for_each_loop_by_unit_worst_first() {
        let loops = [
            ("north / 2", AlarmState::Normal, Some("no_stiction")),
            ("north / 1", AlarmState::Normal, None),
            ("north / 1", AlarmState::Normal, Some("not_identifiable")),
            ("north / 1", AlarmState::Shelved, Some("stiction")),
            ("north / 1", AlarmState::Unacknowledged, Some("stiction")),
            ("north / 1", AlarmState::Normal, Some("stiction")),
        ];
        let map = PlantMap::of(loops.into_iter(), 0.0);
        let groups: Vec<_> = map.groups.iter().map(|own| (own.group.as_str(), own.loops.as_str())).collect();
        assert_eq!((map.total, groups), (6, vec![("north / 1", "USHNW"), ("north / 2", "O")]));
    }
}
