//! Modes and qualities under names that nobody lists, and qualities that are tags of their own: what stands in them tells, or is asked
//! for.

use super::dress::BEGIN;
use super::{example, of_bytes};
use stictiond::signal::{Record, Sample};
use stictiond::table::{Options, Source, Table, TableError, stream};

/// A table of the example, `row` putting number, time, OP and PV into a line.
fn made(header: &str, row: impl Fn(usize, String, f64, f64) -> String) -> Vec<u8> {
    let Record { op, pv, .. } = example();
    let rows = op.iter().zip(&pv).enumerate().map(|(at, (op, pv))| {
        let civil = jiff::Timestamp::from_millisecond(((BEGIN as f64 + op.t) * 1e3).round() as i64);
        row(at, civil.expect("a time").to_string(), op.value, pv.value) + "\n"
    });
    (header.to_string() + "\n" + &rows.collect::<String>()).into_bytes()
}

fn read(table: &[u8]) -> Result<Table, String> {
    of_bytes(table, &Options::default())
}

/// Rows of the mode that are automatic.
fn on(table: &Table) -> usize {
    table.record.mode.iter().flatten().filter(|mode| mode.value == 1.0).count()
}

fn bad(series: &[Sample]) -> usize {
    series.iter().filter(|sample| !sample.quality.is_good()).count()
}

#[test]
fn a_mode_is_known_by_its_words_whatever_its_name() {
    for (name, words) in [
        ("FIC101.Betrieb", ["AUTO", "MAN"]),
        ("Zustand", ["Automatik", "Hand"]),
        ("FIC-101 state", ["CASC", "Manual"]),
        ("Status of loop", ["Auto", "Man"]),
    ] {
        let own = |at: usize, t: String, op, pv| format!("{t},{op},{pv},{}", words[usize::from(at >= 300)]);
        let table = read(&made(&format!("Time,FIC101.OP,FIC101.PV,{name}"), own)).expect(name);
        assert_eq!(on(&table), 300, "{name}: {}", table.found.read_as);
        assert!(table.found.read_as.contains(&format!("mode from {name:?}")), "{}", table.found.read_as);
    }
    let long = |at: usize, t: String, op: f64, pv: f64| {
        let mode = ["AUTO", "MAN"][usize::from(at >= 300)];
        format!("{t},FIC101.OP,{op}\n{t},FIC101.PV,{pv}\n{t},FIC101.Betrieb,{mode}")
    };
    let table = read(&made("Time,Tag,Value", long)).expect("long");
    assert_eq!(on(&table), 300, "{}", table.found.read_as);
}

#[test]
fn words_of_another_device_a_remark_and_a_second_mode_are_not_taken_for_the_mode() {
    for (name, every, words) in [
        ("FIC102.Betrieb", 1, ["AUTO", "MAN"]),
        ("P205 selector", 1, ["AUTO", "HAND"]),
        ("Remark", 100, ["auto again", "manual"]),
        ("Limit switch", 1, ["open", "closed"]),
    ] {
        let own = |at: usize, t: String, op, pv| {
            let word = if at.is_multiple_of(every) { words[usize::from(at >= 300)] } else { "" };
            format!("{t},{op},{pv},{word}")
        };
        let table = read(&made(&format!("Time,FIC101.OP,FIC101.PV,{name}"), own)).expect(name);
        assert!(table.record.mode.is_none(), "{name}: {}", table.found.read_as);
        assert!(table.found.read_as.contains("not used"), "{name}: {}", table.found.read_as);
    }
    let two = made("Time,OP,PV,Set,Actual", |at, t, op, pv| {
        let actual = if at < 300 { "MAN" } else { "AUTO" };
        format!("{t},{op},{pv},AUTO,{actual}")
    });
    let said = read(&two).err().unwrap_or_default();
    assert!(
        said.contains("\"Set\", \"Actual\" each hold words of a mode") && said.contains("--mode"),
        "{said}"
    );
    for (mode, expected) in [("Actual", Some(900)), ("none", None)] {
        let told = Options { mode: Some(mode.into()), ..Options::default() };
        let table = of_bytes(&two, &told).expect(mode);
        assert_eq!(table.record.mode.is_some().then(|| on(&table)), expected, "{mode}");
    }
}

