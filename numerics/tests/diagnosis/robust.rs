//! Any record at all gets a diagnosis made of numbers: no panic, no NaN, no infinity in any field.

use proptest::prelude::*;
use stictiond_numerics::diagnosis::{Settings, diagnose};
use stictiond_numerics::signal::{BadReason, Quality, Record, Sample, Series};

/// One stretch of values.
#[derive(Clone, Debug)]
enum Piece {
    Constant(f64, usize),
    Wave(f64, f64, usize),
    Noise(Vec<f64>),
    Odd(Vec<f64>),
}

fn odd() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(1e308),
        Just(-1e308),
        Just(1e30),
        Just(5e-324),
        Just(0.0),
        any::<f64>(),
    ]
}

fn piece() -> impl Strategy<Value = Piece> {
    prop_oneof![
        2 => (-100.0..100.0f64, 0usize..120).prop_map(|(v, n)| Piece::Constant(v, n)),
        6 => (1e-3..50.0f64, 4.0..80.0f64, 50usize..300).prop_map(|(a, p, n)| Piece::Wave(a, p, n)),
        2 => prop::collection::vec(-5.0..5.0f64, 0..200).prop_map(Piece::Noise),
        1 => prop::collection::vec(odd(), 0..6).prop_map(Piece::Odd),
    ]
}

fn values() -> impl Strategy<Value = Vec<f64>> {
    let scale = prop_oneof![8 => Just(1.0), 1 => Just(1e-150), 1 => Just(1e25)];
    (prop::collection::vec(piece(), 0..6), scale).prop_map(|(pieces, scale)| {
        let mut all = Vec::new();
        for piece in pieces {
            match piece {
                Piece::Constant(v, n) => all.extend(std::iter::repeat_n(v, n)),
                Piece::Wave(a, p, n) => {
                    all.extend(
                        (0..n).map(|k| {
                            a * (std::f64::consts::TAU * k as f64 / p).sin() + 0.01 * (k % 7) as f64
                        }),
                    );
                }
                Piece::Noise(v) | Piece::Odd(v) => all.extend(v),
            }
        }
        all.truncate(600);
        all.iter().map(|v| v * scale).collect()
    })
}

/// Stamps of sample k: regular for the most part, or jittered, repeated, backwards, no numbers, far away.
fn stamps() -> impl Strategy<Value = Vec<f64>> {
    let regular = (0.1..100.0f64).prop_map(|ts| (0..600).map(|k| k as f64 * ts).collect::<Vec<f64>>());
    let jittered = prop::collection::vec(-0.4..0.4f64, 600)
        .prop_map(|j| j.iter().enumerate().map(|(k, j)| k as f64 + j).collect::<Vec<f64>>());
    let wild = prop::collection::vec(prop_oneof![5 => 0.0..1e4f64, 1 => odd()], 600);
    let mixed =
        (0.1..100.0f64, prop::collection::vec((0usize..600, odd()), 0..5)).prop_map(|(ts, changed)| {
            let mut t: Vec<f64> = (0..600).map(|k| k as f64 * ts).collect();
            for (at, value) in changed {
                t[at] = value;
            }
            t
        });
    prop_oneof![5 => regular, 2 => jittered, 1 => wild, 2 => mixed]
}

fn series(values: &[f64], stamps: &[f64], marked: &[usize]) -> Series {
    let mut series: Series = values.iter().zip(stamps).map(|(&v, &t)| Sample::good(t, v)).collect();
    for (i, &at) in marked.iter().enumerate() {
        if let Some(sample) = series.get_mut(at) {
            sample.quality = if i % 2 == 0 { Quality::Stale } else { Quality::Bad(BadReason::Timeout) };
        }
    }
    series
}

fn record() -> impl Strategy<Value = Record> {
    let marked = prop::collection::vec(0usize..600, 0..40);
    let pv = prop_oneof![2 => values().prop_map(Some), 3 => Just(None)];
    let mode = prop::option::of(prop::collection::vec(0.0..1.5f64, 0..20));
    let span = prop::option::of(prop_oneof![Just(100.0), odd()]);
    let limits = prop::option::of((odd(), odd()));
    (values(), pv, stamps(), stamps(), any::<bool>(), marked, mode, span, limits).prop_map(
        |(op, pv, t, other, same, marked, mode, op_span, op_limits)| {
            // Without a PV of its own the process answers OP, so that the whole way is walked.
            let pv = pv.unwrap_or_else(|| {
                let mut y = 0.0;
                let answer = |u: &f64| {
                    y = 0.8 * y + 0.2 * u;
                    y
                };
                op.iter().map(answer).collect()
            });
            let pv_stamps = if same { &t } else { &other };
            Record {
                op: series(&op, &t, &[]),
                pv: series(&pv, pv_stamps, &marked),
                mode: mode
                    .map(|m| m.iter().enumerate().map(|(k, &m)| Sample::good(30.0 * k as f64, m)).collect()),
                op_span,
                op_limits,
                ..Record::default()
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn every_field_is_a_number(record in record(), ts in prop::option::of(odd())) {
        let settings = Settings { ts, ..Settings::default() };
        let diagnosis = diagnose(&record, &settings);
        // Debug writes every field there is, the new ones too.
        let text = format!("{diagnosis:?}");
        let wrong = text.split(|c: char| !c.is_alphanumeric()).find(|word| ["NaN", "inf"].contains(word));
        prop_assert!(wrong.is_none(), "{:?}: {}", diagnosis.verdict, diagnosis.reason);
        prop_assert!(!diagnosis.reason.is_empty());
    }
}
