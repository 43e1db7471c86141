//! What a valve is made to do: travel and reversals a day, and the time in which it is stuck.
//!
//! ```text
//! travel    = sum |Δu| · 86,400 / T          changes within the noise are left out
//! reversals = turns of u by more than a swing · 86,400 / T
//! stuck     = share of the time in which PV stands within its noise while OP moves by more than a tenth of its spread
//! ```
//!
//! u is the measured stem where there is one, else OP (in its unit); T the time of the record in which it was measured (s). Wear
//! goes with both: a packing with the travel, a positioner with the reversals.
//!
//! Source: Jelali, Control Performance Management in Industrial Automation, 2013, section 2.3 (valve travel, reversals); Kano et
//! al., DYCOPS 2004 (stretches in which PV stands still while OP moves).

use super::noise;
use crate::diagnosis::denoise::noise_sd;
use crate::diagnosis::region::large_extrema;
use crate::sysid::stats::{median, range, sd};

/// Seconds a day.
const DAY_S: f64 = 86_400.0;
/// Noise standard deviations that a turn has to exceed, and its least share of the spread within an hour.
const TURN: (f64, f64) = (4.0, 0.05);
/// Time over which the spread is taken (s): an hour, the least time of which indicators are told; and fewest samples of it.
const SPREAD: (f64, usize) = (3600.0, 60);
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

impl Travel {
    /// Of a way (OP unit) and so many turns in some time (s); none of them in no time.
    pub fn new(way: f64, turns: f64, length_s: f64) -> Self {
        if !(length_s > 0.0 && way.is_finite()) {
            return Self::default();
        }
        Self { a_day: way * DAY_S / length_s, reversals_a_day: turns * DAY_S / length_s }
    }
}

/// Where `u` was first, at every turn and last, each with its sample: from turn to turn, so that noise on the way is no travel.
/// `ts`: sampling interval (s). Nothing of no sample.
pub fn path(u: &[f64], ts: f64) -> Vec<(usize, f64)> {
    let (Some(first), Some(last)) = (u.first(), u.last()) else { return Vec::new() };
    let swing = (TURN.0 * noise::sigma(u)).max(TURN.1 * spread(u, ts));
    let turns = large_extrema(u, swing).into_iter().map(|turn| (turn.index, turn.value));
    std::iter::once((0, *first)).chain(turns).chain([(u.len() - 1, *last)]).collect()
}

/// Standard deviation within an hour, the median of the hours in which `u` moves: another level does not hide the swing about it,
/// and a day is judged as its hours are. That of all samples where they are fewer than an hour's.
fn spread(u: &[f64], ts: f64) -> f64 {
    let moves = |own: &&[f64]| {
        let (low, high) = range(own);
        high > low
    };
    let hour = ((SPREAD.0 / ts) as usize).max(SPREAD.1);
    let within: Vec<f64> = u.chunks_exact(hour).filter(moves).map(sd).collect();
    if within.is_empty() { sd(u) } else { median(&within) }
}

/// Travel and reversals of `u`, of whose samples a share was measured (0..1): what is drawn through the others is no time in
/// which the valve was seen. None of them where it is too short.
pub fn travel(u: &[f64], ts: f64, measured: f64) -> Travel {
    if u.len() < 2 || !u.iter().all(|u| u.is_finite()) {
        return Travel::default();
    }
    let path = path(u, ts);
    let way: f64 = path.windows(2).map(|w| (w[1].1 - w[0].1).abs()).sum();
    // The ends are no turns.
    Travel::new(way, path.len() as f64 - 2.0, u.len() as f64 * ts * measured)
}

