//! Columns that say whether a value is good: whatever they are called and wherever they stand, a bad value is never used.

use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::Record;
use stictiond::table::{Options, Table};

/// Whether the PV of row k is bad.
fn is_bad(k: usize) -> bool {
    k % 3 == 1
}

/// The example with every third PV replaced by nonsense; `row` puts time, OP, PV and PV's quality into a line.
fn spoilt(header: &str, words: [&str; 2], row: impl Fn(f64, f64, f64, &str) -> String) -> Vec<u8> {
    let example = example();
    let rows = example.op.iter().zip(&example.pv).enumerate().map(|(k, (op, pv))| {
        let (value, word) = if is_bad(k) { (99.0, words[1]) } else { (pv.value, words[0]) };
        row(BEGIN as f64 + op.t, op.value, value, word)
    });
    (header.to_string() + &rows.collect::<String>()).into_bytes()
}

/// Checks that exactly the spoilt values of PV are bad, and those of OP only where the quality is the row's.
fn assert_left_out(name: &str, table: Result<Table, String>, of_row: bool) {
    let Record { op, pv, .. } = table.unwrap_or_else(|error| panic!("{name}: {error}")).record;
    assert_eq!(pv.len(), example().pv.len(), "{name}");
    for (k, (op, pv)) in op.iter().zip(&pv).enumerate() {
        assert_eq!(pv.quality.is_good(), !is_bad(k), "{name}: PV of row {k}");
        assert_eq!(op.quality.is_good(), !(of_row && is_bad(k)), "{name}: OP of row {k}");
    }
}

#[test]
fn a_column_that_tells_good_from_bad_is_known_by_what_stands_in_it() {
    let words = ["Good", "Bad CommFailure"];
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    for (header, of_row) in [
        ("Time,FC101.OP,FC101.PV,FC101.PV.STS\n", false),
        ("Time,FC101.OP,FC101.PV,PV State\n", false),
        ("Time,FC101.OP,FC101.PV,FC101.PV_FLAG\n", false),
        ("Time,FC101.OP,FC101.PV,\n", false),
        ("Time,FC101.OP,FC101.PV,DataQuality\n", true),
        ("Time,FC101.OP,FC101.PV,Güte\n", true),
        ("Time,FC101.OP,FC101.PV,Remark\n", true),
    ] {
        let table = of_bytes(&spoilt(header, words, own), &Options::default());
        assert_left_out(header, table, of_row);
    }
    // In the numbers of OPC.
    for words in [["192", "0"], ["216", "24"], ["0", "2147483648"]] {
        let table = of_bytes(&spoilt("Time,OP,PV,PV code\n", words, own), &Options::default());
        assert_left_out(words[1], table, false);
    }
    for words in [["OK", "BAD"], ["NR", "Bad"]] {
        let table = of_bytes(&spoilt("Time,OP,PV,PV state\n", words, own), &Options::default());
        assert_left_out(words[0], table, false);
    }
    // A flag that is set where the value is bad.
    for (header, words) in [("PV_BAD", ["0", "1"]), ("pv questionable", ["False", "True"])] {
        let header = format!("Time,OP,PV,{header}\n");
        assert_left_out(&header, of_bytes(&spoilt(&header, words, own), &Options::default()), false);
    }
    // What is told is looked for in every column.
    let told = Options { good_values: Some("x7".into()), ..Options::default() };
    let table = of_bytes(&spoilt("Time,OP,PV,PV code\n", ["x7", "x9"], own), &told);
    assert_left_out("told", table, false);
    // Where a column is known by its name, what is told is not looked for among measurements.
    let told = Options { good_values: Some("192".into()), ..Options::default() };
    let with_tag =
        |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said},{}\n", 190 + (t as u64) % 3);
    let table = of_bytes(&spoilt("Time,OP,PV,pv_status,TI5\n", ["192", "0"], with_tag), &told);
    assert_left_out("measurements", table, false);
    // What is measured is no quality.
    let table = of_bytes(&spoilt("Time,OP,PV,TI5\n", ["192", "193"], own), &Options::default());
    assert!(table.expect("read").record.pv.iter().all(|sample| sample.quality.is_good()));
}

