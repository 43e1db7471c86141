//! The sentences for PV's measurement as the cause ([`super::Cause::Sensor`]): what is seen of PV, what it does to the valve, and what to
//! do about it.
//!
//! ```text
//! jump   = 2 / sqrt(pi) sigma     mean of |u[k] - u[k-1]| of white noise (% of OP's span)
//! range  = 4 sd                   OP is in it for 95 % of the time (% of OP's span)
//! values = 4 / q                  PV takes about as many in 95 % of the time
//! ```
//!
//! sigma: standard deviation of OP's noise; sd: that of OP; q: quantum of PV in standard deviations. Both of OP are known where its span
//! is.

use super::LoopFound;
use super::signs::HELD;
use crate::signal::{beside, share};
use std::f64::consts::FRAC_2_SQRT_PI;

/// Range of OP below which a common positioner does not move the valve (% of its span): the dead band as delivered, which is 0.5 % of
/// the input's span (Spirax Sarco, Installation and Maintenance Instructions IM-P343-29, 9.6.1; 0.2 % is the least that can be set).
const DEAD_BAND: f64 = 0.5;
/// Standard deviations of the range in which a normal signal is for 95 % of the time.
const RANGE: f64 = 4.0;
/// Share of the time above which it is told that PV stands still (-); judged: less is not worth a look at the transmitter.
const STANDS: f64 = 0.05;
/// Quantum of PV above which it is told (standard deviations): 40 values in 95 % of the time.
const COARSE: f64 = 0.1;
/// Share of PV's variance above which noise is told, and above which PV is called noise alone (-); judged: less than a tenth is
/// usual, and more than 95 % leaves nothing to control.
const NOISY: (f64, f64) = (0.1, 0.95);
/// Least jump of OP that is told (% of its span): below it one decimal would be 0.
const TOLD: f64 = 0.05;

/// What is seen of PV.
enum Fault {
    /// It does not change at all for this share of the time, without a break.
    Held(f64),
    /// It has this quantum (standard deviations).
    Coarse(f64),
    /// It stands still for this share of the time while OP moves.
    Still(f64),
    /// This share of its variance is noise.
    Noisy(f64),
    /// Its signals alone look like that.
    Other,
}

impl Fault {
    fn of(of: &LoopFound) -> Self {
        let (held, stands, kept) = (of.signs[HELD], of.indicators.stuck, of.indicators.kept);
        match stands.filter(|share| *share > STANDS) {
            _ if held > STANDS => Self::Held(held),
            _ if kept.quantisation > COARSE => Self::Coarse(kept.quantisation),
            Some(share) => Self::Still(share),
            None if kept.noise_share > NOISY.0 => Self::Noisy(kept.noise_share),
            None => Self::Other,
        }
    }
}

/// Whether noise or coarse steps of PV move OP by so little that the valve does not follow. It is false where OP's span is not known.
pub(super) fn costs_nothing(of: &LoopFound) -> bool {
    matches!(Fault::of(of), Fault::Coarse(_) | Fault::Noisy(_)) && unfelt(of).is_some()
}

/// The range of OP (% of its span), where a positioner does not follow it.
fn unfelt(of: &LoopFound) -> Option<f64> {
    of.op_spread.map(|op| RANGE * op.sd).filter(|range| *range <= DEAD_BAND)
}

/// The sentence.
pub(super) fn why(of: &LoopFound) -> String {
    let percent = |part: f64| share(part, 0);
    match Fault::of(of) {
        Fault::Held(share) => format!(
            "PV does not change at all for {} of the time without a break, and the controller is blind meanwhile: check the transmitter, \
             and how its values are collected",
            percent(share)
        ),
        Fault::Still(share) => format!(
            "PV stands still for {} of the time while OP moves, and the controller is blind meanwhile: check the transmitter",
            percent(share)
        ),
        Fault::Coarse(quantum) => {
            let seen =
                format!("PV is so coarse that it takes about {:.0} values", (RANGE / quantum).max(2.0));
            let remedy =
                "look for the coarse step in the transmitter's range, the input card and the archive";
            with_cost(of, &seen, "each step", remedy)
        }
        Fault::Noisy(share) => {
            let seen = if share >= NOISY.1 {
                "PV is noise alone".to_string()
            } else {
                format!("{} of PV's variance is noise", percent(share))
            };
            let remedy = if of.indicators.is_at_minimum() {
                "filter PV, since no tuning at this sample period makes it steadier"
            } else {
                "filter PV or lower the controller's gain"
            };
            with_cost(of, &seen, "it", remedy)
        }
        Fault::Other => {
            "PV's signal looks like that of a faulty measurement: compare it with a second reading".into()
        }
    }
}

