//! What a diagnosis says of a valve, and how well that explains a swing.
//!
//! ```text
//! explains = min(1, ln odds / 3) · min(1, 2 S / swing of OP)              half of that where the verdict is contested
//! ```
//!
//! S: how far OP travels behind a reversal before the stem moves; swing of OP: from peak to peak, about the period of the swing. A
//! dead band of half of OP's swing makes the fundamental of the stem lag OP by arctan(2 / pi) = 32°, and the lag falls with S. A loop
//! with the least phase margin that is usual, 30°, swings by friction only where S is about half of OP's swing or more: a smaller S may
//! be there, but does not sustain the swing.
//!
//! Source: Slotine & Li, Applied Nonlinear Control, 1991, chapter 5 (describing function of backlash); Åström & Hägglund, Advanced
//! PID Control, 2006 (usual margins).

use super::signs::SURE;
use crate::sysid::spectrum::Spectrum;

/// Evidence from which diagnoses are no longer told apart (-): as odds it is e^50.
const MOST_EVIDENCE: f64 = 100.0;
/// What a contested verdict counts of one that is not (-): of two models one is right, and neither has been proved.
const CONTESTED: f64 = 0.5;
/// S over OP's swing from peak to peak from which friction sustains a swing (-): the stem lags by the usual phase margin.
const SUSTAINS: f64 = 0.5;
/// Half width of the band of OP's swing, as a factor of its frequency: that of the band in which oscillations are found.
const WIDTH: f64 = 1.6;

/// The result of a diagnosis of a valve.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Friction {
    /// Whether it sticks.
    pub sticks: bool,
    /// Posterior of friction (0..1).
    pub probability: f64,
    /// Evidence for friction (-): twice the log of its odds, at most 100.
    pub evidence: f64,
    /// S, how far OP travels behind a reversal before the stem moves (OP unit), where known.
    pub band: Option<f64>,
    /// Whether another model gave another verdict, and was overruled because it predicts worse.
    pub is_contested: bool,
    /// The result as a sentence.
    pub says: String,
}

impl Friction {
    /// A result with its evidence for friction (-), without S and sentence. That of a contested verdict has half the probability.
    pub fn of(sticks: bool, evidence: f64, is_contested: bool) -> Self {
        let evidence = evidence.min(MOST_EVIDENCE);
        let odds = (0.5 * evidence).exp();
        let counts = if is_contested { CONTESTED } else { 1.0 };
        let probability = counts * odds / (1.0 + odds);
        Self { sticks, probability, evidence, is_contested, ..Self::default() }
    }

    /// Whether it shows that the valve sticks, and nothing speaks against it.
    pub(super) fn is_clear(&self) -> bool {
        self.sticks && !self.is_contested
    }

    /// How well it explains a swing in which OP moves so far from peak to peak (OP unit), where that is known (0..1).
    pub(super) fn explains(&self, swing: Option<f64>) -> f64 {
        if !self.sticks {
            return 0.0;
        }
        let sure = (0.5 * self.evidence / SURE).clamp(0.0, 1.0);
        let size = self.band.zip(swing.filter(|swing| *swing > 0.0));
        let sustains = size.map_or(1.0, |(band, swing)| (band / swing / SUSTAINS).clamp(0.0, 1.0));
        sure * sustains * if self.is_contested { CONTESTED } else { 1.0 }
    }
}

/// How far a signal swings from peak to peak about a period (samples): as the sine with the power of the band (the signal's unit).
pub(super) fn swing(of: &Spectrum, period: f64) -> f64 {
    let f = of.m as f64 / period;
    let (from, to) = ((f / WIDTH) as usize, ((f * WIDTH) as usize).min(of.bins.len().saturating_sub(1)));
    let power: f64 = of.bins.get(from..=to).unwrap_or_default().iter().map(|x| x.norm_sqr()).sum();
    // Each bin stands for itself and for its mirror image.
    let variance = 2.0 * power / (of.m as f64 * of.n.max(1) as f64);
    2.0 * (2.0 * variance).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::signs::whole;
    use crate::sysid::spectrum::Transforms;
    use std::f64::consts::TAU;

    #[test]
    fn friction_explains_a_swing_by_its_size() {
        let of = |band: f64| Friction { band: Some(band), ..Friction::of(true, 50.0, false) };
        // From half of OP's swing on, and in proportion below.
        let explained = |band: f64| of(band).explains(Some(8.0));
        assert_eq!([8.0, 4.0, 1.0, 0.0].map(explained), [1.0, 1.0, 0.25, 0.0]);
        // What is not known speaks neither for it nor against it.
        assert_eq!((of(1.0).explains(None), of(1.0).explains(Some(0.0))), (1.0, 1.0));
        assert_eq!(Friction::of(true, 50.0, false).explains(Some(8.0)), 1.0);
        assert_eq!(Friction { sticks: false, ..of(8.0) }.explains(Some(8.0)), 0.0);
    }

    #[test]
    fn a_contested_verdict_counts_half() {
        let (clear, contested) = (Friction::of(true, 21.0, false), Friction::of(true, 21.0, true));
        assert!(clear.is_clear() && !contested.is_clear() && !Friction::of(false, 21.0, false).is_clear());
        assert_eq!((clear.explains(None), contested.explains(None)), (1.0, 0.5));
        assert!(clear.probability > 0.999 && (contested.probability - 0.5 * clear.probability).abs() < 1e-12);
        // Beyond the most that counts, evidence is no longer told apart.
        assert_eq!(Friction::of(true, 700.0, false), Friction::of(true, 100.0, false));
    }

    #[test]
    fn a_swing_is_measured_beside_a_drift() {
        let x: Vec<f64> = (0..1440)
            .map(|k| {
                50.0 + 3.0 * (TAU * f64::from(k) / 31.0).sin() + 8.0 * (TAU * f64::from(k) / 480.0).sin()
            })
            .collect();
        let spectrum = whole(&x, &mut Transforms::new()).expect("it is long enough");
        let found = swing(&spectrum, 31.0);
        assert!((found - 6.0).abs() < 0.2, "{found}");
        assert!((swing(&spectrum, 480.0) - 16.0).abs() < 0.8, "{}", swing(&spectrum, 480.0));
        // A period that the record does not have.
        assert_eq!(swing(&spectrum, 0.1), 0.0);
    }
}