#[test]
fn qualities_stand_behind_their_values_or_before_them() {
    let words = ["Good", "Bad"];
    for (header, before) in [
        ("Tagname,FC101.OP,,FC101.PV,\nTimestamp,Value,Quality,Value,Quality\n", false),
        ("Timestamp,FC101.OP,,FC101.PV,\n", false),
        ("Timestamp,FC101.OP,Quality,FC101.PV,Quality\n", false),
        ("Time,Status,FC101.OP,Status,FC101.PV\n", true),
        ("Time,,FC101.OP,,FC101.PV\n", true),
    ] {
        let row = |t: f64, op: f64, pv: f64, said: &str| {
            if before {
                format!("{t},Good,{op},{said},{pv}\n")
            } else {
                format!("{t},{op},Good,{pv},{said}\n")
            }
        };
        // Above a row of names stand tags, and nobody knows which of the rows is the header.
        let told = ["1", "2", "4"].map(|number| header.starts_with("Tagname").then(|| number.to_string()));
        let [time, op, pv] = told;
        let options = Options { time, op, pv, ..Options::default() };
        assert_left_out(header, of_bytes(&spoilt(header, words, row), &options), false);
    }
}

#[test]
fn a_second_column_of_times_without_a_name_is_refused() {
    let row = |t: f64, op: f64, pv: f64, _: &str| {
        let civil = |t: f64| jiff::Timestamp::from_millisecond((t * 1e3) as i64).expect("a time").to_string();
        format!("{},{pv},{},{op}\n", civil(t), civil(t + 4.0))
    };
    let said = of_bytes(&spoilt("Time,FC101.PV,,FC101.OP\n", ["", ""], row), &Options::default());
    let said = said.err().unwrap_or_default();
    assert!(said.contains("column 3") && said.contains("holds other times"), "{said}");
}

#[test]
fn quotes_behind_blanks_and_rulers_of_dashes_are_none_of_the_values() {
    let quoted = |t: f64, op: f64, pv: f64, _: &str| format!("\"{t}\", \"{op}\", '{pv}'\n");
    let mut text = spoilt("\"Time\", \"FIC101.OP\", 'FIC101.PV'\n", ["", ""], quoted);
    let table = of_bytes(&text, &Options::default()).expect("quotes");
    assert_eq!(bits(&table.record)[0], bits(&example())[0]);
    let wide = |t: f64, op: f64, pv: f64, _: &str| format!("{t:<22}{op:<22}{pv:<22}\n");
    let ruler = format!("{0:<22}{1:<22}{2:<22}\n{3} {3} {3}\n", "Time", "OP", "PV", "-".repeat(21));
    text = spoilt(&ruler, ["", ""], wide);
    let table = of_bytes(&text, &Options::default()).expect("a ruler");
    assert_eq!(bits(&table.record)[0], bits(&example())[0]);
}

#[test]
fn other_names_and_words_of_quality_are_known_too() {
    let plain = Options::default();
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    for (header, words) in [
        ("Time,OP,PV,PV PercentGood\n", ["100", "0"]),
        ("Time,OP,PV,PV % Good\n", ["100", "37.5"]),
        ("Time,OP,PV,PV Qualità\n", ["Buona", "Cattiva"]),
        ("Time,OP,PV,PV 품질\n", ["양호", "불량"]),
    ] {
        assert_left_out(header, of_bytes(&spoilt(header, words, own), &plain), false);
    }
    let hda = |t: f64, op: f64, pv: f64, said: &str| format!("{t};{op};{pv};{said}\n");
    let table = of_bytes(&spoilt("Time;OP;PV;Quality\n", ["Raw, Good", "Raw, Bad"], hda), &plain);
    assert_left_out("OPC HDA", table, true);
    // The quality codes of PCS 7 are asked for.
    let codes = spoilt("Time,OP,PV,PV.QC\n", ["128", "0"], own);
    assert!(of_bytes(&codes, &plain).is_err_and(|said| said.contains("--good-values")));
    let told = |good: &str| Options { good_values: Some(good.into()), ..Options::default() };
    assert_left_out("128", of_bytes(&codes, &told("128")), false);
    // One that never changes says nothing, and neither does an average of which no part is known to be whole.
    let one = of_bytes(&spoilt("Time,OP,PV,PV.QC\n", ["0", "0"], own), &plain).expect("read").record;
    assert!(one.pv.iter().all(|sample| sample.quality.is_good()));
    let share = spoilt("Time,OP,PV,PV PercentGood\n", ["1", "0.4"], own);
    assert!(of_bytes(&share, &plain).is_err_and(|said| said.contains("--good-values")));
    let nowhere = of_bytes(&codes, &told("129")).expect_err("no such value");
    assert!(nowhere.contains("none of \"129\" is there") && nowhere.contains("128"), "{nowhere}");
}

