//! Tables that only who exported them can explain: an option says it, and without it they are refused by that option's name.

use super::clocks::civil;
use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::twice::imported;
use super::{bits, example, of_bytes};
use stictiond::table::Options;

/// Options by their names.
fn told(pairs: &[(&str, &str)]) -> Options {
    let mut options = Options::default();
    for (name, value) in pairs {
        assert!(options.set(name, (*value).to_string()), "{name}");
    }
    options
}

/// The example as two rows a sample, of OP and of PV, with these names of tags.
fn long(header: &str, op: &str, pv: &str) -> String {
    let example = example();
    let row = |tag: &str, t: f64, value: f64| format!("{:.1};{tag};{value:.3}\n", BEGIN as f64 + t);
    let both = example.op.iter().zip(&example.pv);
    let rows = both.map(|(o, p)| row(op, o.t, o.value) + &row(pv, p.t, p.value));
    header.to_string() + &rows.collect::<String>()
}

#[test]
fn letters_of_an_encoding_that_cannot_be_guessed_are_told() {
    let example = example();
    for (encoding, time, op, pv) in [
        ("shift_jis", "時刻", "弁開度", "流量"),
        ("windows-1250", "Čas", "Výkon řízení", "Průtok"),
        ("windows-1254", "Zaman", "Çıkış", "Akış"),
        ("gb18030", "时间", "阀位", "流量"),
    ] {
        let rows = super::doubts::rows(&example, ';', |t| format!("{t:.1}"));
        let text = format!("{time};{op};{pv}\n{}\n", rows.join("\n"));
        let own = encoding_rs::Encoding::for_label(encoding.as_bytes()).expect("a label");
        let (bytes, _, lost) = own.encode(&text);
        assert!(!lost, "{encoding} has all letters");
        let columns = [("time", time), ("op", op), ("pv", pv)];
        let table = of_bytes(&bytes, &told(&[&columns[..], &[("encoding", encoding)]].concat()));
        let table = table.expect(encoding);
        assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
        let name = own.name();
        assert!(table.found.read_as.starts_with(name), "{}", table.found.read_as);
        let wrong = of_bytes(&bytes, &told(&[&columns[..], &[("encoding", "windows-1253")]].concat()));
        let said = wrong.err().unwrap_or_default();
        assert!(said.contains("no column is called so"), "{said}");
    }
}

#[test]
fn columns_of_tags_and_values_are_told_by_name_or_number() {
    let example = example();
    let tags = [("op", "10LAB01AA001"), ("pv", "10LAB01CF001")];
    let text = |header| long(header, tags[0].1, tags[1].1).into_bytes();
    let said = of_bytes(&text("Ts;Kks;Y\n"), &told(&tags)).err().unwrap_or_default();
    assert!(said.contains("--tag and --value"), "{said}");
    for (header, columns) in [
        ("Ts;Kks;Y\n", [("time", "Ts"), ("tag", "kks"), ("value", "Y")]),
        ("Ts;Kks;Y\n", [("time", "1"), ("tag", "2"), ("value", "3")]),
        ("", [("time", "1"), ("tag", "2"), ("value", "3")]),
        ("Ts;Tag;Y\n", [("time", "Ts"), ("value", "Y"), ("decimal", ".")]),
    ] {
        let table = of_bytes(&text(header), &told(&[&columns[..], &tags].concat())).expect("read");
        assert!(bits(&table.record) == bits(&example), "{header:?}: {}", table.found.read_as);
    }
    for (one, other) in [("tag", "value"), ("value", "tag")] {
        let column = if one == "tag" { "2" } else { "3" };
        let options = told(&[&[("time", "1"), (one, column)], &tags[..]].concat());
        let said = of_bytes(&text("Ts;Kks;Y\n"), &options).err().unwrap_or_default();
        assert!(said.contains(&format!("name the column of {other}s with --{other}")), "{said}");
    }
}

fn iso(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S%.3f", t)
}

