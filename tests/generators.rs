//! The generators of simulated loops: the same case gives the same record, and what a case asks for is in it.

#[path = "generators/mod.rs"]
mod generators;

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