/// Whether the OP of row k is bad, where it has a quality of its own.
fn is_op_bad(k: usize) -> bool {
    k % 5 == 2
}

/// The example with a quality for OP and one for PV; `row` puts time, OP, PV and what is said of each into a line.
fn of_each(header: &str, words: [&str; 2], row: impl Fn(f64, f64, f64, [&str; 2]) -> String) -> Vec<u8> {
    let example = example();
    let rows = example.op.iter().zip(&example.pv).enumerate().map(|(k, (op, pv))| {
        let said = [is_op_bad(k), is_bad(k)].map(|bad| words[usize::from(bad)]);
        row(BEGIN as f64 + op.t, op.value, pv.value, said) + "\n"
    });
    (header.to_string() + "\n" + &rows.collect::<String>()).into_bytes()
}

/// Checks that exactly the values that are said to be bad are; what was read.
fn assert_each(name: &str, table: &[u8]) -> String {
    let table = of_bytes(table, &Options::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
    let Record { op, pv, .. } = &table.record;
    for (k, (op, pv)) in op.iter().zip(pv).enumerate() {
        assert_eq!(op.quality.is_good(), !is_op_bad(k), "{name}: OP of row {k}: {}", table.found.read_as);
        assert_eq!(pv.quality.is_good(), !is_bad(k), "{name}: PV of row {k}: {}", table.found.read_as);
    }
    assert_eq!(bits(&table.record), bits(&example()), "{name}");
    table.found.read_as
}

/// Why a table is refused; it has these words.
fn assert_refused(name: &str, table: &[u8], by: &str) {
    let said = of_bytes(table, &Options::default()).map(|table| table.found.read_as);
    let said = said.map_or_else(|said| said, |read| panic!("{name}: {read}"));
    assert!(said.contains(by), "{name}: {said}");
}

#[test]
fn a_quality_at_the_end_belongs_to_the_value_in_its_name_or_in_its_place() {
    let at_end =
        |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| format!("{t},{op},{pv},{of_op},{of_pv}");
    for (names, words) in [
        ("Q_OP,Q_PV", ["Good", "Bad"]),
        ("Quality_OP,Quality_PV", ["Good", "Bad"]),
        ("Quality_OP,Quality_PV", ["192", "0"]),
        ("Quality (OP),Quality (PV)", ["Good", "Bad"]),
        ("Quality,Quality.1", ["Good", "Bad"]),
        ("Quality,Quality", ["192", "24"]),
        ("Q1,Q2", ["Good", "Bad"]),
        ("OPQ,PVQ", ["Good", "Bad"]),
        ("State OP,State PV", ["Good", "Bad"]),
        ("op_is_bad,pv_is_bad", ["0", "1"]),
        ("Bad_OP,Bad_PV", ["0", "1"]),
        ("Fault_OP,Fault_PV", ["False", "True"]),
        ("Valid_OP,Valid_PV", ["True", "False"]),
        ("OP Bad Quality,PV Bad Quality", ["FALSE", "TRUE"]),
        ("Qualité OP,Qualité PV", ["Bonne", "Mauvaise"]),
        ("OP Quality,PV Quality", ["0xC0", "0x18"]),
        ("OP StatusCode,PV StatusCode", ["0x00000000", "0x808C0000"]),
    ] {
        let said = assert_each(names, &of_each(&format!("Time,OP,PV,{names}"), words, at_end));
        // What says how good a value is is nothing else.
        assert!(!said.contains("not used") && !said.contains("other tags"), "{names}: {said}");
    }
    for header in [
        "Time,FIC101.OP,FIC101.PV,Status FIC101.OP,Status FIC101.PV",
        "Time,FIC101.OP,FIC101.PV,Quality (FIC101.OP),Quality (FIC101.PV)",
        "Fecha,Salida,PV,Calidad Salida,Calidad PV",
    ] {
        assert_each(header, &of_each(header, ["Good", "Bad"], at_end));
    }
    let three = |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| {
        format!("{t},{op},{pv},{pv},{of_op},{of_pv},{}", of_pv.replace("Bad", "Good"))
    };
    for names in ["Quality,Quality,Quality", "Q_OP,Q_PV,Q_SP"] {
        assert_each(names, &of_each(&format!("Time,OP,PV,SP,{names}"), ["Good", "Bad"], three));
    }
    let behind =
        |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| format!("{t},{op},{of_op},{pv},{of_pv}");
    for header in [
        "Time,FIC101.OP,FIC101.OP [Quality],FIC101.PV,FIC101.PV [Quality]",
        "Time,FIC101.OP (Value),FIC101.OP (Status),FIC101.PV (Value),FIC101.PV (Status)",
    ] {
        let said = assert_each(header, &of_each(header, ["Good", "Bad"], behind));
        assert!(!said.contains("[Value]"), "{said}");
    }
}

#[test]
fn one_column_with_the_name_of_a_value_says_nothing_of_the_others() {
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    for (name, words, of_row) in [
        ("Q_PV", ["Good", "Bad"], false),
        ("Bad_PV", ["0", "1"], false),
        ("BADPV", ["0", "1"], false),
        ("pv_bad_quality", ["0", "1"], false),
        ("Bad_Quality", ["0", "1"], true),
        ("IOBad", ["False", "True"], true),
    ] {
        let header = format!("Time,OP,PV,{name}\n");
        assert_left_out(name, of_bytes(&spoilt(&header, words, own), &Options::default()), of_row);
    }
}

#[test]
fn a_quality_of_which_two_values_may_be_meant_is_asked_about() {
    let whose = "of which value nobody knows";
    let with_sp =
        |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| format!("{t},{op},{pv},{pv},{of_op},{of_pv}");
    for words in [["Good", "Bad"], ["1", "0"]] {
        let table = of_each("Time,OP,PV,SP,Quality,Quality", words, with_sp);
        assert_refused("two behind three", &table, whose);
    }
    let in_turn =
        |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| format!("{t},{op},{pv},{of_op},5,{of_pv}");
    assert_refused("behind two", &of_each("Time,OP,PV,State,TI5,State", ["Good", "Bad"], in_turn), whose);
    let alike = |t: f64, op: f64, pv: f64, _: [&str; 2]| format!("{t},{op},{pv},{pv},Good,Good");
    let table = of_each("Time,OP,PV,SP,Quality,Quality", ["", ""], alike);
    assert!(of_bytes(&table, &Options::default()).is_ok(), "where all is good it does not matter");
}

#[test]
fn the_quality_of_one_value_answers_no_question_about_another() {
    for (header, of_op, of_pv) in [
        ("Time,OP,State,PV,State", ["Good", "Bad"], ["OK", "FAIL"]),
        ("Time,OP,OP_ok,PV,PV_state", ["TRUE", "FALSE"], ["OK", "FAIL"]),
        ("Time,FIC101.OUT,,FIC101.PV,", ["G", "G"], ["G", "E"]),
    ] {
        let row = |t: f64, op: f64, pv: f64, bad: [&str; 2]| {
            let [op_said, pv_said] = bad.map(|bad| usize::from(!bad.is_empty()));
            format!("{t},{op},{},{pv},{}", of_op[op_said], of_pv[pv_said])
        };
        let table = of_each(header, ["", "bad"], row);
        assert_refused(header, &table, "may say which values are good");
        assert_refused(header, &table, "column 5");
    }
    // 128 is good on a fieldbus, and OPC DA does not know it.
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    assert_refused("128", &spoilt("Time,OP,PV,Status\n", ["192", "128"], own), "--good-values");
}

#[test]
fn letters_and_words_say_how_good_the_value_before_them_is() {
    let columns = |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| {
        format!("{t},{op},{},{pv},{of_pv}", of_op.replace(['P', 'F'], "B"))
    };
    for header in ["Time,FIC101.OUT,,FIC101.PV,", "Time,FIC101.OUT,Q,FIC101.PV,Q"] {
        for bad in ["B", "P", "F", "U"] {
            assert_each(header, &of_each(header, ["G", bad], columns));
        }
    }
    let cells =
        |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| format!("{t},{op} {of_op},{pv} {of_pv}");
    for words in [["G", "B"], ["Good", "Bad"], ["", "Bad"], ["%", "% Bad"]] {
        let said = assert_each(words[1], &of_each("Time,OP,PV", words, cells));
        assert!(said.contains("not good by the words behind OP, the words behind PV"), "{said}");
        assert_eq!(said.contains(" [%]"), words[0] == "%", "{said}");
        assert!(!said.contains(" [G"), "{said}");
    }
    // A balance counts in grams.
    let grams = |t: f64, op: f64, pv: f64, _: [&str; 2]| format!("{t},{op},{pv} g");
    let table = of_bytes(&of_each("Time,OP,PV", ["", ""], grams), &Options::default()).expect("grams");
    assert!(table.found.read_as.contains("pv from \"PV\" [g]"), "{}", table.found.read_as);
}

#[test]
fn the_least_and_the_greatest_of_many_values_are_not_taken_for_op_and_pv() {
    let own = |t: f64, op: f64, pv: f64, _: [&str; 2]| format!("{t},{op},{pv}");
    for header in
        ["Time,OP (Min),PV (Min)", "Time,FIC101.OP [Maximum],FIC101.PV [Maximum]", "Time,OP (StdDev),PV"]
    {
        assert_refused(header, &of_each(header, ["", ""], own), "no column op");
    }
}

#[test]
fn the_quality_of_a_loop_is_that_of_its_values_and_of_no_other_loop() {
    let row = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said},1,2,Bad\n");
    let header = "Time,FIC101.OP,FIC101.PV,FIC101.Quality,FIC102.OP,FIC102.PV,FIC102.Quality\n";
    let told = Options { of_loop: Some("FIC101".into()), ..Options::default() };
    assert_left_out(header, of_bytes(&spoilt(header, ["Good", "Bad"], row), &told), true);
}

