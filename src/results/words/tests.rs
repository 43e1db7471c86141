use super::*;
use crate::diagnosis::{HistoryKind, NotIdentifiable};
use crate::residual::{Kind, Test};
use crate::signal::Role;
use std::fmt::Write;

fn verdict(outcome: &'static str, f: Option<f64>, f_high: Option<f64>) -> Verdict<'static> {
    let (reason, unit) = ("PV is missing", "% OP");
    Verdict { outcome, reason_code: None, reason, f, f_high, unit, compensated: None }
}

/// Why nothing can be said, all of it.
fn reasons() -> [NotIdentifiable; 21] {
    [
        NotIdentifiable::NoTimeBase,
        NotIdentifiable::FlatOp,
        NotIdentifiable::FlatPv,
        NotIdentifiable::NoResponse,
        NotIdentifiable::StemNotFollowed,
        NotIdentifiable::OutOfScale,
        NotIdentifiable::Compensated,
        NotIdentifiable::DeadlineExceeded,
        NotIdentifiable::TooShort { n: 0, need: 1 },
        NotIdentifiable::Gaps { share: 1.0 },
        NotIdentifiable::Silent { tag: Role::Pv, since: 0.0 },
        NotIdentifiable::ReadApart { share: 1.0 },
        NotIdentifiable::Compressed { kind: HistoryKind::Interpolated, share: 0.9 },
        NotIdentifiable::TsTooShort { ts: 0.5, samples_s: 1.0 },
        NotIdentifiable::Saturated { share: 1.0 },
        NotIdentifiable::Manual { share_auto: 0.0 },
        NotIdentifiable::ModeUnknown { share: 1.0 },
        NotIdentifiable::NotExcited { reversals: 0 },
        NotIdentifiable::HiddenFriction {
            reversal: "3.1 % OP".into(),
            friction: Some("3.1 % OP".into()),
            excluded: None,
            unrecorded: false,
        },
        NotIdentifiable::Undecided {
            evidence: [17.0, 20.0],
            contradicted: false,
            most: "3.7 % OP".into(),
            unrecorded: false,
        },
        NotIdentifiable::Undersampled { samples: 2.2, poll_s: Some(39.0), mean_s: None },
    ]
}

/// Every sentence, one a line.
fn all() -> String {
    let mut out = "Verdicts\n".to_string();
    let mut line = |text: &str| writeln!(out, "{text}").expect("a String takes it");
    for (outcome, f, high) in [
        ("stiction", Some(2.45), Some(2.55)),
        ("stiction", None, None),
        ("no_stiction", Some(0.0), Some(0.42)),
        ("no_stiction", Some(0.0), Some(0.0)),
        ("not_identifiable", None, None),
        ("deadline_exceeded", None, None),
        ("panicked", None, None),
    ] {
        line(&verdict(outcome, f, high).words());
    }
    for reason in reasons() {
        let told = Verdict { reason_code: Some(reason.code()), ..verdict("not_identifiable", None, None) };
        line(&told.words());
    }
    let hidden = NotIdentifiable::HiddenFriction {
        reversal: "3.1 % OP".into(),
        friction: Some("3.1 % OP".into()),
        excluded: None,
        unrecorded: true,
    };
    let (reason, reason_code) = (hidden.to_string(), Some(hidden.code()));
    line(&Verdict { reason: &reason, reason_code, ..verdict("not_identifiable", None, None) }.words());
    line("\nWhile a term of write-back acts");
    for (outcome, f, seen) in [
        ("stiction", Some(2.44), Seen::Consistent),
        ("stiction", Some(3.4), Seen::Changed),
        ("not_identifiable", None, Seen::Hidden),
    ] {
        for f_before in [Some(2.5), None] {
            let compensated = Some(Compensated { f_before, seen });
            let reason_code = (outcome != "stiction").then_some("compensated");
            line(&Verdict { reason_code, compensated, ..verdict(outcome, f, f) }.words());
        }
    }
    line("\nOther alarms");
    line(&rising(0.6, 0.31, 12.4 * 86_400.0, "% OP"));
    line(&rising(0.6, 0.31, 9.2 * 3600.0, "% OP"));
    line(&rising(-0.8, -0.9, 12.4 * 86_400.0, "% OP"));
    line(&unexplained(0.843));
    line(&unexplained(1.3));
    line(&swings_with("FIC102"));
    line(&tripped(Some(Denial::NotAutomatic), Cause::AtZero));
    line(&tripped(Some(Denial::ReadBack), Cause::NotAtZero));
    line(&tripped(Some(Denial::NotAtZero), Cause::NotAtZero));
    line("\nA verdict that other methods contradict");
    for sticks in [true, false] {
        line(&doubtful(sticks, Doubt::Stem));
        line(&doubtful(sticks, Doubt::Methods { against: 7, of: 8 }));
        line(&doubtful(sticks, Doubt::Methods { against: 5, of: 5 }));
    }
    line("\nEffects, when they are as good as sure");
    for (kind, place, effect) in EFFECTS {
        let Said { title, meaning, advice } = effect.said(Some(0.999));
        line(&format!("{kind}{}", place.map_or(String::new(), |place| format!(" ({place})"))));
        line(&format!("  {title}: {meaning}\n  {advice}"));
    }
    line("\nOne effect, by how sure it is");
    let stop = effect("valve_saturation", None).expect("it has words");
    for posterior in [0.99, 0.989, 0.9, 0.899, 0.75, 0.749, 0.5, 0.499] {
        let Said { meaning, advice, .. } = stop.said(Some(posterior));
        line(&format!("{posterior}: {meaning} {advice}"));
    }
    let Said { meaning, advice, .. } = stop.said(None);
    line(&format!("not known: {meaning} {advice}"));
    line("\nBetween which kinds a record lies");
    for kind in Kind::ALL {
        let said = between(&[(kind.as_str(), 0.48), ("none", 0.41)], false).expect("none has more than half");
        line(&sentence(&said));
    }
    for told in [
        &[("gain_change", 0.48), ("load_step", 0.41)][..],
        &[("gain_change", 0.41), ("none", 0.3), ("load_step", 0.2)],
        &[("gain_change", 0.41), ("drift", 0.3), ("load_step", 0.2)],
        &[("gain_change", 0.48)],
    ] {
        for named in [false, true] {
            line(&sentence(&between(told, named).expect("none has more than half")));
        }
    }
    line("\nThe rest");
    for times in [None, Some(1.05), Some(2.0), Some(2.001), Some(450.4)] {
        line(&simulates_worse(times));
    }
    for test in [
        Test::Whiteness,
        Test::Input,
        Test::Tags,
        Test::Line,
        Test::ChangePoint,
        Test::Drift,
        Test::Direction,
    ] {
        line(&format!("Still to be seen: {}", failed_test(test.as_str())));
    }
    for test in [Test::Travel, Test::Variance, Test::Tails] {
        line(&format!("Still to be seen: {}", failed_test(test.as_str())));
    }
    out
}

#[test]
fn every_sentence_is_the_one_that_was_read_over() {
    let (said, file) = (all(), concat!(env!("CARGO_MANIFEST_DIR"), "/tests/words.txt"));
    let read = std::fs::read_to_string(file).expect("it is there");
    if said != read {
        let to = std::env::temp_dir().join("words.txt");
        std::fs::write(&to, &said).expect("a temporary file can be written");
        let differs = said.lines().zip(read.lines()).find(|(said, read)| said != read);
        panic!("read {} over, and put it in the place of tests/words.txt; {differs:?}", to.display());
    }
}

#[test]
fn everything_that_can_be_found_has_words() {
    for kind in Kind::ALL {
        assert!(effect(kind.as_str(), None).is_some(), "{kind}");
    }
    let [valve, process] =
        ["valve", "process"].map(|place| effect(Kind::StaticNonlinearity.as_str(), Some(place)));
    assert!(valve.is_some() && process.is_some() && valve != process);
    for reason in reasons() {
        assert!(not_identifiable(reason.code()).is_some(), "{}", reason.code());
    }
    assert_eq!((effect("new_kind", None), failed_test("new_test").as_str()), (None, "new test"));
}

#[test]
fn a_source_that_is_silent_is_said_with_the_tag_and_since_when() {
    let why = NotIdentifiable::Silent { tag: Role::Op, since: 1_767_225_600.0 };
    let reason = why.to_string();
    let bare = verdict("not_identifiable", None, None);
    let told = Verdict { reason: &reason, reason_code: Some(why.code()), ..bare };
    assert_eq!(
        told.words(),
        "Nothing can be said about the valve: no good sample of OP since 2026-01-01 00:00:00 UTC. Check the connection, and whether the source repeats one value."
    );
    // Of any other reason that begins so the words are the ones of its code.
    let other = Verdict { reason_code: Some("gaps"), ..told };
    assert!(other.words().contains("too much of the data is missing"), "{}", other.words());
}

#[test]
fn advice_that_costs_is_given_only_where_the_effect_is_sure_enough() {
    for (kind, place, effect) in EFFECTS {
        let costly = effect.costly.unwrap_or("Have");
        for posterior in [None, Some(0.0), Some(0.5), Some(COSTLY_FROM - 1e-9), Some(f64::NAN)] {
            let advice = effect.said(posterior).advice;
            assert!(!advice.contains(costly) && advice == effect.look, "{kind} {place:?}: {advice}");
        }
        let advice = effect.said(Some(COSTLY_FROM)).advice;
        assert_eq!(effect.costly.is_some(), advice.contains(costly), "{kind} {place:?}: {advice}");
        for word in ["sizing", "calibrat", "packing", "actuator checked", "shutdown", "Have "] {
            assert!(!effect.look.contains(word), "{kind}: {word} costs money");
        }
    }
}

#[test]
fn sentences_are_short_and_whole() {
    for (kind, _, effect) in EFFECTS {
        let Said { title, meaning, advice } = effect.said(Some(0.8));
        for text in [&title, &meaning, &advice] {
            assert!(text.starts_with(char::is_uppercase), "{kind}: {text}");
            assert!(!text.contains("..") && !text.contains("  "), "{kind}: {text}");
        }
        assert!(meaning.split_whitespace().count() <= 22, "{kind}: {meaning}");
        assert!(
            meaning.matches(". ").count() == 0 && advice.ends_with('.'),
            "{kind}: one sentence an effect"
        );
    }
}

#[test]
fn a_record_lies_between_kinds_where_none_has_more_than_half() {
    let said = |candidates: &[(&str, f64)]| between(candidates, false).unwrap_or_default();
    let two = [("gain_change", 0.48), ("load_step", 0.41), ("drift", 0.04)];
    assert_eq!(said(&two), "the record cannot tell a gain change (48 %) from a load step (41 %)");
    let three = [("gain_change", 0.4), ("none", 0.35), ("load_step", 0.2)];
    assert_eq!(
        said(&three),
        "the record cannot tell a gain change (40 %), a load step (20 %) and none of them (35 %) apart"
    );
    let twice = [("load_step", 0.3), ("none", 0.35), ("load_step", 0.2)];
    assert_eq!(said(&twice), "the record cannot tell a load step (50 %) from none (35 %)");
    assert_eq!(said(&[("new_kind", 0.5)]), "the record may show new kind (50 %)");
    for none in [
        &[][..],
        &[("none", 0.51), ("drift", 0.49)],
        &[("drift", 0.6), ("none", 0.4)],
        &[("drift", 0.01)],
        &[("drift", 0.01), ("none", 0.45)],
    ] {
        assert_eq!(said(none), "", "{none:?}");
    }
}

#[test]
fn a_record_that_a_term_acted_on_is_not_said_to_show_no_sticking() {
    for (f_before, said) in [
        (
            Some(2.5),
            "Before compensation the valve ignored the first 5 % OP of each reversal. That is no longer visible.",
        ),
        (None, "Whether the valve sticks is not visible."),
    ] {
        let compensated = Some(Compensated { f_before, seen: Seen::Hidden });
        let told = Verdict { compensated, ..verdict("no_stiction", Some(0.0), Some(0.42)) };
        assert_eq!(told.words(), format!("Write-back moved the valve in this record. {said}"));
    }
}

#[test]
fn friction_is_said_to_rise_only_where_it_does() {
    let said = |least: f64, span_s: f64| rising(0.6, least, span_s, "% OP");
    for (span_s, over) in [
        (2.0 * 86_400.0, "2 days"),
        (47.9 * 3600.0, "48 h"),
        (7200.0, "2 h"),
        (1800.0, "30 min"),
        (6.0, "1 min"),
    ] {
        let text = said(0.31, span_s);
        assert!(text.starts_with(&format!("Friction rises: over the last {over} the valve")), "{text}");
    }
    for least in [0.0, -0.5] {
        assert_eq!(said(least, 86_400.0), "Friction does not rise beyond its noise.");
    }
}

#[test]
fn a_share_of_a_deviation_is_told_up_to_the_whole() {
    let said = [0.994, 0.995, 1.3].map(unexplained);
    let none = "PV's movement is not explained.";
    assert_eq!(said, ["99 % of PV's standard deviation is not explained.", none, none]);
}

#[test]
fn numbers_are_short() {
    let said = [2.4449, 0.049_96, 73.61, 1234.5, 0.0, f64::NAN].map(short);
    assert_eq!(said, ["2.44", "0.0500", "73.6", "1234", "0", "–"]);
    let said = [0.0, 0.01, 0.486, 0.99, 0.991, 1.0].map(percent);
    assert_eq!(said, ["< 1 %", "1 %", "49 %", "99 %", "> 99 %", "> 99 %"]);
    assert_eq!([4.9, 5.0, 0.84, 100.0, 0.0].map(shortest), ["4.9", "5", "0.84", "100", "0"]);
    // What is no number is no band either.
    for f in [f64::NAN, f64::INFINITY] {
        assert_eq!(verdict("stiction", Some(f), None).words(), "The valve sticks.");
    }
}