/// Share of the time in which PV stands still while OP moves (0..1), without the samples that are missing; none of a record
/// shorter than a stretch, or of an OP that does not move: then nothing was asked of the valve.
pub fn stuck(op: &[f64], pv: &[f64], is_missing: impl Fn(usize) -> bool) -> Option<f64> {
    let n = op.len().min(pv.len());
    let (low, high) = range(&op[..n]);
    // Of equal values the standard deviation may be more than nothing by rounding.
    (n >= STRETCH && high > low).then_some(())?;
    let (spread, noise) = (sd(&op[..n]), noise_sd(&pv[..n]));
    let still = (STILL.0 * noise).min(STILL.1 * sd(&pv[..n]));
    let (mut stuck, mut all) = (0_usize, 0_usize);
    let whole = |k: &usize| !(*k..*k + STRETCH).any(&is_missing);
    for k in (0..=n - STRETCH).step_by(STRETCH / 2).filter(whole) {
        let of = |v: &[f64]| {
            let (low, high) = range(&v[k..k + STRETCH]);
            high - low
        };
        all += 1;
        stuck += usize::from(of(op) > MOVES * spread && of(pv) <= still);
    }
    (all > 0).then(|| stuck as f64 / all as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    #[test]
    fn a_triangle_travels_its_height_twice_a_period() {
        // Period 40 samples of 60 s, height 10: 36 periods a day, 20 of way each; the ends make half a swing uncertain.
        let u: Vec<f64> = (0..1440).map(|k| (f64::from(k % 40) - 20.0).abs() * 0.5).collect();
        let found = travel(&u, 60.0, 1.0);
        assert!((found.a_day - 720.0).abs() < 11.0, "{found:?}");
        assert!((found.reversals_a_day - 71.0).abs() <= 1.0, "{found:?}");
        // The same in half of the time.
        let half = travel(&u, 60.0, 0.5);
        assert_eq!((half.a_day, half.reversals_a_day), (2.0 * found.a_day, 2.0 * found.reversals_a_day));
        for none in [travel(&[], 1.0, 1.0), travel(&[3.0; 50], 1.0, 1.0), travel(&u, 60.0, 0.0)] {
            assert_eq!(none, Travel::default());
        }
    }

    #[test]
    fn the_fastest_cycles_are_travel_and_noise_is_none() {
        // Four samples a period, rows of 5 s: 4,320 periods a day, and every step is way.
        let u: Vec<f64> = (0..720).map(|k| 50.0 + 5.0 * (TAU * f64::from(k) / 4.0 + 0.3).sin()).collect();
        let found = travel(&u, 5.0, 1.0);
        let steps: f64 = u.windows(2).map(|w| (w[1] - w[0]).abs()).sum();
        assert!((found.a_day / (steps * DAY_S / 3600.0) - 1.0).abs() < 1e-9, "{found:?} {steps}");
        assert!((found.reversals_a_day - 8640.0).abs() < 50.0, "{found:?}");
        // Where the level goes to another, a swing of a hundredth of the step still counts.
        let level = |k: u32| if k < 5400 { 20.0 } else { 80.0 };
        let small: Vec<f64> =
            (0..14_400).map(|k| level(k) + 0.3 * (TAU * f64::from(k) / 300.0).sin()).collect();
        assert!((travel(&small, 1.0, 1.0).reversals_a_day - 576.0).abs() < 20.0);
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(6));
        let noise: Vec<f64> = (0..720).map(|_| draw.next().unwrap_or(0.0)).collect();
        // Neighbours of pure noise are apart by four of its standard deviations now and then: here less than once in ten samples.
        assert!(travel(&noise, 1.0, 1.0).reversals_a_day < 0.1 * DAY_S, "{:?}", travel(&noise, 1.0, 1.0));
    }

    #[test]
    fn a_square_wave_behind_a_ramp_is_stuck_and_a_follower_is_not() {
        let op: Vec<f64> = (0..600).map(|k| (f64::from(k % 60) - 30.0).abs()).collect();
        let square: Vec<f64> = (0..600).map(|k| if (k / 30) % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let stuck = |op: &[f64], pv: &[f64]| stuck(op, pv, |_| false);
        let share = |pv: &[f64]| stuck(&op, pv).expect("OP moves");
        assert!(share(&square) > 0.6, "{}", share(&square));
        assert!(share(&op) < 0.05);
        // Nothing was asked of the valve, or not for long enough.
        assert_eq!((stuck(&[], &[]), stuck(&[3.0; 600], &square)), (None, None));
        // 0.1 is no sum of powers of two: the mean of many is another number.
        assert_eq!(stuck(&[0.1; 600], &square), None);
        assert_eq!(stuck(&op[..STRETCH - 1], &square[..STRETCH - 1]), None);
    }

    #[test]
    fn pv_drawn_through_a_gap_does_not_stand_still() {
        let op: Vec<f64> = (0..600).map(|k| (f64::from(k % 60) - 30.0).abs()).collect();
        let mut pv = op.clone();
        pv[200..400].fill(15.0);
        let share = |is_missing: &dyn Fn(usize) -> bool| stuck(&op, &pv, is_missing).expect("OP moves");
        assert!(share(&|_| false) > 0.25, "{}", share(&|_| false));
        assert!(share(&|k| (200..400).contains(&k)) < 0.05);
        assert_eq!(stuck(&op, &pv, |_| true), None);
    }
}