/// How a table is read with options, or why not.
fn said(header: &str, own: &[String], options: &Options) -> String {
    read(header, own, options).map_or_else(|said| said, |table| table.found.read_as)
}

#[test]
fn what_the_header_says_against_an_option_is_told() {
    let own = rows(&example(), ',', iso);
    for (header, tz, by) in [
        ("Time (UTC),OP,PV", "Europe/Berlin", "(Europe/Berlin by --tz), the header says UTC"),
        ("Time (UTC+02:00),OP,PV", "America/New_York", "(America/New_York by --tz), the header says +02:00"),
        ("Time zone,Europe/Berlin\nTime,OP,PV", "+01:00", "(+01:00 by --tz), the table says Europe/Berlin"),
    ] {
        let told = told(&[("tz", tz)]);
        assert!(said(header, &own, &told).contains(by), "{header}: {}", said(header, &own, &told));
        // An option of all tables is for those that say nothing of themselves.
        let all = said(header, &own, &told.of_all_tables());
        assert!(!all.contains("--tz") && !all.contains(tz), "{header}: {all}");
        let plain = said("Time,OP,PV", &own, &told.of_all_tables());
        assert!(plain.contains(&format!("({tz} by --tz)")), "{plain}");
    }
    for (header, tz) in [("Time (UTC),OP,PV", "UTC"), ("Time (Europe/Berlin),OP,PV", "Europe/Berlin")] {
        let same = said(header, &own, &told(&[("tz", tz)]));
        assert!(same.contains("by --tz") && !same.contains("says"), "{same}");
    }
    let open = rows(&example(), ',', |t| civil("%d/%m/%Y %H:%M:%S", t));
    let order = said("Time (dd/mm/yyyy),OP,PV", &open, &told(&[("time_format", "mdy")]));
    assert!(order.contains("time mm/dd/yyyy (UTC), the header says dd/mm/yyyy"), "{order}");
    let millis = rows(&example(), ',', |t| format!("{:.0}", (t - BEGIN as f64) * 1e3));
    let unit = said("Time [ms],OP,PV", &millis, &told(&[("time_unit", "s")]));
    assert!(unit.contains("time in seconds, the header says ms"), "{unit}");
}

#[test]
fn options_that_change_nothing_are_told() {
    let dated = rows(&example(), ',', iso);
    let with_offset = rows(&example(), ',', |t| iso(t) + "Z");
    let epoch = rows(&example(), ',', |t| format!("{:.0}", t * 1e3));
    for (own, options, by) in [
        (&dated, &[("time_unit", "s")][..], ", --time-unit changes nothing here"),
        (&dated, &[("time_format", "dd.mm.yyyy")], ", --time-format changes nothing here"),
        (&dated, &[("sheet", "Data")], ", --sheet changes nothing here"),
        (&with_offset, &[("tz", "Europe/Berlin")], ", --tz changes nothing here"),
        (&epoch, &[("tz", "UTC"), ("time_format", "dmy")], ", --tz and --time-format change nothing here"),
    ] {
        let told = told(options);
        let read_as = said("Time,OP,PV", own, &told);
        assert!(read_as.contains(by), "{options:?}: {read_as}");
        let plain = said("Time,OP,PV", own, &Options::default());
        assert_eq!(read_as.replace(by, ""), plain);
        // A configuration tells them of tables of all kinds.
        assert_eq!(said("Time,OP,PV", own, &told.of_all_tables()), plain);
    }
}