#[test]
fn words_that_may_speak_of_quality_are_asked_for() {
    for (name, words, good) in [
        ("State", ["OK", "FAIL"], "ok"),
        ("Zustand", ["Normal", "Fault"], "normal"),
        ("Q", ["V", "I"], "v"),
        ("Q", ["", "*"], "blank"),
        ("", ["", "*"], "blank"),
    ] {
        let own =
            |at: usize, t: String, op, pv| format!("{t},{op},{pv},{}", words[usize::from(at % 10 == 3)]);
        let table = made(&format!("Time,FIC101.OP,FIC101.PV,{name}"), own);
        let said = read(&table).err().unwrap_or_else(|| panic!("{name} {words:?} is read without a word"));
        assert!(said.contains("column 4") && said.contains("--good-values"), "{said}");
        assert!(said.contains(&format!("{:?}", words[1].to_lowercase())), "{said}");
        let told = Options { good_values: Some(good.into()), ..Options::default() };
        let table = of_bytes(&table, &told).unwrap_or_else(|said| panic!("{name} {words:?}: {said}"));
        assert_eq!(bad(&table.record.pv), 120, "{name} {words:?}: {}", table.found.read_as);
    }
    // Marks behind each value, and a column that says it already.
    let each = |at: usize, t: String, op, pv| {
        let mark = if at % 10 == 3 { "*" } else { "" };
        format!("{t},{op},{mark},{pv},{mark}")
    };
    let table = made("Time,FIC101.OP,,FIC101.PV,", each);
    assert!(read(&table).is_err_and(|said| said.contains("--good-values")));
    let told = Options { good_values: Some("blank".into()), ..Options::default() };
    let Record { op, pv, .. } = of_bytes(&table, &told).expect("told").record;
    assert_eq!((bad(&op), bad(&pv)), (120, 120));
    let known = |at: usize, t: String, op, pv| {
        let words = if at % 10 == 3 { "Bad,FAIL" } else { "Good,OK" };
        format!("{t},{op},{pv},{words}")
    };
    let table = read(&made("Time,OP,PV,pv_status,State", known)).expect("it is known already");
    assert_eq!(bad(&table.record.pv), 120);
    // A flow has decimal commas.
    let flow = |at: usize, t: String, op: f64, pv: f64| {
        format!("{t};{op};{pv};{}", [50.5, 50.25][at % 2]).replace('.', ",")
    };
    let flow = |at, t: String, op, pv| flow(at, t.replace('.', "@"), op, pv).replace('@', ".");
    let table = read(&made("Zeit;OP;PV;Q", flow)).expect("a flow");
    assert_eq!(table.record.tags.len(), 1, "{}", table.found.read_as);
    // The state of another device says nothing of these values, nor does a remark.
    for (name, every, words) in [("P205 state", 1, ["OK", "FAIL"]), ("Remark", 50, ["ok", "failed to open"])]
    {
        let own = |at: usize, t: String, op, pv| {
            let word = if at.is_multiple_of(every) { words[usize::from(at.is_multiple_of(200))] } else { "" };
            format!("{t},{op},{pv},{word}")
        };
        let table = read(&made(&format!("Time,FIC101.OP,FIC101.PV,{name}"), own)).expect(name);
        assert_eq!(bad(&table.record.pv), 0, "{name}");
    }
}

/// A long table whose quality of PV is a tag: `said` at a row, or nothing where it did not change.
fn with_tag(name: &str, stacked: bool, said: impl Fn(usize) -> Option<&'static str>) -> Vec<u8> {
    let quality =
        |at: usize, t: &str| said(at).map(|said| format!("{t},{name},{said}\n")).unwrap_or_default();
    let text = |of: fn(usize, &str, f64, f64) -> String| made("", move |at, t, op, pv| of(at, &t, op, pv));
    let values = |_: usize, t: &str, op: f64, pv: f64| format!("{t},FIC101.OP,{op}\n{t},FIC101.PV,{pv}");
    let header = b"Time,Tag,Value\n".to_vec();
    if !stacked {
        let rows = made("Time,Tag,Value", |at, t, op, pv| quality(at, &t) + &values(at, &t, op, pv));
        return rows;
    }
    let of_quality = made("", |at, t, _, _| quality(at, &t).trim_end().to_string());
    let lines = |bytes: Vec<u8>| -> Vec<u8> {
        let text = String::from_utf8(bytes).expect("text");
        text.lines()
            .filter(|line| !line.is_empty())
            .map(|line| format!("{line}\n"))
            .collect::<String>()
            .into_bytes()
    };
    [header, lines(text(values)), lines(of_quality)].concat()
}

