//! Random tables of two loops, of numbers with two signs, and of one tag a row: what is read is what was written, or it is refused.

use super::of_bytes;
use proptest::prelude::*;
use stictiond::signal::Sample;
use stictiond::table::{Options, Table};

/// A loop: levels of OP and PV, how fast they swing, and where they begin.
#[derive(Clone, Copy, Debug)]
struct Swing {
    level: [f64; 2],
    step: f64,
    phase: f64,
}

impl Swing {
    /// OP and PV at a step, as they are written.
    fn cells(&self, k: usize) -> [String; 2] {
        let angle = self.step * k as f64 + self.phase;
        let [op, pv] = self.level;
        [op + 4.0 * angle.sin(), pv + 3.0 * (angle - 0.6).sin()].map(|value| format!("{value:.2}"))
    }
}

/// Loops around these levels.
fn swings(level: f64) -> impl Strategy<Value = Swing> {
    (0.0..5.0, 0.05..0.3, 0.0..6.0).prop_map(move |(more, step, phase)| Swing {
        level: [level + more, 2.0 * level - more],
        step,
        phase,
    })
}

fn pick<T: Copy + std::fmt::Debug>(all: &'static [T]) -> impl Strategy<Value = T> {
    (0..all.len()).prop_map(|at| all[at])
}

/// Words beside one loop, in turn.
const BESIDE: [&[&str]; 5] = [&["0", "1"], &["1", "2", "3", "4"], &["feed"], &["early", "late"], &["5", "6"]];

/// How the rows of two loops stand.
#[derive(Clone, Copy, Debug)]
enum Order {
    InTurn,
    OneBelowTheOther,
}

