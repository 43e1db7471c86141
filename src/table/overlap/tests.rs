use super::*;

/// Whether two records lie within each other, by times and values in the order of the file: the line, and for how long.
fn found(rows: &[(f64, u64)]) -> Option<(u64, f64)> {
    let mut ways = [0, 0];
    for pair in rows.windows(2) {
        ways[usize::from(pair[1].0 < pair[0].0)] += 1;
    }
    let mut runs = Runs::new(1, ways[1] > ways[0]);
    assert!(rows.iter().all(|(t, _)| runs.add(0, *t)));
    let mut overlaps = runs.overlaps();
    for (line, (t, value)) in (2..).zip(rows) {
        overlaps.add(0, *t, line, *value);
    }
    overlaps.first().filter(|found| !found.is_small()).map(|found| (found.line, found.length))
}

/// Rows every two seconds from a time on.
fn steady(from: f64, count: usize, value: u64) -> Vec<(f64, u64)> {
    (0..count).map(|at| (from + 2.0 * at as f64, value + at as u64)).collect()
}

/// Numbers that look random, below `most`.
fn random(most: usize) -> impl FnMut() -> usize {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % most
    }
}

#[test]
fn records_within_each_other_are_found_in_either_direction() {
    let first = steady(0.0, 1200, 0);
    for second in [
        // Another loop, between the rows and at the same times; a clock that was set back.
        steady(0.7, 1200, 5000),
        steady(0.0, 1200, 5000),
        steady(2400.7 - 900.0, 600, 5000),
        // Another one, thirty times as slow.
        (0..40).map(|at| (60.0 * f64::from(at) + 0.5, 7)).collect(),
    ] {
        let both = [first.clone(), second.clone()].concat();
        let length = 2398.0 - second[0].0;
        let (line, long) = found(&both).expect("two records");
        assert!(line == 1202 && (long - length).abs() < 60.0, "{line}: {long}");
        let turned: Vec<(f64, u64)> = both.iter().rev().copied().collect();
        assert!(found(&turned).is_some(), "{}", second[0].0);
    }
}

#[test]
fn one_record_in_any_order_is_none_of_two() {
    let whole = steady(0.0, 1200, 0);
    let turned: Vec<(f64, u64)> = whole.iter().rev().copied().collect();
    let blocks = |order: &[usize]| -> Vec<(f64, u64)> {
        order.iter().flat_map(|at| whole[100 * at..100 * (at + 1)].iter().copied()).collect()
    };
    let names = blocks(&[3, 7, 11, 1, 0, 6, 5, 2, 4, 10, 9, 8]);
    let even_first = blocks(&[0, 2, 4, 6, 8, 10, 1, 3, 5, 7, 9, 11]);
    let again = [&whole[..700], &whole[500..]].concat();
    let late = |every: usize, by: usize| {
        let mut rows = whole.clone();
        (0..1200 - by).step_by(every).for_each(|at| {
            let row = rows.remove(at);
            rows.insert(at + by, row);
        });
        rows
    };
    let mut next = random(1200);
    let mut mixed = whole.clone();
    (0..1200).for_each(|at| mixed.swap(at, next()));
    for (what, rows) in [
        ("newest first", turned.clone()),
        ("months by their names", names),
        ("even first", even_first),
        ("overlapping exports", again.clone()),
        ("overlapping exports, newest first", again.iter().rev().copied().collect()),
        ("late by one row", late(7, 1)),
        ("late by forty rows", late(50, 40)),
        ("fifteen rows late", [&whole[..400], &whole[415..600], &whole[400..415], &whole[600..]].concat()),
        ("in no order", mixed),
    ] {
        assert_eq!(found(&rows), None, "{what}");
    }
}

#[test]
fn blocks_of_an_irregular_record_are_one_in_any_order() {
    let mut next = random(1000);
    let mut t = 0.0;
    let rows: Vec<(f64, u64)> = (0..2000)
        .map(|at| {
            t += [1.0, 1.0, 2.0, 5.0, 30.0, 300.0][next() % 6] * (next() + 1) as f64 / 1000.0;
            (t, at)
        })
        .collect();
    for cuts in [[100, 900, 1500], [3, 700, 701], [20, 30, 1999]] {
        let [a, b, c] = cuts;
        for order in [[3, 1, 2, 0], [2, 0, 3, 1], [1, 0, 3, 2]] {
            let parts = [&rows[..a], &rows[a..b], &rows[b..c], &rows[c..]];
            let moved = order.map(|at| parts[at]).concat();
            assert_eq!(found(&moved), None, "{cuts:?} {order:?}");
        }
    }
    let other: Vec<(f64, u64)> = rows.iter().map(|(t, value)| (0.9 * t + 0.3, value + 5000)).collect();
    assert!(found(&[rows, other].concat()).is_some());
}

#[test]
fn runs_of_many_channels_become_one_whatever_their_order() {
    let (channels, blocks) = (1000_u32, 365_u32);
    let mut runs = Runs::new(channels as usize, false);
    for block in (0..blocks).rev() {
        for channel in 0..channels {
            for at in 0..5 {
                let t = 86_400.0 * f64::from(block) + 60.0 * f64::from(at);
                assert!(runs.add(channel as usize, t), "block {block} of channel {channel}");
            }
        }
    }
    assert!(runs.overlaps().is_empty());
    // Runs that all lie within each other cannot be made fewer: they end at once.
    let mut runs = Runs::new(1, false);
    let mut times = (0..).flat_map(|run| (0..5).map(move |at| f64::from(at) - 1e-6 * f64::from(run)));
    assert!(times.by_ref().take(10 * MOST_RUNS).any(|t| !runs.add(0, t)));
}

#[test]
fn a_clock_that_was_set_right_twice_is_small_and_many_times_is_not() {
    let set_back = |times: usize| -> Vec<(f64, u64)> {
        let t = |at: usize| at as f64 - 10.5 * (at * (times + 1) / 8000) as f64;
        (0..8000).map(|at| (t(at), at as u64)).collect()
    };
    assert!([1, 2, 3].iter().all(|times| found(&set_back(*times)).is_none()));
    assert!(found(&set_back(30)).is_some());
}

#[test]
fn times_keep_their_order_as_numbers() {
    let times = [f64::NEG_INFINITY, -2.5, -0.5, 0.0, 0.5, 2.5, f64::INFINITY];
    assert!(times.windows(2).all(|pair| ordered(pair[0]) < ordered(pair[1])));
}