#[test]
fn options_by_which_nothing_can_be_read_are_refused_with_the_cell() {
    let epoch = |of: &dyn Fn(f64) -> String| rows(&example(), ',', of);
    let millis = epoch(&|t| format!("{:.0}", t * 1e3));
    let julian = epoch(&|t| format!("{:.8}", t / 86_400.0 + 2_440_587.5));
    let labview = epoch(&|t| format!("{:.2}", t + 2_082_844_800.0));
    let header = "Time,OP,PV";
    for (own, unit, by) in [
        (
            &millis,
            "s",
            "line 2, column 1 (Time): \"1780293600000\" is no time before 2100 in seconds, and 1200 of 1200 rows are",
        ),
        (
            &julian,
            "days",
            "\"2461192.75000000\" is no time before 2100 in days of a spreadsheet, and 1200 of 1200",
        ),
        (&julian, "datenum", "is no time before 2100 in days since the year 0"),
        (&labview, "s", "say --time-unit s1904"),
    ] {
        let options = told(&[("time_unit", unit)]);
        let why = read(header, own, &options).map(|table| table.found.read_as);
        assert!(why.as_ref().is_err_and(|why| why.contains(by) && why.contains("--time-unit")), "{why:?}");
        let text = format!("{header}\n{}\n", own.join("\n"));
        assert_eq!(imported(&text, &options).err(), why.err());
    }
    let commas = |digits: usize| -> Vec<String> {
        let example = example();
        let pairs = example.op.iter().zip(&example.pv);
        let row = |t: f64, op: f64, pv: f64| format!("{t};{op:.digits$};{pv:.digits$}").replace('.', ",");
        pairs.map(|(op, pv)| row(BEGIN as f64 + op.t.floor(), op.value, pv.value)).collect()
    };
    let point = told(&[("decimal", ".")]);
    let why = said("Time;OP;PV", &commas(2), &point);
    assert!(why.contains("is no number with a decimal point") && why.contains("say --decimal ,"), "{why}");
    // Three digits behind the sign may be thousands, and are what the option says.
    assert!(read("Time;OP;PV", &commas(3), &point).is_ok_and(|table| table.record.op[0].value == 51_812.0));
}

#[test]
fn numbers_of_no_unit_are_told_by_their_line_and_as_they_are_written() {
    let digits = rows(&example(), ',', |t| civil("%y%m%d%H%M%S", t));
    let plain = Options::default();
    let by = "line 2, column 1 (Time): \"260601060000\" is a time of our days in no unit; say --time-unit, or where the digits";
    assert!(said("Time,OP,PV", &digits, &plain).starts_with(by), "{}", said("Time,OP,PV", &digits, &plain));
    let mixed: Vec<String> = rows(&example(), ',', |t| {
        if t - BEGIN as f64 > 1199.0 { format!("{t:.3}") } else { format!("{:.0}", t * 1e3) }
    });
    let by = "line 602, column 1 (Time): \"1780294800.050\" counts in another unit than \"1780293600000\" in line 2";
    assert!(said("Time,OP,PV", &mixed, &plain).starts_with(by), "{}", said("Time,OP,PV", &mixed, &plain));
    // Microseconds since the start, which become as many as seconds since 1970.
    let counts = rows(&example(), ',', |t| format!("{:.0}", (t - BEGIN as f64) * 1e6));
    let why = said("t,OP,PV", &counts, &plain);
    assert!(why.contains("and \"0\" in line 2, are times of our days in no unit; say --time-unit"), "{why}");
    let told = told(&[("time_unit", "us")]);
    assert!(read("t,OP,PV", &counts, &told).is_ok_and(|table| bits(&table.record) == bits(&example())));
}

#[test]
fn a_time_of_day_with_points_stands_beside_a_date_with_other_signs() {
    let later = |format: &str, t: f64| civil(format, t + 15.0 * 86_400.0);
    for header in ["Data;Ora;Uscita;Misura", "Date;Time;OP;PV"] {
        let own = rows(&example(), ';', |t| later("%d/%m/%Y;%H.%M.%S", t));
        let table = read(header, &own, &Options::default()).unwrap_or_else(|said| panic!("{header}: {said}"));
        assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
        assert_eq!(table.record.op[0].t, BEGIN as f64 + 15.0 * 86_400.0, "{}", table.found.read_as);
        let last = example().op.last().map_or(0.0, |own| own.t);
        let off = table.record.op.last().map_or(0.0, |own| own.t) - table.record.op[0].t - last;
        assert!(off.abs() < 1.0, "{}", table.found.read_as);
    }
}
