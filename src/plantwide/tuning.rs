//! The sentence for the tuning as the cause: what the loop's signals show, with its margins as evidence for it or against it.
//!
//! The cause is told by the signals. The margins ([`crate::indicators::margins`]) do not change its probability: they say which kind of
//! tuning it is, and where they contradict it the sentence says so.

use super::LoopFound;
use super::cause::period;
use crate::indicators::margins::{Margins, Tuned};

/// The evidence in one sentence.
pub fn why(of: &LoopFound) -> String {
    let swing = of.oscillations.first().map(|own| period(own.period_s));
    let is_tight = |margins: &Margins| margins.tuned() == Tuned::Tightly;
    if of.indicators.is_at_minimum() {
        let signals = "its error comes and goes as under a wrong tuning, but is as small as any tuning at this sample period makes it: leave the tuning as it is";
        return match of.margins.as_ref().filter(|margins| is_tight(margins)) {
            Some(margins) => format!("{signals}, though it is tight: {}", margins.words()),
            None => signals.into(),
        };
    }
    let signals = match &swing {
        Some(swing) => format!(
            "it rings with a period of {swing}, and its amplitude comes and goes, as in a loop with little damping"
        ),
        None => "its error comes and goes slowly, and the controller hardly acts on it".into(),
    };
    let Some(margins) = &of.margins else { return signals };
    let (told, usual) = (margins.words(), Margins::usual());
    match (margins.tuned(), swing.is_some()) {
        (Tuned::Tightly, true) => format!("too tight: {told}; {signals}"),
        (Tuned::Loosely, false) => format!("sluggish: {told}; {signals}"),
        (Tuned::Tightly, false) => {
            format!(
                "{signals}; but its margins are those of a controller that is too tight: {told} ({usual})"
            )
        }
        (Tuned::Loosely, true) => {
            format!(
                "{signals}; but its margins are not those of a controller that is too tight: {told} ({usual})"
            )
        }
        (Tuned::Usually, _) => {
            format!("{signals}; but its margins are not those of a wrong tuning: {told} ({usual})")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::indicators::harris::Harris;
    use crate::plantwide::cause::tests::swing;

    fn margins(gain: f64, phase_deg: f64) -> Option<Margins> {
        Some(Margins { gain: Some(gain), phase_deg: Some(phase_deg), ..Margins::default() })
    }

    const RINGS: &str =
        "it rings with a period of 60 s, and its amplitude comes and goes, as in a loop with little damping";
    const CREEPS: &str = "its error comes and goes slowly, and the controller hardly acts on it";

    #[test]
    fn margins_say_which_tuning_it_is_and_what_they_contradict() {
        let of = |margins, rings: bool| {
            let oscillations = if rings { vec![swing()] } else { Vec::new() };
            why(&LoopFound { margins, oscillations, ..LoopFound::default() })
        };
        assert_eq!((of(None, true).as_str(), of(None, false).as_str()), (RINGS, CREEPS));
        assert_eq!(
            of(margins(1.3, 17.0), true),
            format!("too tight: gain margin 1.3, phase margin 17°; {RINGS}")
        );
        assert_eq!(
            of(margins(9.1, 78.0), false),
            format!("sluggish: gain margin 9.1, phase margin 78°; {CREEPS}")
        );
        let usual = "(usual are 2 to 5 and 30° to 60°)";
        assert_eq!(
            of(margins(9.1, 78.0), true),
            format!(
                "{RINGS}; but its margins are not those of a controller that is too tight: gain margin 9.1, phase margin 78° {usual}"
            )
        );
        assert_eq!(
            of(margins(1.3, 17.0), false),
            format!(
                "{CREEPS}; but its margins are those of a controller that is too tight: gain margin 1.3, phase margin 17° {usual}"
            )
        );
        for (rings, signals) in [(true, RINGS), (false, CREEPS)] {
            assert_eq!(
                of(margins(3.0, 45.0), rings),
                format!(
                    "{signals}; but its margins are not those of a wrong tuning: gain margin 3.0, phase margin 45° {usual}"
                )
            );
        }
    }

    #[test]
    fn an_error_as_small_as_can_be_is_left_alone_and_a_tight_tuning_is_told() {
        let mut of = LoopFound::default();
        of.indicators.harris = Some(Harris { index: 0.96, interval: Some((0.93, 0.99)) });
        let alone = why(&of);
        assert!(alone.ends_with("leave the tuning as it is"), "{alone}");
        of.margins = margins(3.0, 45.0);
        assert_eq!(why(&of), alone);
        of.margins = margins(1.3, 17.0);
        assert_eq!(why(&of), format!("{alone}, though it is tight: gain margin 1.3, phase margin 17°"));
    }
}
