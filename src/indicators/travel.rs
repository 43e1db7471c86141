//! What a valve is made to do: travel and reversals a day, and the time in which it is stuck.
//!
//! ```text
//! travel    = sum |Δu| · 86,400 / T          changes within the noise are left out
//! reversals = turns of u by more than a swing · 86,400 / T
//! stuck     = share of the time in which PV stands within its noise while OP moves by more than a tenth of its spread
//! ```
//!
//! u is the measured stem where there is one, else OP (in its unit); T the length of the record (s). Wear goes with both: a
//! packing with the travel, a positioner with the reversals.
//!
//! Source: Jelali, Control Performance Management in Industrial Automation, 2013, section 2.3 (valve travel, reversals); Kano et
//! al., DYCOPS 2004 (stretches in which PV stands still while OP moves).

use crate::diagnosis::denoise::noise_sd;
use crate::diagnosis::region::large_extrema;
use crate::sysid::stats::{range, sd};

/// Seconds a day.
const DAY_S: f64 = 86_400.0;
/// Noise standard deviations that a turn has to exceed, and its least share of the spread.
const TURN: (f64, f64) = (4.0, 0.05);
/// Samples of a stretch, and the share of OP's spread that OP moves by in it.
const STRETCH: usize = 6;
const MOVES: f64 = 0.1;
/// Range of a PV that stands still, in noise standard deviations (that of six normal values is 2.5), and its largest share of
/// PV's spread.
const STILL: (f64, f64) = (3.0, 0.1);

/// The work of a valve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Travel {
    /// Way a day (OP unit).
    pub a_day: f64,
    /// Reversals a day.
    pub reversals_a_day: f64,
}

/// Travel and reversals of `u`; none of them where it is too short.
pub fn travel(u: &[f64], ts: f64) -> Travel {
    let length = u.len() as f64 * ts;
    if u.len() < 2 || length <= 0.0 || !u.iter().all(|u| u.is_finite()) {
        return Travel::default();
    }
    let noise = noise_sd(u);
    let extrema = large_extrema(u, (TURN.0 * noise).max(TURN.1 * sd(u)));
    // From turn to turn, so that noise on the way is no travel.
    let ends = [(0, u[0]), (u.len() - 1, u[u.len() - 1])];
    let points: Vec<f64> = std::iter::once(ends[0].1)
        .chain(extrema.iter().map(|e| e.value))
        .chain(std::iter::once(ends[1].1))
        .collect();
    let way: f64 = points.windows(2).map(|w| (w[1] - w[0]).abs()).sum();
    Travel { a_day: way * DAY_S / length, reversals_a_day: extrema.len() as f64 * DAY_S / length }
}

/// Share of the time in which PV stands still while OP moves (0..1); none of a record shorter than a stretch, or of an OP that
/// does not move: then nothing was asked of the valve.
pub fn stuck(op: &[f64], pv: &[f64]) -> Option<f64> {
    let n = op.len().min(pv.len());
    let (spread, noise) = (sd(&op[..n]), noise_sd(&pv[..n]));
    let still = (STILL.0 * noise).min(STILL.1 * sd(&pv[..n]));
    (n >= STRETCH && spread > 0.0).then_some(())?;
    let (mut stuck, mut all) = (0_usize, 0_usize);
    for k in (0..=n - STRETCH).step_by(STRETCH / 2) {
        let of = |v: &[f64]| {
            let (low, high) = range(&v[k..k + STRETCH]);
            high - low
        };
        all += 1;
        stuck += usize::from(of(op) > MOVES * spread && of(pv) <= still);
    }
    Some(stuck as f64 / all as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_travels_its_height_twice_a_period() {
        // Period 40 samples of 60 s, height 10: 36 periods a day, 20 of way each; the ends make half a swing uncertain.
        let u: Vec<f64> = (0..1440).map(|k| (f64::from(k % 40) - 20.0).abs() * 0.5).collect();
        let found = travel(&u, 60.0);
        assert!((found.a_day - 720.0).abs() < 11.0, "{found:?}");
        assert!((found.reversals_a_day - 71.0).abs() <= 1.0, "{found:?}");
        assert_eq!(travel(&[], 1.0), Travel::default());
        assert_eq!(travel(&[3.0; 50], 1.0), Travel::default());
    }

    #[test]
    fn a_square_wave_behind_a_ramp_is_stuck_and_a_follower_is_not() {
        let op: Vec<f64> = (0..600).map(|k| (f64::from(k % 60) - 30.0).abs()).collect();
        let square: Vec<f64> = (0..600).map(|k| if (k / 30) % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let share = |pv: &[f64]| stuck(&op, pv).expect("OP moves");
        assert!(share(&square) > 0.6, "{}", share(&square));
        assert!(share(&op) < 0.05);
        // Nothing was asked of the valve, or not for long enough.
        assert_eq!((stuck(&[], &[]), stuck(&[3.0; 600], &square)), (None, None));
        assert_eq!(stuck(&op[..STRETCH - 1], &square[..STRETCH - 1]), None);
    }
}