#[test]
fn a_state_in_numbers_beside_a_value_is_asked_about() {
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    let told = |good: &str| Options { good_values: Some(good.into()), ..Options::default() };
    for (name, words) in [
        ("PV_STS", ["0", "1"]),
        ("PV_STAT", ["1", "0"]),
        ("PV_FLAG", ["0", "32768"]),
        ("PV_CODE", ["No", "Yes"]),
        ("Flag PV", ["0", "1"]),
        ("PVSTS", ["1", "0"]),
    ] {
        let table = spoilt(&format!("Time,OP,PV,{name}\n"), words, own);
        assert_refused(name, &table, "column 4");
        assert_refused(name, &table, "may say which values are good");
        assert_refused(name, &table, "--good-values");
        assert_left_out(name, of_bytes(&table, &told(words[0])), false);
        let all = of_bytes(&table, &told(&words.join(","))).expect(name).record;
        assert!(all.pv.iter().all(|sample| sample.quality.is_good()), "{name}");
    }
    // What is measured, what is of another loop, and what names no value.
    for (header, words) in [
        ("Time,FC101.OP,FC101.PV,FC102.PV_STS\n", ["0", "1"]),
        ("Time,FC101.OP,FC101.PV,Batch code\n", ["0", "1"]),
        ("Time,FC101.OP,FC101.PV,PV_CODE\n", ["1.5", "2.5"]),
    ] {
        let table = of_bytes(&spoilt(header, words, own), &Options::default()).expect(header);
        assert!(table.record.pv.iter().all(|sample| sample.quality.is_good()), "{header}");
    }
    let counted = |t: f64, op: f64, pv: f64, _: &str| format!("{t},{op},{pv},{}\n", t as u64 % 97);
    let table = of_bytes(&spoilt("Time,OP,PV,PV_CODE\n", ["", ""], counted), &Options::default());
    assert_eq!(table.expect("a count").record.tags.len(), 1);
}