#[test]
fn a_quality_that_is_a_tag_of_its_own_is_that_of_its_value() {
    // Bad in rows 100 to 199: at every row, or at the changes alone.
    let each = |at: usize| Some(if (100..200).contains(&at) { "0" } else { "192" });
    let changes = |at: usize| match at {
        0 | 200 => Some("Good"),
        100 => Some("Bad"),
        _ => None,
    };
    for stacked in [false, true] {
        for (what, table) in [
            ("each row", with_tag("FIC101.PV.Quality", stacked, each)),
            ("changes", with_tag("FIC101.PV_Status", stacked, changes)),
        ] {
            let table = read(&table).expect(what);
            let Record { op, pv, tags, .. } = &table.record;
            assert_eq!((bad(pv), bad(op), tags.len()), (100, 0, 0), "{what}: {}", table.found.read_as);
            assert!((100..200).all(|at| !pv[at].quality.is_good()), "{what}");
            assert!(
                table.found.read_as.contains("100 samples not good by FIC101.PV"),
                "{}",
                table.found.read_as
            );
        }
    }
    let strange = with_tag("FIC101.PV.Quality", false, |at| Some(if at % 10 == 3 { "x9" } else { "x7" }));
    let said = read(&strange).err().unwrap_or_default();
    assert!(said.contains("FIC101.PV.Quality") && said.contains("--good-values"), "{said}");
    let told = Options { good_values: Some("x7".into()), ..Options::default() };
    assert_eq!(bad(&of_bytes(&strange, &told).expect("told").record.pv), 120);
}

#[test]
fn a_store_takes_values_with_the_quality_that_stands_below_them() {
    let each = |at: usize| Some(if (100..200).contains(&at) { "0" } else { "192" });
    let table = with_tag("FIC101.PV.Quality", true, each);
    let mut taken: Vec<(String, String, bool)> = Vec::new();
    stream::<TableError>(Source::Bytes(&table), &Options::default(), &mut |tag, sample| {
        taken.push((tag.owner.clone(), tag.name.clone(), sample.quality.is_good()));
        Ok(())
    })
    .expect("read");
    let of = |name: &str| taken.iter().filter(|(owner, own, _)| owner == "FIC101" && own == name).count();
    assert_eq!((of("op"), of("pv"), taken.len()), (1200, 1200, 2400));
    assert_eq!(taken.iter().filter(|(.., good)| !good).count(), 100);
}

#[test]
fn days_and_months_that_change_their_places_are_refused() {
    // The record goes over the end of May: days above twelve stay as they are, and others become months.
    let begin = 1_780_271_000.0;
    let mixed = |t: f64| {
        let civil = jiff::Timestamp::from_second((begin + t) as i64).expect("a time");
        let civil = jiff::tz::Offset::UTC.to_datetime(civil);
        let format = if civil.day() > 12 { "%d/%m/%Y %H:%M:%S" } else { "%m/%d/%Y %H:%M:%S" };
        civil.strftime(format).to_string()
    };
    let Record { op, pv, .. } = example();
    let rows: String =
        op.iter().zip(&pv).map(|(op, pv)| format!("{},{},{}\n", mixed(op.t), op.value, pv.value)).collect();
    let table = format!("Time,OP,PV\n{rows}").into_bytes();
    let said = read(&table).err().unwrap_or_default();
    assert!(said.contains("146 days") && said.contains("--time-format dmy or mdy"), "{said}");
    let told = Options { time_format: Some("dmy".into()), ..Options::default() };
    assert!(of_bytes(&table, &told).is_ok(), "told");
}
