//! What a loop says of its neighbours and of its price.

use super::super::LoopConfig;
use super::super::section::Parts;
use super::super::source::Step;
use super::super::wording;
use super::Rules;

/// Most loops that are said to flow into one.
const MOST_UPSTREAM: usize = 50;

impl Rules<'_, '_, '_> {
    pub(super) fn upstream(&mut self, at: usize, control_loop: &LoopConfig, parts: &Parts) {
        let here = path!["loop", at, "upstream"];
        let names = &control_loop.upstream;
        if names.is_empty() {
            // Of many loops few have any: the names of all are not gathered for each.
            return;
        }
        self.unless(names.len() <= MOST_UPSTREAM, &here, || {
            format!("upstream: {} are more than {MOST_UPSTREAM}; name the nearest", names.len())
        });
        let known: Vec<&str> = parts.loops.iter().flatten().map(|other| other.id.as_str()).collect();
        for (nth, name) in names.iter().enumerate() {
            let here = [&here[..], &path![nth]].concat();
            if *name == control_loop.id {
                self.wrong(&here, format!("upstream: {name:?} is this loop"));
            } else if names[..nth].contains(name) {
                self.wrong(&here, format!("upstream: {name:?} is there twice"));
            } else if !known.contains(&name.as_str()) {
                let others: Vec<&str> =
                    known.iter().copied().filter(|other| *other != control_loop.id).collect();
                let hint = wording::hint(name, &others);
                self.wrong(&here, format!("upstream: no [[loop]] has the id {name:?}{hint}"));
            }
        }
    }

    /// Prices are added up over a source and its victims, so that all have one unit.
    pub(super) fn cost(&mut self, at: usize, control_loop: &LoopConfig, parts: &Parts) {
        let Some(own) = &control_loop.cost else { return };
        for (field, message) in own.validate() {
            self.wrong(&path!["loop", at, "cost", field], format!("{field}: {message}"));
        }
        let priced = |other: &LoopConfig| Some((other.id.clone(), other.cost.as_ref()?.unit.clone()));
        let first = parts.loops.iter().flatten().find_map(priced).filter(|(_, unit)| *unit != own.unit);
        if let Some((id, unit)) = first {
            let message = format!(
                "unit: {:?} here and {unit:?} at {id:?}: prices are added up, so give all of them in one unit",
                own.unit
            );
            self.wrong(&path!["loop", at, "cost", "unit"], message);
        }
    }
}
