//! Valve and dynamics by turns: dynamics estimated with a wrong valve hide the right one, those of a better valve show it.

/// How often a search goes on from what it found, and the gain for which it does (-).
pub const CLIMBS: usize = 3;
const HIGHER: f64 = 2.0;

/// What `next` makes of the start and then of the best so far, as long as that gains: each with its gain, the best last.
pub fn climb<T: Copy>(
    start: (f64, T),
    most: usize,
    mut next: impl FnMut(T) -> Option<(f64, T)>,
) -> Vec<(f64, T)> {
    let (mut found, mut best) = (Vec::new(), start);
    while found.len() < most {
        let Some(better) = next(best.1).filter(|better| better.0 > best.0 + HIGHER) else { break };
        found.push(better);
        best = better;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_ends_where_little_is_gained_or_enough_was_tried() {
        let by = |gain: f64| move |at: i32| Some((gain * f64::from(at + 1), at + 1));
        assert_eq!(climb((0.0, 0), CLIMBS, by(5.0)), [(5.0, 1), (10.0, 2), (15.0, 3)]);
        assert_eq!(climb((0.0, 0), CLIMBS, by(HIGHER)), []);
        assert_eq!(climb((f64::NEG_INFINITY, 0), CLIMBS, by(1.0)), [(1.0, 1)]);
        assert_eq!(climb((0.0, 0), CLIMBS, |_| None), []);
    }
}
