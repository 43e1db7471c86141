use super::super::{Options, Source, read};
use crate::signal::Record;

/// OP and PV of a loop at a step.
fn values(of: usize, k: usize) -> (f64, f64) {
    let (level, phase) = [(50.0, 0.0), (31.0, 1.3)][of];
    let angle = k as f64 / 9.0 + phase;
    (level + 5.0 * angle.sin(), 2.0 * level + 8.0 * (angle - 0.7).sin())
}

/// Seconds since 1970, a word, and the values of one of two loops at a step.
type Row = (f64, String, (f64, f64));

fn row(of: usize, k: usize, offset: f64, word: &str) -> Row {
    (1_780_293_600.0 + 2.0 * k as f64 + offset, word.to_string(), values(of, k))
}

/// Rows of two loops in turn, those of the second so much later.
fn in_turn(words: [&str; 2], offset: f64) -> Vec<Row> {
    (0..100).flat_map(|k| [row(0, k, 0.0, words[0]), row(1, k, offset, words[1])]).collect()
}

/// Rows of one loop with words beside them.
fn of_one(word: impl Fn(usize) -> String) -> Vec<Row> {
    (0..200).map(|k| row(0, k, 0.0, &word(k))).collect()
}

/// Words in turn, each for so many rows.
fn every(n: usize, words: &'static [&'static str]) -> impl Fn(usize) -> String {
    move |k| words[k / n % words.len()].to_string()
}

fn wide(name: &str, rows: &[Row]) -> String {
    let one = |(t, word, (op, pv)): &Row| format!("{t:.1},{word},{op:.2},{pv:.2}\n");
    format!("t,{name},op,pv\n{}", rows.iter().map(one).collect::<String>())
}

fn long(name: &str, rows: &[Row]) -> String {
    let one = |(t, word, (op, pv)): &Row| format!("{t:.1},op,{op:.2},{word}\n{t:.1},pv,{pv:.2},{word}\n");
    format!("t,tag,value,{name}\n{}", rows.iter().map(one).collect::<String>())
}

fn record(text: &str, of_loop: Option<&str>) -> Result<Record, String> {
    let options = Options { of_loop: of_loop.map(str::to_string), ..Options::default() };
    read(Source::Bytes(text.as_bytes()), &options)
        .map(|table| table.record)
        .map_err(|error| error.to_string())
}

/// Whether a record has the values of one loop, each once.
fn is_of(record: &Record, of: usize) -> bool {
    let two = |value: f64| format!("{value:.2}").parse::<f64>().expect("a number");
    let own = |k: usize| (two(values(of, k).0), two(values(of, k).1));
    let read = record.op.iter().zip(&record.pv).map(|(op, pv)| (op.value, pv.value));
    record.op.len() == 100 && read.eq((0..100).map(own))
}

#[test]
fn rows_of_two_loops_are_refused_and_those_of_the_wanted_one_are_read() {
    let all_words = [["A", "B"], ["1", "2"], ["North", "South"], ["101A", "101B"], ["FIC101", "FIC102"]];
    for (at, words) in all_words.into_iter().enumerate() {
        for (under, name) in ["Train", "Id", "x", ""].into_iter().enumerate() {
            // Each offset with each pair of words, and with each name.
            let offset = [0.0, 0.7, 1.0][(at + under) % 3];
            let rows = in_turn(words, offset);
            let mut stacked = rows.clone();
            stacked.sort_by_key(|(_, word, _)| word == words[1]);
            for rows in [&rows, &stacked] {
                for text in [wide(name, rows), long(name, rows)] {
                    let what = format!("{words:?} under {name:?}, {offset} s later");
                    let said = record(&text, None).expect_err(&what);
                    let both = format!(
                        ": {:?}, {:?}; keep those of one, or say which with --loop",
                        words[0], words[1]
                    );
                    assert!(said.contains(&both), "{what}: {said}");
                    assert!(name.is_empty() || said.contains(&format!("several {name:?}")), "{what}: {said}");
                    let said = record(&text, Some("other")).expect_err(&what);
                    assert!(said.contains("and none is \"other\" (--loop)"), "{what}: {said}");
                    for (of, word) in words.iter().enumerate() {
                        let own = record(&text, Some(word)).unwrap_or_else(|said| panic!("{what}: {said}"));
                        assert!(is_of(&own, of), "{what}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_loop_with_few_samples_is_one_too() {
    for every in [10, 25] {
        let seldom = |k: usize| {
            let second = k.is_multiple_of(every).then(|| row(1, k, 0.9, "2"));
            [row(0, k, 0.0, "1")].into_iter().chain(second)
        };
        let rows: Vec<Row> = (0..300).flat_map(seldom).collect();
        let said = record(&wide("Slave", &rows), None).expect_err("two loops");
        assert!(said.contains("the rows are of several \"Slave\": \"1\", \"2\""), "{every}: {said}");
    }
}

#[test]
fn a_long_table_may_call_the_column_a_unit() {
    let rows = in_turn(["A", "B"], 1.0);
    let said = record(&long("Unit", &rows), None).expect_err("two units of the plant");
    assert!(said.contains("column 4: the rows are of several \"Unit\": \"A\", \"B\""), "{said}");
}

#[test]
fn what_changes_beside_one_loop_names_no_loops() {
    let rows: [(&str, Vec<Row>); 11] = [
        ("a bit that turns with every row", of_one(every(1, &["0", "1"]))),
        ("the same in words", of_one(every(1, &["tick", "tock"]))),
        ("a counter", of_one(|k| (k % 8).to_string())),
        ("the seconds of a minute", of_one(|k| (2 * k % 60).to_string())),
        ("alarms", of_one(every(1, &["IOP", "HI", "NR"]))),
        ("a state", of_one(every(40, &["running", "waiting"]))),
        ("a set point", of_one(every(50, &["50", "52"]))),
        ("a recipe", of_one(every(60, &["red", "blue"]))),
        ("a level in whole per cent", of_one(|k| format!("{:.0}", 50.0 + 9.0 * (k as f64 / 5.0).sin()))),
        ("one word", of_one(every(1, &["A"]))),
        ("a name for each row", of_one(|k| format!("row {k}"))),
    ];
    for (what, rows) in rows {
        for text in [wide("x", &rows), long("x", &rows)] {
            let own = record(&text, None).unwrap_or_else(|said| panic!("{what}: {said}"));
            assert_eq!(own.op.len(), 200, "{what}");
        }
    }
    // Stamps that were cut to 4 s, two rows each.
    let cut: Vec<Row> = of_one(every(1, &["0", "1"]))
        .into_iter()
        .map(|(t, word, values)| ((t / 4.0).floor() * 4.0, word, values))
        .collect();
    assert!(record(&wide("x", &cut), None).is_ok());
    // A quality that nobody knows: where it is 0, PV is none.
    let spoilt: Vec<Row> = of_one(every(1, &["7", "7", "9"]))
        .into_iter()
        .map(|(t, word, (op, pv))| (t, word.clone(), (op, if word == "9" { 999.0 } else { pv })))
        .collect();
    assert!(record(&wide("x", &spoilt), None).is_ok());
    // Each tag has a word of its own.
    let of_tags: String =
        (0..50).map(|k| format!("{k},op,{}.5,feed\n{k},pv,{}.25,flow\n", 40 + k % 7, 20 + k % 5)).collect();
    assert!(record(&format!("t,tag,value,Description\n{of_tags}"), None).is_ok());
}
