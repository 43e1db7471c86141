//! Units, signs, offsets and clocks change no verdict, and f only by rounding.

#[path = "common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "common/measured.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod measured;
#[path = "common/units.rs"]
mod units;

use generators::{Case, GENERATORS, Size};
use measured::FOLDER;
use proptest::prelude::*;
use std::path::Path;
use std::sync::OnceLock;
use stictiond_numerics::signal::{Record, SpanSource};
use units::{CHANGES, Change, Line, SAME, Said, judge, off};

/// Sticking, sound and silent records, in per cent and in units of their own.
const SAMPLE: [&str; 5] = [
    "isdb/CHEM23.csv",
    "isdb/PAP2.csv",
    "isdb/PAP7.csv",
    "plant/N_2111PIC10201_0903_0006.csv",
    "more/rig_noRTO_pump.csv",
];
/// Of these so many are traced, and so many changes of each.
const TRACED: (usize, usize) = (2, 3);
/// f is the same to this share: values that lie between two grains of a normalised signal may be rounded to the other.
const SAME_F: f64 = 1e-3;

/// What is said of a record, and of the same elsewhere.
fn holds(name: &str, record: &Record, own: &Said, change: &Change, traced: bool) {
    let said = judge(&change.of(record, true), traced);
    assert_eq!(said.verdict, own.verdict, "{name}, {}: {} / {}", change.name, own.reason, said.reason);
    let off = off(change, own, &said).expect("both have f, or none has");
    assert!(off < SAME_F, "{name}, {}: {} / {}", change.name, own.reason, said.reason);
    if let (Some(own), Some(said)) = (own.percent, said.percent) {
        assert!((own - said).abs() <= SAME_F * own, "{name}, {}: {own} % / {said} %", change.name);
    }
}

#[test]
fn measured_loops_are_told_the_same_whatever_they_are_written_in() {
    let records = measured::below(Path::new(FOLDER));
    if records.is_empty() {
        eprintln!("SKIPPED: no measured records, {FOLDER} is missing");
        return;
    }
    let mut sticking = 0;
    for (at, wanted) in SAMPLE.iter().enumerate() {
        let (name, record) =
            records.iter().find(|(name, _)| name == wanted).expect("the index is the known one");
        let own = judge(record, false);
        sticking += usize::from(own.verdict == "stiction");
        CHANGES.iter().for_each(|change| holds(name, record, &own, change, false));
        if at < TRACED.0 {
            let own = judge(record, true);
            let some = CHANGES.iter().step_by(CHANGES.len() / TRACED.1);
            some.for_each(|change| holds(name, record, &own, change, true));
        }
    }
    assert!(sticking > 0, "a sample without stiction shows nothing");
}

/// A sticking and a sound loop of each generator, and what is said of them.
fn drawn() -> &'static [(String, Record, Said)] {
    static DRAWN: OnceLock<Vec<(String, Record, Said)>> = OnceLock::new();
    DRAWN.get_or_init(|| {
        let one = |(generator, variant): (&generators::Generator, usize)| {
            let case = Case { effect: None, size: Size::Medium, variant, seed: 11, tags: 0 };
            let (record, truth) = (generator.record)(&case);
            let record = Record { op_span: Some(100.0), op_span_source: SpanSource::Given, ..record };
            let own = judge(&record, false);
            (format!("{} {}", generator.name, truth.name), record, own)
        };
        GENERATORS.iter().flat_map(|generator| [0, 1].map(|variant| (generator, variant))).map(one).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Factors of six decades, both signs, shifts of up to a hundred spreads.
    #[test]
    fn drawn_loops_are_told_the_same_in_any_unit(
        at in 0usize..6,
        decades in prop::array::uniform3(-3.0f64..3.0),
        turned in prop::array::uniform2(any::<bool>()),
        shifts in prop::array::uniform2(-100.0f64..100.0),
    ) {
        let (name, record, own) = &drawn()[at];
        let sign = |turned: bool| if turned { -1.0 } else { 1.0 };
        let scale: [f64; 3] = std::array::from_fn(|i| 10f64.powf(decades[i]));
        let change = Change {
            name: "drawn",
            op: Line { scale: sign(turned[0]) * scale[0], shift: shifts[0] * scale[0] },
            pv: Line { scale: sign(turned[1]) * scale[1], shift: shifts[1] * scale[1] },
            time: Line { scale: scale[2], ..SAME },
        };
        holds(name, record, own, &change, false);
    }
}

#[test]
fn where_the_span_is_not_known_the_threshold_is_of_what_op_covered() {
    let (_, record, own) = drawn().iter().find(|(.., own)| own.verdict == "stiction").expect("one sticks");
    // Negated it is no signal that anybody knows.
    let change = CHANGES.iter().find(|change| change.name == "OP negated").expect("it is there");
    let elsewhere = change.of(record, false);
    assert_eq!((elsewhere.known_span(), elsewhere.op_span_source), (None, SpanSource::Unknown));
    let said = judge(&elsewhere, false);
    assert_eq!((said.verdict.as_str(), said.percent), ("stiction", None));
    assert!(off(change, own, &said).is_some_and(|off| off < SAME_F), "{} / {}", own.reason, said.reason);
}
