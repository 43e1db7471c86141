//! The generators of simulated loops: the same case gives the same record, and what a case asks for is in it.

#[path = "common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;

/// A loop as it was before its effect or its friction.
mod before {
    use stictiond_numerics::residual::Kind;

    use super::generators::{Case, GENERATORS, Generator, Size};

    /// Every variant of every generator.
    fn each(effect: Option<Kind>, check: impl Fn(&Generator, &Case)) {
        for generator in &GENERATORS {
            for variant in 0..(generator.variants)(effect) {
                check(generator, &Case { effect, size: Size::Medium, variant, seed: 7, tags: 2 });
            }
        }
    }

    #[test]
    fn it_is_the_same_loop_where_nothing_is_left_out() {
        each(None, |generator, case| {
            assert_eq!((generator.before)(case, 1.0), (generator.record)(case).0, "{case:?}");
        });
    }

    #[test]
    fn it_is_another_without_its_friction() {
        each(None, |generator, case| {
            let (record, truth) = (generator.record)(case);
            let sound = (generator.before)(case, 0.0);
            assert_eq!(sound.pv != record.pv, truth.f > 0.0, "{} {case:?}", generator.name);
            assert_eq!(sound.op.len(), record.op.len(), "{} {case:?}", generator.name);
        });
    }

    #[test]
    fn it_is_the_same_until_the_effect_sets_in() {
        each(Some(Kind::GainChange), |generator, case| {
            let (record, before) = ((generator.record)(case).0, (generator.before)(case, 1.0));
            // No gain changes in the first seventh of a record.
            let (n, early) = (record.pv.len(), record.pv.len() / 7);
            assert_eq!(before.pv[..early], record.pv[..early], "{} {case:?}", generator.name);
            assert_ne!(before.pv[n - early..], record.pv[n - early..], "{} {case:?}", generator.name);
        });
    }
}

/// Generator B.
mod b {
    use stictiond_numerics::residual::Kind;
    use stictiond_numerics::signal::Series;

    use super::generators::b::B;
    use super::generators::b::valve::{Friction, Model, Valve};
    use super::generators::{Case, Size};

    /// Step of OP on the slow triangle (% of span).
    const SLOW: f64 = 0.002;

    /// Every effect and none, at every size, in its first variants.
    fn cases() -> impl Iterator<Item = Case> {
        let effects = std::iter::once(None).chain(Kind::ALL.map(Some));
        effects.flat_map(|effect| {
            let sizes = [Size::Small, Size::Medium, Size::Large];
            sizes.into_iter().flat_map(move |size| {
                (0..(B.variants)(effect)).map(move |variant| Case { effect, size, variant, seed: 7, tags: 3 })
            })
        })
    }

    /// OP's way and the stem's slip from the first motion after a turn right behind a slip, for each way.
    fn driven(friction: Friction) -> [(f64, f64); 2] {
        let mut valve = Valve::new(Some(friction), (0.0, 100.0), 50.0);
        let (mut op, mut stem, mut way, mut turned) = (50.0, 50.0, 1.0, 50.0);
        let mut seen = [(0.0, 0.0); 2];
        for _ in 0..6 {
            loop {
                op += way * SLOW;
                let next = valve.step(op, 1.0);
                let slip: f64 = (next - stem).abs();
                stem = next;
                if slip > 0.0 {
                    seen[usize::from(way < 0.0)] = ((op - turned).abs(), slip);
                    break;
                }
            }
            (turned, way) = (op, -way);
        }
        seen
    }