/// What is seen of PV, with what it costs the valve and, where it costs something, the remedy. `what`: what the controller passes on.
fn with_cost(of: &LoopFound, seen: &str, what: &str, remedy: &str) -> String {
    if let Some(range) = unfelt(of) {
        return format!(
            "{seen}, but OP stays within {} % of its span, which a common positioner does not follow: it costs the valve nothing",
            beside(range, &[DEAD_BAND], 2)
        );
    }
    let jump = of.op_spread.map(|op| FRAC_2_SQRT_PI * op.finest).filter(|jump| *jump >= TOLD);
    let moves = jump.map_or_else(
        || "OP moves".to_string(),
        |jump| format!("OP jumps by {jump:.1} % of its span from sample to sample"),
    );
    format!("{seen}, and the controller passes {what} on: {moves} without need; {remedy}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::indicators::harris::Harris;
    use crate::indicators::noise::Spread;

    /// A loop whose OP has this standard deviation, all of it noise (% of its span).
    fn jumping(sd: f64) -> LoopFound {
        LoopFound { op_spread: Some(Spread { sd, noise: sd, finest: sd }), ..LoopFound::default() }
    }

    #[test]
    fn a_measurement_is_blamed_for_what_is_seen_of_it() {
        let mut of = LoopFound::default();
        assert_eq!(
            why(&of),
            "PV's signal looks like that of a faulty measurement: compare it with a second reading"
        );
        of.indicators.kept.noise_share = 0.4;
        assert_eq!(
            why(&of),
            "40 % of PV's variance is noise, and the controller passes it on: OP moves without need; filter PV or lower the controller's gain"
        );
        of.indicators.stuck = Some(0.2);
        assert_eq!(
            why(&of),
            "PV stands still for 20 % of the time while OP moves, and the controller is blind meanwhile: check the transmitter"
        );
        of.indicators.kept.quantisation = 0.5;
        assert_eq!(
            why(&of),
            "PV is so coarse that it takes about 8 values, and the controller passes each step on: OP moves without need; look for the \
             coarse step in the transmitter's range, the input card and the archive"
        );
        of.signs[HELD] = 0.3;
        assert_eq!(
            why(&of),
            "PV does not change at all for 30 % of the time without a break, and the controller is blind meanwhile: check the transmitter, \
             and how its values are collected"
        );
    }

    #[test]
    fn noise_says_what_it_does_to_op_where_the_span_is_known() {
        let mut of = jumping(3.0);
        of.indicators.kept.noise_share = 1.0;
        assert_eq!(
            why(&of),
            "PV is noise alone, and the controller passes it on: OP jumps by 3.4 % of its span from sample to sample without need; filter \
             PV or lower the controller's gain"
        );
        assert!(!costs_nothing(&of));
    }

    #[test]
    fn what_a_positioner_does_not_follow_costs_the_valve_nothing() {
        for (noise_share, quantisation) in [(1.0, 0.0), (0.5, 0.5)] {
            // The range of four standard deviations is within half a per cent of the span, and beyond.
            for (sd, free) in [(0.12, true), (0.13, false)] {
                let mut of = jumping(sd);
                (of.indicators.kept.noise_share, of.indicators.kept.quantisation) =
                    (noise_share, quantisation);
                assert_eq!(costs_nothing(&of), free, "{sd}");
                let said = why(&of);
                let says_so = said.ends_with(
                    "but OP stays within 0.48 % of its span, which a common positioner does not follow: it costs the valve nothing",
                );
                assert_eq!(says_so, free, "{said}");
                // In units that nobody knows the span of.
                assert!(!costs_nothing(&LoopFound { op_spread: None, ..of.clone() }));
                // A PV that is frozen is one however little OP moves.
                of.signs[HELD] = 0.3;
                assert!(!costs_nothing(&of));
            }
        }
    }

    #[test]
    fn a_loop_at_its_minimum_variance_is_not_to_be_tuned() {
        let mut of = jumping(3.0);
        of.indicators.kept.noise_share = 1.0;
        let harris = |low| Some(Harris { index: 0.97, interval: Some((low, 1.0)) });
        for (low, tuning) in [(0.85, true), (0.95, false)] {
            of.indicators.harris = harris(low);
            let said = why(&of);
            assert_eq!(said.contains("lower the controller's gain"), tuning, "{said}");
            assert_eq!(
                said.ends_with("filter PV, since no tuning at this sample period makes it steadier"),
                !tuning,
                "{said}"
            );
        }
    }
}