/// A row: its time, its word, OP and PV.
type Row = (String, &'static str, [String; 2]);

fn row(swing: &Swing, k: usize, later: f64, word: &'static str) -> Row {
    (format!("{:.1}", 1_780_293_600.0 + 2.0 * k as f64 + later), word, swing.cells(k))
}

/// The rows under a header, with a column for each tag or a row for each sample.
fn table(name: &str, rows: &[Row], is_long: bool) -> String {
    let wide = |(t, word, [op, pv]): &Row| format!("{t};{word};{op};{pv}\n");
    let long = |(t, word, [op, pv]): &Row| format!("{t};op;{op};{word}\n{t};pv;{pv};{word}\n");
    match is_long {
        true => format!("t;tag;value;{name}\n{}", rows.iter().map(long).collect::<String>()),
        false => format!("t;{name};op;pv\n{}", rows.iter().map(wide).collect::<String>()),
    }
}

fn read(text: &str, of_loop: Option<&str>) -> Result<Table, String> {
    of_bytes(text.as_bytes(), &Options { of_loop: of_loop.map(str::to_string), ..Options::default() })
}

fn told(text: &str, decimal: char) -> Result<Table, String> {
    of_bytes(text.as_bytes(), &Options { decimal: Some(decimal.to_string()), ..Options::default() })
}

fn same(read: &[Sample], written: &[String]) -> Result<(), TestCaseError> {
    let written: Vec<f64> = written.iter().map(|cell| cell.parse().expect("a number")).collect();
    prop_assert_eq!(read.iter().map(|sample| sample.value).collect::<Vec<_>>(), written);
    Ok(())
}

/// OP and PV of a table are those of a loop.
fn is_of(table: &Table, swing: &Swing, rows: usize) -> Result<(), TestCaseError> {
    let [op, pv] = [0, 1].map(|at| (0..rows).map(|k| swing.cells(k)[at].clone()).collect::<Vec<_>>());
    same(&table.record.op, &op)?;
    same(&table.record.pv, &pv)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// The rows of two loops are never one record; those of each are read by its name.
    #[test]
    fn the_rows_of_two_loops_are_refused_unless_one_is_wanted(
        loops in (swings(30.0), swings(60.0)),
        rows in 30..90usize,
        name in pick(&["Train", "Unit", "Id", "Node", "x", ""]),
        words in pick(&[["A", "B"], ["1", "2"], ["north", "south"], ["101", "102"], ["K1", "K2"]]),
        later in pick(&[0.0, 0.3, 1.0, 1.6]),
        order in pick(&[Order::InTurn, Order::OneBelowTheOther]),
        is_long in any::<bool>(),
    ) {
        let of = &|second: bool, k: usize| match second {
            false => row(&loops.0, k, 0.0, words[0]),
            true => row(&loops.1, k, later, words[1]),
        };
        let rows_of: Vec<Row> = match order {
            Order::InTurn => (0..rows).flat_map(|k| [of(false, k), of(true, k)]).collect(),
            Order::OneBelowTheOther => [false, true].into_iter().flat_map(|own| (0..rows).map(move |k| of(own, k))).collect(),
        };
        let text = table(name, &rows_of, is_long);
        for of_loop in [None, Some("other")] {
            let said = match read(&text, of_loop) {
                Ok(table) => return Err(TestCaseError::fail(format!("read as {}", table.found.read_as))),
                Err(said) => said,
            };
            let named = words.iter().all(|word| said.contains(&format!("{word:?}")));
            prop_assert!(named && said.contains("--loop"), "{}", said);
        }
        for (swing, word) in [(&loops.0, words[0]), (&loops.1, words[1])] {
            let table = read(&text, Some(word)).map_err(TestCaseError::fail)?;
            is_of(&table, swing, rows)?;
        }
    }

    /// A bit, a counter, a shift or a description beside one loop is no second loop.
    #[test]
    fn what_stands_beside_one_loop_does_not_divide_it(
        swing in swings(45.0),
        rows in 30..90usize,
        words in pick(&BESIDE),
        is_long in any::<bool>(),
    ) {
        // Words of a shift change seldom, and counters with every row.
        let every = if words[0] == "early" { 20 } else { 1 };
        let rows_of: Vec<Row> = (0..rows).map(|k| row(&swing, k, 0.0, words[k / every % words.len()])).collect();
        let table = read(&table("beside", &rows_of, is_long), None).map_err(TestCaseError::fail)?;
        is_of(&table, &swing, rows)?;
    }

    /// One cell with the other sign before three digits is never a thousand times larger without a word.
    #[test]
    fn a_cell_with_the_other_sign_is_refused_unless_the_sign_is_told(
        swing in swings(45.0),
        rows in 10..90usize,
        odd in prop::collection::vec((any::<prop::sample::Index>(), any::<bool>()), 1..4),
        decimal in pick(&['.', ',']),
    ) {
        let other = if decimal == '.' { ',' } else { '.' };
        let mut rows_of: Vec<Row> = (0..rows).map(|k| row(&swing, k, 0.0, "feed")).collect();
        let written = rows_of.clone();
        for (_, _, cells) in &mut rows_of {
            *cells = cells.clone().map(|cell| cell.replace('.', &decimal.to_string()));
        }
        let mut places: Vec<(usize, usize)> =
            odd.iter().map(|(at, in_op)| (at.index(rows), usize::from(!in_op))).collect();
        places.sort_unstable();
        places.dedup();
        for (at, column) in &places {
            // One digit more, and the other sign: `51,23` becomes `51.237`.
            rows_of[*at].2[*column] = written[*at].2[*column].replace('.', &other.to_string()) + "7";
        }
        // The times have the decimal sign of the table.
        rows_of.iter_mut().for_each(|(t, ..)| *t = t.replace('.', &decimal.to_string()));
        let text = table("beside", &rows_of, false);
        let said = match read(&text, None) {
            Ok(table) => return Err(TestCaseError::fail(format!("read as {}", table.found.read_as))),
            Err(said) => said,
        };
        prop_assert!(said.contains("before three digits") && said.contains("--decimal"), "{}", said);
        let table = told(&text, decimal).map_err(TestCaseError::fail)?;
        for (series, column) in [(&table.record.op, 0), (&table.record.pv, 1)] {
            for (k, sample) in series.iter().enumerate() {
                let cell: f64 = written[k].2[column].parse().expect("a number");
                let meant = if places.contains(&(k, column)) { (cell * 1000.0 + 7.0).round() } else { cell };
                prop_assert_eq!(sample.value, meant, "row {}", k);
            }
        }
    }
}