#[test]
fn what_either_of_two_columns_calls_bad_is_bad() {
    let plain = Options::default();
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    for (names, words, of_row) in [
        ("IsGood,State", ["true,OK", "true,FAIL"], true),
        ("IsGood,State", ["true,OK", "false,OK"], true),
        ("State,IsGood", ["OK,1", "FAIL,1"], true),
        ("State,Status", ["Normal,Good", "Fault,Good"], true),
        ("PV_IsGood,PV state", ["true,OK", "true,FAIL"], false),
        ("pv_status,State", ["Good,OK", "Good,FAIL"], false),
        ("IsGood,PV state", ["true,OK", "true,FAIL"], false),
    ] {
        let table = of_bytes(&spoilt(&format!("Time,OP,PV,{names}\n"), words, own), &plain);
        assert_left_out(&format!("{names} {words:?}"), table, of_row);
    }
    // Where nothing stands nothing is said.
    let seldom = |t: f64, op: f64, pv: f64, said: &str| {
        let said = if (t as u64).is_multiple_of(7) { said.replace("OK", "") } else { said.to_string() };
        own(t, op, pv, &said)
    };
    let table = spoilt("Time,OP,PV,IsGood,State\n", ["true,OK", "true,FAIL"], seldom);
    assert!(String::from_utf8_lossy(&table).contains("true,\n"), "some are blank");
    assert_left_out("blank", of_bytes(&table, &plain), true);
    // Each behind its value, beside a flag of the row.
    let behind =
        |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| format!("{t},{op},{of_op},{pv},{of_pv},true");
    assert_each("behind", &of_each("Time,OP,State,PV,State,IsGood", ["OK", "FAIL"], behind));
    let long = |t: f64, op: f64, pv: f64, said: &str| {
        format!("{t},FC101.OP,{op},true,OK\n{t},FC101.PV,{pv},true,{said}\n")
    };
    let table = spoilt("Time,Tag,Value,IsGood,State\n", ["OK", "FAIL"], long);
    assert_left_out("long", of_bytes(&table, &plain), false);
}

