//! When which letter is tried: one after the other, the oldest first, and nothing new becomes a letter meanwhile. A letter that
//! some have already holds nobody up: it is tried again beside the others.

use crate::notify::letters::Letters;
use std::collections::HashMap;

/// How one letter was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trial {
    /// When it was tried first (s).
    pub first: f64,
    /// When it is tried next (s).
    pub next: f64,
    pub failures: u32,
}

/// How the letters that wait were tried, by name.
#[derive(Default)]
pub(super) struct Trials(HashMap<String, Trial>);

impl Trials {
    /// How a letter was tried; one that never was is tried now.
    pub(super) fn of(&mut self, id: &str, now: f64) -> &mut Trial {
        self.0.entry(id.to_string()).or_insert(Trial { first: now, next: now, failures: 0 })
    }

    /// Whether a letter was tried and not taken.
    pub(super) fn has_failed(&self, id: &str) -> bool {
        self.0.get(id).is_some_and(|trial| trial.failures > 0)
    }

    /// A letter waits no longer: replayed, it is tried as if for the first time.
    pub(super) fn forget(&mut self, id: &str) {
        self.0.remove(id);
    }

    /// What is due next and when (s): the letter of a name, or without one a new letter of the batch, which is due at `batch`.
    pub(super) fn next(
        &mut self,
        letters: &Letters,
        batch: Option<f64>,
        now: f64,
    ) -> Option<(f64, Option<String>)> {
        let first = match letters.whole() {
            Some(id) => Some((self.of(&id, now).next, Some(id))),
            None => batch.map(|due| (due, None)),
        };
        let partly = letters.partly().into_iter().map(|id| (self.of(&id, now).next, Some(id)));
        // What nobody has goes first where both are due.
        let due = first.as_ref().is_some_and(|(due, _)| *due <= now);
        let all = first.into_iter().chain(partly.filter(|_| !due));
        all.min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::notify::Letter;

    #[test]
    fn a_letter_that_some_have_holds_nothing_up() {
        let (letters, mut trials) = (Letters::open(None, 5), Trials::default());
        let put = |made: f64| {
            let letter = Letter::new("text".into(), made).unwrap();
            let id = letter.id.clone();
            letters.put(letter);
            id
        };
        let [first, second] = [1.0, 2.0].map(put);
        assert_eq!(trials.next(&letters, Some(0.0), 1.0), Some((1.0, Some(first.clone()))));
        trials.of(&first, 1.0).next = 50.0;
        // While nobody has it, everything else waits for it.
        assert_eq!(trials.next(&letters, Some(0.0), 1.0), Some((50.0, Some(first.clone()))));
        letters.lack(&first, vec!["b@plant".into()]);
        assert_eq!(trials.next(&letters, Some(0.0), 2.0), Some((2.0, Some(second.clone()))));
        letters.done(&second);
        assert_eq!(trials.next(&letters, Some(10.0), 2.0), Some((10.0, None)));
        assert_eq!(trials.next(&letters, None, 2.0), Some((50.0, Some(first))));
    }
}
