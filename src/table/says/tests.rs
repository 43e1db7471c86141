use super::*;

fn of(cells: &[&str]) -> Words {
    let mut words = Words::default();
    cells.iter().for_each(|cell| words.add(&Cell::Text(cell)));
    words
}

#[test]
fn qualities_are_those_of_opc_or_words() {
    let bad = Quality::Bad(BadReason::DeviceException);
    let says = |cells: &[&str]| Says::decide(&of(cells), None, "q").map_err(|error| error.to_string());
    let da = says(&["192", "0", "64"]).expect("OPC DA").expect("some");
    assert_eq!(
        ["192", "216", "64", "0"].map(|q| da.quality(&Cell::Text(q))),
        [Quality::Good, Quality::Good, Quality::Stale, bad]
    );
    let ua = says(&["0", "2147483648"]).expect("OPC UA").expect("some");
    assert_eq!([0.0, 2_147_483_648.0].map(|q| ua.quality(&Cell::Number(q))), [Quality::Good, bad]);
    let words = says(&["Good", "Bad - no comm"]).expect("words").expect("some");
    assert_eq!(
        ["Good [192]", "GoodNonCascade", "Uncertain", "Bad - no comm", "I/O Timeout", "bad:timeout"]
            .map(|q| words.quality(&Cell::Text(q))),
        [Quality::Good, Quality::Good, Quality::Stale, bad, bad, Quality::Bad(BadReason::Timeout)]
    );
    assert!(says(&["0", "0"]).expect_err("a doubt").contains("--good-values"));
    assert!(says(&["0", "1"]).expect_err("a doubt").contains("--good-values"));
    assert!(says(&["running"]).expect_err("a doubt").contains("--good-values"));
    // 128 is good on a fieldbus, and OPC DA has no such number.
    for words in [&["192", "128"][..], &["0xc0", "0x80"], &["16#80", "16#00"]] {
        assert!(says(words).expect_err("a doubt").contains("--good-values"), "{words:?}");
    }
    let hex = says(&["0xC0", "0x18"]).expect("OPC DA").expect("some");
    assert_eq!(["0xC0", "0x18"].map(|q| hex.quality(&Cell::Text(q))), [Quality::Good, bad]);
    for words in [&["0x00000000", "0x808C0000"][..], &["0x00000000"]] {
        let hex = says(words).expect("OPC UA").expect("some");
        assert_eq!(["0x00000000", "0x808C0000"].map(|q| hex.quality(&Cell::Text(q))), [Quality::Good, bad]);
    }
    // Nothing is wrong, and nothing is there.
    let denied = says(&["No error", "Keine Störung", "Error"]).expect("words").expect("some");
    assert_eq!(
        ["No error", "No Fault", "Kein Fehler", "No data", "No good data", "No", "Not good", "Error"]
            .map(|q| denied.quality(&Cell::Text(q)).is_good()),
        [true, true, true, false, false, false, false, false]
    );
    let french = says(&["Bonne", "Mauvaise"]).expect("words").expect("some");
    assert_eq!(["Bonne", "Mauvaise"].map(|q| french.quality(&Cell::Text(q))), [Quality::Good, bad]);
}

#[test]
fn a_flag_stands_behind_the_name_of_its_value_or_before_it() {
    for name in ["PV_BAD", "Bad_PV", "bad pv", "pv_is_bad", "pv_bad_quality", "Bad_Quality", "Fault_PV"] {
        assert!(is_bad_flag(name) && !is_good_flag(name), "{name}");
    }
    for name in ["PV_GOOD", "Valid_PV", "IsValid", "pv_good_quality"] {
        assert!(is_good_flag(name) && !is_bad_flag(name), "{name}");
    }
    assert!(is_of_value("Fault_PV", false) && is_of_value("Valid_PV", true));
    assert!(!is_of_value("IsValid", true) && !is_of_value("Bad_PV", false));
}

#[test]
fn a_word_behind_a_number_is_its_quality_and_a_letter_may_be_a_unit() {
    let bad = Quality::Bad(BadReason::DeviceException);
    for (unit, letters, expected) in [
        ("Bad", false, ("", Some(bad))),
        ("Good", false, ("", Some(Quality::Good))),
        ("% Bad", false, ("%", Some(bad))),
        ("g", false, ("g", None)),
        ("G", true, ("", Some(Quality::Good))),
        ("P", true, ("", Some(bad))),
        ("m3/h", true, ("m3/h", None)),
        ("bar", true, ("bar", None)),
        ("", true, ("", None)),
    ] {
        assert_eq!(behind_number(unit, letters), expected, "{unit}");
    }
    assert!(are_letters(["G", "B"].into_iter(), "G") && !are_letters(["g"].into_iter(), "g"));
    assert!(of(&["G", "G", "G", "F", "P"]).are_letters_of_quality());
    assert!(!of(&["G", "G", "G", "E"]).are_letters_of_quality());
}

#[test]
fn a_word_in_brackets_behind_a_number_is_its_quality_where_it_is_known() {
    let bad = Quality::Bad(BadReason::DeviceException);
    for (unit, expected) in [
        ("(Good)", ("", Some(Quality::Good))),
        ("[Bad]", ("", Some(bad))),
        ("% (Uncertain)", ("%", Some(Quality::Stale))),
        ("(x)", ("(x)", None)),
        ("bar (abs)", ("bar (abs)", None)),
        ("(not good)", ("(not good)", None)),
        ("Good [192]", ("", Some(Quality::Good))),
    ] {
        assert_eq!(behind_number(unit, false), expected, "{unit}");
    }
    let unit = |cell| measured(cell).map(|number| number.unit);
    assert_eq!(
        [unit("51.8 (Good)"), unit("51.8[Bad]"), unit("51.8 %")],
        [Some("(Good)"), Some("[Bad]"), Some("%")]
    );
    for cell in
        ["51.8 (x)", "51.8 (not good)", "51.8*", "(Good)", "Good", "1 (Good) 2", "51.8 bar (Questionable)"]
    {
        assert!(measured(cell).is_none(), "{cell}");
    }
}

#[test]
fn few_whole_numbers_of_which_one_is_usual_are_states() {
    for cells in
        [&["0", "0", "1"][..], &["0", "1"], &["0", "0", "0", "1", "32768"], &["5"], &["No", "No", "Yes"]]
    {
        assert!(of(cells).are_states(), "{cells:?}");
    }
    let many: Vec<String> = (0..9).map(|number| number.to_string()).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).chain(["0"; 20]).collect();
    for cells in [&["0", "1", "2"][..], &["51.8", "51.8", "51.7"], &["Good", "Bad"], &many, &[]] {
        assert!(!of(cells).are_states(), "{cells:?}");
    }
}
