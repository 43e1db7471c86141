//! What the controller's mode is called and how it is written, roles that no other column of the loop contradicts, and names of many
//! kinds.

use super::clocks::civil;
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::Record;
use stictiond::table::{Options, Table};

/// A table of the example in which OP is held from row 300 on; `beside` says what stands in the other columns, before and from then.
fn held(header: &str, beside: [&str; 2]) -> Vec<u8> {
    let Record { op, pv, .. } = example();
    let rows = op.iter().zip(&pv).enumerate().map(|(at, (own, pv))| {
        let time = civil("%Y-%m-%d %H:%M:%S%.3f", BEGIN as f64 + own.t);
        let (value, beside) = if at < 300 { (own.value, beside[0]) } else { (op[300].value, beside[1]) };
        format!("{time},{value},{},{beside}\n", pv.value)
    });
    format!("{header}\n{}", rows.collect::<String>()).into_bytes()
}

/// The example with one more cell in each row.
fn moving(header: &str, beside: &str) -> Vec<u8> {
    let Record { op, pv, .. } = example();
    let rows = op.iter().zip(&pv).map(|(op, pv)| {
        let time = civil("%Y-%m-%d %H:%M:%S%.3f", BEGIN as f64 + op.t);
        format!("{time},{},{},{beside}\n", op.value, pv.value)
    });
    format!("{header}\n{}", rows.collect::<String>()).into_bytes()
}

fn read(table: &[u8]) -> Result<Table, String> {
    of_bytes(table, &Options::default())
}

fn refused(table: Result<Table, String>, by: &[&str]) {
    let said = table.map_or_else(|said| said, |table| table.found.read_as);
    by.iter().for_each(|by| assert!(said.contains(by), "{said:?} has no {by:?}"));
}

/// Rows in automatic; `None` where there is no mode.
fn automatic(table: &Table) -> Option<usize> {
    let mode = table.record.mode.as_ref()?;
    Some(mode.iter().filter(|sample| sample.value == 1.0).count())
}

#[test]
fn a_bit_with_both_states_in_its_name_is_automatic_at_1() {
    for name in ["AUTO_MAN", "Auto/Man", "Auto/Manual", "A/M"] {
        let header = format!("Time,OP,PV,{name}");
        let table = read(&held(&header, ["1", "0"])).expect(name);
        assert_eq!(automatic(&table), Some(300), "{name}: {}", table.found.read_as);
        refused(read(&held(&header, ["0", "1"])), &["only while the mode is 0", "--auto-values"]);
        let always = read(&moving(&header, "1")).expect(name);
        assert_eq!(automatic(&always), Some(1200), "{name}: {}", always.found.read_as);
    }
    for (name, no, yes) in [
        ("MAN", "0", "1"),
        ("ManAct", "0", "1"),
        ("Manual mode", "No", "Yes"),
        ("Hand", "0", "1"),
        ("FIC101.MAN", "FALSE", "TRUE"),
    ] {
        let header = if name.contains('.') { "Time,FIC101.OP,FIC101.PV" } else { "Time,OP,PV" };
        let header = format!("{header},{name}");
        let table = read(&held(&header, [no, yes])).expect(name);
        assert_eq!(automatic(&table), Some(300), "{name}: {}", table.found.read_as);
        refused(read(&held(&header, [yes, no])), &["by its name 1 means manual", "--auto-values"]);
    }
}

#[test]
fn a_set_point_from_the_panel_is_no_manual_and_two_words_are_asked_about() {
    for words in [
        ["Auto-Local", "Manual"],
        ["Local Auto", "Man"],
        ["自动", "手动"],
        ["自動", "手動"],
        ["АВТ", "РУЧ"],
        ["Automatico", "Manuale"],
        ["Automatique", "Manuel"],
        ["Automatyczny", "Ręczny"],
        ["Automatikbetrieb", "Handbetrieb"],
    ] {
        let table = read(&held("Time,OP,PV,Mode", words)).unwrap_or_else(|said| panic!("{words:?}: {said}"));
        assert_eq!(automatic(&table), Some(300), "{words:?}: {}", table.found.read_as);
    }
    let both = held("Time,OP,PV,Mode", ["Manual", "Auto (manual setpoint)"]);
    refused(read(&both), &["auto (manual setpoint)", "--auto-values"]);
}

#[test]
fn the_set_point_of_another_controller_is_none_of_a_bare_op() {
    let table = read(&moving("Time,OP,PV,TIC205.SP,TIC205.MODE", "150.5,AUTO")).expect("read");
    let Record { sp, mode, tags, .. } = &table.record;
    assert!(sp.is_none() && mode.is_none() && tags.len() == 1, "{}", table.found.read_as);
    assert!(table.found.read_as.contains("other tags \"TIC205.SP\""), "{}", table.found.read_as);
}

