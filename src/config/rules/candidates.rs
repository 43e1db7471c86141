//! Whether the tags of other loops that may explain a loop are there.

use super::super::LoopConfig;
use super::super::neighbours::{Candidates, MOST_CANDIDATES, find, in_other_letters};
use super::super::section::Parts;
use super::super::source::Step;
use super::Rules;

impl Rules<'_, '_, '_> {
    pub(super) fn candidates(&mut self, at: usize, control_loop: &LoopConfig, parts: &Parts) {
        let here = path!["loop", at, "candidates"];
        let names = match &control_loop.candidates {
            None => return,
            Some(Candidates::Auto) => {
                return self.unless(!control_loop.group.is_empty(), &here, || {
                    "candidates: \"auto\" takes the loops of the same group; give this loop a group".into()
                });
            }
            Some(Candidates::Named(names)) => names,
        };
        self.unless(names.len() <= MOST_CANDIDATES, &here, || {
            format!("candidates: {} are more than {MOST_CANDIDATES}; name the likely ones", names.len())
        });
        let own = |name: &str| {
            let rest = name.strip_prefix(control_loop.id.as_str());
            rest.is_some_and(|rest| rest.starts_with('.'))
        };
        for (nth, name) in names.iter().enumerate() {
            let here = [&here[..], &path![nth]].concat();
            let others = || parts.loops.iter().flatten().filter(|other| other.id != control_loop.id);
            if names[..nth].contains(name) {
                self.wrong(&here, format!("candidates: {name:?} is there twice"));
            } else if control_loop.tag.iter().any(|tag| tag.name() == Some(name)) {
                self.wrong(&here, format!("candidates: {name:?} is also a [[loop.tag]] of this loop"));
            } else if find(name, others()).is_none() {
                let what = match (own(name), name.contains('.')) {
                    (true, _) => "is this loop's own: name tags of other loops",
                    (false, true) => "is no tag of another loop: look at how the loop and the tag are called",
                    (false, false) => "is no tag of another loop; write them as loop.tag, like \"FIC203.pv\"",
                };
                let hint = in_other_letters(name, others()).map(|own| match own == *name {
                    true => "is a mode, which is no measurement: name a tag such as a loop's pv".to_string(),
                    false => format!("did you mean {own:?}?"),
                });
                let what = hint.as_deref().unwrap_or(what);
                self.wrong(&here, format!("candidates: {name:?} {what}"));
            }
        }
    }
}