    #[test]
    fn slow_triangles_find_s_and_j_of_every_model() {
        for model in [Model::Kano, Model::Stenman, Model::He, Model::Karnopp] {
            for (s, share, ratio) in [(1.0, 1.0, 1.0), (4.0, 0.5, 1.0), (6.0, 0.0, 1.0), (3.0, 0.8, 2.0)] {
                let share = if model == Model::Stenman { 1.0 } else { share };
                let friction = Friction { model, s, j: share * s, ratio };
                for (way, (band, slip)) in [1.0, -1.0].into_iter().zip(driven(friction)) {
                    assert!((band - friction.band(way)).abs() < 3.0 * SLOW, "{friction:?}: S {band}");
                    assert!((slip - friction.slip(way)).abs() < 3.0 * SLOW, "{friction:?}: J {slip}");
                }
                assert!((friction.band(1.0) + friction.band(-1.0) - 2.0 * s).abs() < 1e-9);
                assert!((friction.band(1.0) / friction.band(-1.0) - ratio).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn the_same_case_gives_the_same_record_and_others_differ() {
        let case = Case { effect: None, size: Size::Medium, variant: 4, seed: 3, tags: 2 };
        assert_eq!((B.record)(&case), (B.record)(&case));
        assert_ne!((B.record)(&case).0, (B.record)(&Case { seed: 4, ..case }).0);
    }

    #[test]
    fn every_record_is_finite_long_enough_and_moves() {
        for case in cases() {
            let (record, truth) = (B.record)(&case);
            assert!((1000..=2000).contains(&record.op.len()), "{case:?}");
            let upstream = usize::from(case.effect == Some(Kind::MeasuredDisturbance));
            assert_eq!(record.tags.len(), case.tags + upstream, "{case:?}");
            let all = [&record.op, &record.pv]
                .into_iter()
                .chain(&record.sp)
                .chain(record.tags.iter().map(|t| &t.1));
            assert!(all.flatten().all(|s| s.t.is_finite() && s.value.is_finite()), "{case:?}");
            let (low, high) = ends(&record.op);
            assert!(low > 1.0 && high < 99.0 && high - low > 0.3, "{case:?}: OP {low} to {high}");
            assert!(truth.f >= 0.0 && truth.j <= 2.0 * truth.f + 1e-9, "{case:?}: {truth:?}");
        }
    }

    #[test]
    fn stamps_are_equal_and_those_of_pv_differ_under_a_skewed_clock_alone() {
        for case in cases().filter(|case| case.variant == 3) {
            let (record, _) = (B.record)(&case);
            let stamps = |series: &Series| series.iter().map(|s| s.t).collect::<Vec<f64>>();
            let (op, pv) = (stamps(&record.op), stamps(&record.pv));
            let period = op[1] - op[0];
            assert!(op.iter().enumerate().all(|(k, t)| *t == k as f64 * period), "{case:?}");
            assert!(op == pv || case.effect == Some(Kind::ClockSkew), "{case:?}");
        }
        assert_eq!(B.name, "B");
    }

    #[test]
    fn friction_follows_from_the_variant() {
        for case in cases() {
            let (s, effect) = ((B.record)(&case).1.f * 2.0, case.effect);
            let strength = case.variant / 5;
            match effect {
                Some(Kind::AsymmetricFriction | Kind::FrictionDrift) if strength == 0 => assert!(s < 1.7),
                Some(Kind::AsymmetricFriction | Kind::FrictionDrift) => assert!(s > 2.4),
                Some(Kind::SlipJump) => assert!(s > 0.5),
                _ => assert_eq!(s > 0.0, strength > 0, "{case:?}"),
            }
        }
    }

    /// Smallest and largest value.
    fn ends(series: &Series) -> (f64, f64) {
        series.iter().fold((f64::MAX, f64::MIN), |(low, high), s| (low.min(s.value), high.max(s.value)))
    }
}

mod c {
    use stictiond_numerics::residual::Kind;
    use stictiond_numerics::signal::Series;

    use super::generators::c::C;
    use super::generators::c::valve::{Force, Model, Stem, Valve};
    use super::generators::{Case, Size};

    fn values(series: &Series) -> Vec<f64> {
        series.iter().map(|sample| sample.value).collect()
    }

    /// A few cases of every effect, over all loop classes and valves.
    fn cases() -> Vec<Case> {
        let effects = std::iter::once(None).chain(Kind::ALL.into_iter().map(Some));
        let sizes = [Size::Small, Size::Medium, Size::Large];
        effects
            .enumerate()
            .flat_map(|(i, effect)| {
                let count = (C.variants)(effect);
                (0..5).map(move |k| {
                    let variant = (5 * i + k * (count / 5)) % count;
                    Case { effect, size: sizes[(i + k) % 3], variant, seed: 7 + i as u64, tags: k }
                })
            })
            .collect()
    }

    #[test]
    fn the_same_case_gives_the_same_record() {
        let case = Case { effect: Some(Kind::Drift), size: Size::Medium, variant: 4, seed: 3, tags: 9 };
        let (first, truth) = (C.record)(&case);
        assert_eq!((C.record)(&case), (first.clone(), truth));
        assert_ne!((C.record)(&Case { seed: 4, ..case }).0.op, first.op);
        assert_eq!(C.name, "C");
    }

    #[test]
    fn every_record_is_whole_and_in_range() {
        for case in cases() {
            let (record, truth) = (C.record)(&case);
            let (op, pv) = (values(&record.op), values(&record.pv));
            let sp = record.sp.as_ref().map(values).unwrap();
            assert!((1000..=2000).contains(&op.len()), "{case:?}");
            assert!(pv.len() == op.len() && sp.len() == op.len(), "{case:?}");
            let driver = usize::from(case.effect == Some(Kind::MeasuredDisturbance));
            assert_eq!(record.tags.len(), case.tags + driver, "{case:?}");
            let tags = record.tags.iter().flat_map(|(_, tag)| values(tag));
            assert!(pv.iter().chain(&sp).copied().chain(tags).all(f64::is_finite), "{case:?}");
            assert!(op.iter().all(|op| (1.0..=99.0).contains(op)), "{case:?}");
            let high = op.iter().copied().fold(f64::MIN, f64::max);
            let low = op.iter().copied().fold(f64::MAX, f64::min);
            // A stem that sticks turns only after OP has crossed the band.
            let least = if truth.f > 0.0 { 0.8 * truth.f } else { 0.02 };
            assert!(high - low > least, "{case:?}: OP moves by {} at f = {}", high - low, truth.f);
        }
    }

    #[test]
    fn truth_says_what_the_valve_does() {
        for case in cases() {
            let (_, truth) = (C.record)(&case);
            let (s, slips) = (2.0 * truth.f, truth.also.contains(&Kind::SlipJump));
            assert!(truth.j <= s, "{case:?}");
            if case.effect == Some(Kind::SlipJump) {
                assert!(s > 0.5 && truth.j <= 0.6 * s && !slips, "{case:?}");
            } else {
                assert_eq!(slips, s > 0.0 && truth.j < 0.9 * s, "{case:?}");
            }
        }
    }

    #[test]
    fn band_and_jump_are_what_the_forces_say() {
        let valves = [
            (4.0, 0.0, 0.0),
            (1.0, 0.4, 0.0),
            (6.0, 3.0, 0.0),
            (3.0, 2.85, 0.0),
            (3.0, 1.5, 0.8),
            (6.0, 5.7, 2.0),
        ];
        for model in [Model::Karnopp, Model::Lugre] {
            for (s, j, positioner) in valves {
                for (period, small) in [(1.0, true), (20.0, false)] {
                    let force = Force::from_band(s, j);
                    // Stem (share of the period), damping, air (s): the ends of what is drawn.
                    let (share, damping, air) = match (positioner > 0.0, small) {
                        (false, true) => (0.015, 0.9, 0.1),
                        (false, false) => (0.03, 1.6, 0.8),
                        (true, true) => (0.025, 2.2, 0.025 * 0.05 * period),
                        (true, false) => (0.035, 2.6, 0.035 * 0.05 * period),
                    };
                    let stem = share * period;
                    let (opening, closing, stops) = (force, force, (0.0, 100.0));
                    let valve = Valve { model, opening, closing, stem, damping, air, positioner, stops };
                    let (band, jump) = measure(&valve, period, s, j);
                    let name = format!("{model:?} S {s} J {j}, {period} s: {band:.3}, {jump:.3}");
                    assert!((band - s).abs() < 0.05 * s, "{name}");
                    assert!((jump - j).abs() < (0.05 * j).max(0.02 * s), "{name}");
                }
            }
        }
    }

    /// Band and jump of a valve by slow triangles that turn right after a slip, as means over the turns.
    fn measure(valve: &Valve, period: f64, s: f64, j: f64) -> (f64, f64) {
        let mut stem = Stem::new(valve, 50.0);
        let mut u = 50.0;
        // One scan of OP's slow ramp: how far the stem moves.
        let mut creep = |u: &mut f64, way: f64| {
            *u += way * 0.004 * s;
            let before = stem.x;
            (0..20).for_each(|_| stem.step(*u, period / 20.0));
            (stem.x - before).abs()
        };
        let plain = if j > 0.0 { 0.4 * j } else { 0.002 * s };
        let (mut bands, mut jumps) = (Vec::new(), Vec::new());
        for turn in 0..6 {
            let way = if turn % 2 == 0 { 1.0 } else { -1.0 };
            let turned = u;
            let (mut before, mut moved) = (0.0, 0.0);
            while moved < plain {
                (before, moved) = (moved, creep(&mut u, way));
            }
            bands.push((u - turned).abs());
            // A slip may begin in one scan and end in the next.
            jumps.push(before + moved + creep(&mut u, way));
            // On, to a later slip.
            let first = u;
            while (u - first).abs() < s || creep(&mut u, way) < plain {
                if (u - first).abs() < s {
                    creep(&mut u, way);
                }
            }
        }
        // The first turn starts from a valve without tension.
        let mean = |v: &[f64]| v[1..].iter().sum::<f64>() / (v.len() - 1) as f64;
        (mean(&bands), mean(&jumps))
    }
}
