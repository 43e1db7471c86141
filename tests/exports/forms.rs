//! The example in many forms: every one is read back to the same values, times and diagnosis.

use super::dress::{Date, Extra, Form, Names, dressed, table};
use super::{bits, example, of_bytes};
use std::collections::HashMap;
use std::fs;
use std::path::Path;
use stictiond::diagnosis::{Diagnosis, Settings, Verdict, diagnose};
use stictiond::signal::Record;
use stictiond::table::Options;

/// Every separator with every decimal sign and every form of times; names and what stands around come in turn, so that in
/// the end each stands beside each.
fn forms() -> Vec<Form> {
    let mut forms = Vec::new();
    let mut turn = 0;
    for date in Date::ALL {
        for separator in [',', ';', '\t', '|'] {
            for decimal in ['.', ','] {
                let names = Names::ALL[turn % Names::ALL.len()];
                let extra = Extra::ALL[(turn + turn / 8) % Extra::ALL.len()];
                turn += 1;
                // Letters of German names are not in the first lines only.
                forms.push(Form { separator, decimal, date, names, extra });
            }
        }
    }
    forms
}

/// The diagnosis in numbers, to the last bit.
fn said(found: &Diagnosis) -> (Verdict, Option<[u64; 4]>) {
    let numbers =
        found.estimate.as_ref().map(|e| [e.f, e.f_ci95[0], e.f_ci95[1], e.delta_aic].map(f64::to_bits));
    (found.verdict.clone(), numbers)
}

/// Values of OP, PV and SP to the last bit.
fn values(record: &Record) -> Vec<Vec<u64>> {
    let sp = record.sp.iter().map(|sp| sp.iter().map(|sample| sample.value.to_bits()).collect());
    bits(record).into_iter().chain(sp).collect()
}

/// A record by its values and times alone, for there is no need to diagnose it twice.
fn key(record: &Record) -> Vec<u64> {
    let of = |samples: &[stictiond::signal::Sample]| -> Vec<u64> {
        samples.iter().flat_map(|s| [s.t.to_bits(), s.value.to_bits()]).collect()
    };
    [
        of(&record.op),
        of(&record.pv),
        vec![u64::from(record.mode.is_some()), record.op_span.map_or(0, f64::to_bits)],
    ]
    .concat()
}

#[test]
fn the_example_in_every_form_is_the_same_record_and_the_same_diagnosis() {
    let example = example();
    let plain = diagnose(&example, &Settings::default());
    let f = plain.estimate.as_ref().expect("stiction has an estimate").f;
    let mut diagnoses: HashMap<Vec<u64>, (Verdict, Option<[u64; 4]>)> = HashMap::new();
    let mut rows = Vec::new();
    for form in forms() {
        let (bytes, times) = dressed(&example, &form);
        let found = of_bytes(&bytes, &Options::default()).unwrap_or_else(|error| panic!("{form:?}: {error}"));
        let record = found.record;
        let mut expected = values(&example);
        assert_eq!(expected.len(), 3, "the example has a set point");
        if form.extra == Extra::BadStamp {
            for values in &mut expected {
                values.remove(700);
            }
        }
        assert!(values(&record) == expected, "{form:?}: other values");
        let is_automatic = record.mode.as_ref().map(|mode| mode.iter().all(|sample| sample.value == 1.0));
        assert_eq!(is_automatic, (form.extra == Extra::Mode).then_some(true), "{form:?}");
        assert_eq!(record.op.len(), times.len(), "{form:?}");
        // A time as text is exact to the millisecond, a serial day to what nine digits hold.
        let off = record.op.iter().zip(&times).map(|(s, t)| (s.t - t).abs()).fold(0.0, f64::max);
        assert!(off < 2e-6, "{form:?}: times are off by {off} s");
        let key = key(&record);
        let said = diagnoses.entry(key).or_insert_with(|| said(&diagnose(&record, &Settings::default())));
        assert_eq!(said.0, Verdict::Stiction, "{form:?}");
        let own = said.1.map(|numbers| f64::from_bits(numbers[0])).expect("stiction has an estimate");
        // Whole seconds move each stamp by up to half a second of a period of two.
        assert!((own - f).abs() < if form.date.is_whole() { 0.05 } else { 0.02 }, "{form:?}: {own} and {f}");
        rows.push((form, found.found.read_as));
    }
    assert!(rows.len() >= 60, "{}", rows.len());
    // Where values and times are the same to the bit, so is the diagnosis: there are far fewer of them than forms.
    assert!(diagnoses.len() * 2 < rows.len(), "{} of {}", diagnoses.len(), rows.len());
    documented(&table(&rows));
}

/// The table stands in the documents as this test makes it.
fn documented(table: &str) {
    const BEGIN: &str = "<!-- forms: made by `STICTIOND_WRITE_DOCS=1 cargo test --test exports forms` -->\n";
    const END: &str = "<!-- end of forms -->\n";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/tables.md");
    let text = fs::read_to_string(&path).expect("docs/tables.md");
    let (before, rest) = text.split_once(BEGIN).expect("where the table begins");
    let (own, after) = rest.split_once(END).expect("where the table ends");
    if std::env::var_os("STICTIOND_WRITE_DOCS").is_some() {
        fs::write(&path, format!("{before}{BEGIN}{table}{END}{after}")).expect("writable");
    } else {
        let hint = "docs/tables.md is not what this test makes: STICTIOND_WRITE_DOCS=1 cargo test --test exports forms";
        assert!(own == table, "{hint}");
    }
}