#[test]
fn a_set_point_or_a_position_without_data_is_left_out_and_told() {
    for (name, cell) in [("SP", "----"), ("Valve position", "No Data")] {
        let table = read(&moving(&format!("Time,OP,PV,{name}"), cell)).expect(name);
        assert!(bits(&table.record) == bits(&example()), "{name}");
        assert!(table.record.sp.is_none() && table.record.mv.is_none(), "{name}");
        let said = &table.found.read_as;
        assert!(said.contains(&format!("not used \"{name}\"")), "{said}");
    }
    // What somebody names has to be there.
    let told = Options { sp: Some("SP".into()), ..Options::default() };
    let named = of_bytes(&moving("Time,OP,PV,SP", "----"), &told);
    refused(named, &["no number in the whole column", "\"----\""]);
}

#[test]
fn two_bits_of_one_mode_are_asked_about() {
    let two = held("Time,FIC101.OP,FIC101.PV,FIC101.AUTO,FIC101.MAN", ["1,0", "0,1"]);
    refused(read(&two), &["\"FIC101.AUTO\", \"FIC101.MAN\" may each be mode", "--mode"]);
    for name in ["FIC101.AUTO", "FIC101.MAN"] {
        let told = Options { mode: Some(name.into()), ..Options::default() };
        let table = of_bytes(&two, &told).expect(name);
        assert_eq!(automatic(&table), Some(300), "{name}: {}", table.found.read_as);
    }
}

#[test]
fn a_column_that_changes_as_op_comes_to_rest_may_be_the_mode() {
    for (name, words) in [("AM", ["A", "M"]), ("Loop status", ["Closed", "Open"]), ("State", ["3", "4"])] {
        let table = held(&format!("Time,OP,PV,{name}"), words);
        refused(read(&table), &["OP moves by itself only while", "--mode none", &format!("--mode {name:?}")]);
        let none = Options { mode: Some("none".into()), ..Options::default() };
        assert_eq!(automatic(&of_bytes(&table, &none).expect(name)), None);
        let own =
            Options { mode: Some(name.into()), auto_values: Some(words[0].into()), ..Options::default() };
        assert_eq!(automatic(&of_bytes(&table, &own).expect(name)), Some(300), "{name}");
    }
    // A pump, and a column in which OP moves as before.
    for table in [held("Time,OP,PV,P205 runs", ["1", "0"]), moving("Time,OP,PV,Limit", "low")] {
        let table = read(&table).expect("nothing to ask");
        assert_eq!(automatic(&table), None, "{}", table.found.read_as);
    }
}

#[test]
fn names_of_more_vendors_and_languages_are_known() {
    for header in [
        "Zeit,Stellsignal,Regelgröße,Führungsgröße",
        "Time,FIC101.PIDA.OPEU,FIC101.PIDA.PVEU,FIC101.PIDA.SPEU",
        "Time,FIC101_OUTP,FIC101_PV,FIC101_SP",
        "Time,FIC101OP,FIC101PV,FIC101SP",
        "Time,Valve output (OP),Flow (PV),Set point (SP)",
        "Time,FIC101.OP - Flow output,FIC101.PV - Flow,FIC101.SP - Flow set point",
        "時間,輸出,測量值,設定值",
    ] {
        let table = read(&moving(header, "51.5")).expect(header);
        assert!(bits(&table.record) == bits(&example()), "{header}: {}", table.found.read_as);
        assert!(table.record.sp.is_some(), "{header}: {}", table.found.read_as);
        assert_eq!(table.record.op_span, Some(100.0), "{header}: {}", table.found.read_as);
    }
    for header in ["Time,FIC101.OP - FIC101.PV,Flow (PV),x", "Time,Output (PV),PV,x"] {
        refused(read(&moving(header, "51.5")), &["no column op"]);
    }
}

#[test]
fn wincc_writes_its_columns_in_german_too() {
    let Record { op, pv, .. } = example();
    let comma = |value: f64| value.to_string().replace('.', ",");
    let rows = op.iter().zip(&pv).map(|(op, pv)| {
        let time = civil("%d.%m.%Y %H:%M:%S%.3f", BEGIN as f64 + op.t);
        format!("{time};{};{time};{}\n", comma(op.value), comma(pv.value))
    });
    let header =
        "FIC101/MV#Value Zeit;FIC101/MV#Value Wert;FIC101/PV_Out#Value Zeit;FIC101/PV_Out#Value Wert";
    let table = read(format!("{header}\n{}", rows.collect::<String>()).as_bytes()).expect("read");
    assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
}

#[test]
fn words_of_a_mode_under_the_name_of_a_quality_are_asked_about_as_a_mode() {
    for (name, words) in [("Status", ["AUTO", "MAN"]), ("PV_Status", ["Automatik", "Hand"])] {
        let table = held(&format!("Time,OP,PV,{name}"), words);
        refused(read(&table), &[&format!("column {name}"), &format!("--mode {name:?}"), "--good-values"]);
        let told = Options { mode: Some(name.into()), ..Options::default() };
        let own = of_bytes(&table, &told).unwrap_or_else(|said| panic!("{name}: {said}"));
        assert_eq!(automatic(&own), Some(300), "{name}: {}", own.found.read_as);
    }
    let other = read(&held("Time,OP,PV,Status", ["running", "stopped"])).err().unwrap_or_default();
    assert!(other.contains("--good-values") && !other.contains("--mode"), "{other}");
}