#[test]
fn a_state_that_is_a_tag_of_its_own_is_asked_about_where_its_value_is_needed() {
    let long = |t: f64, op: f64, pv: f64, said: &str| {
        format!("{t},FC101.OP,{op}\n{t},FC101.PV,{pv}\n{t},FC101.PV_STS,{said}\n{t},FC102.PV_STS,{said}\n")
    };
    let table = spoilt("Time,Tag,Value\n", ["0", "1"], long);
    assert_refused("long", &table, "tag \"FC101.PV_STS\" may say which values are good");
    let told = Options { good_values: Some("0".into()), ..Options::default() };
    assert_left_out("told", of_bytes(&table, &told), false);
}

#[test]
fn a_word_in_brackets_behind_a_value_is_its_quality_and_a_mark_is_named() {
    let cells =
        |t: f64, op: f64, pv: f64, [of_op, of_pv]: [&str; 2]| format!("{t},{op} {of_op},{pv} {of_pv}");
    for words in [["(Good)", "(Bad)"], ["[Good]", "[Uncertain]"], ["% (Good)", "% (Bad)"]] {
        let said = assert_each(words[1], &of_each("Time,OP,PV", words, cells));
        assert!(said.contains("not good by the words behind OP, the words behind PV"), "{said}");
        assert_eq!(said.contains("[%]"), words[0].starts_with('%'), "{said}");
    }
    for mark in ["*", "(x)", "?", "(* bad)"] {
        let table = of_each("Time,OP,PV", [mark, mark], cells);
        assert_refused(mark, &table, "line 2, column 2 (OP): no number in the whole column");
        assert_refused(mark, &table, &format!("what {mark:?} behind a number means is not known"));
        assert_refused(mark, &table, "--good-values");
    }
}
