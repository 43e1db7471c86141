use super::super::embedded::tests::Folder;
use super::*;
use crate::signal::Quality;
use crate::store::{Config, DiagnosisRow, Row, Store, TransitionRow, pack};
use crate::table::{Options, Source, TableError, stream};
use proptest::prelude::*;

/// Two loops, some bad samples, numbers that a careless writer rounds.
fn filled(folder: &Folder) -> Store {
    let mut store = Store::open(&Config::new(&folder.0)).expect("opens");
    let tag = |own: &str, tag: &str| {
        let (source, unit) = ("modbus 10.0.0.1, \"unit 1\"".to_string(), "%".to_string());
        Arc::new(TagName { control_loop: own.into(), tag: tag.into(), source, unit })
    };
    let samples = |k: f64| {
        (0..500i32)
            .map(|i| {
                let (t, value) = (1_763_700_000.0 + f64::from(i) + 0.1, k * f64::from(i) / 3.0);
                let quality = Quality::ALL[if i % 50 == 7 { i as usize % 7 } else { 0 }];
                let none = quality == Quality::ALL[3];
                Sample { t, value: if none { f64::NAN } else { value }, quality }
            })
            .collect()
    };
    let series = vec![
        Series { tag: tag("A", "op"), samples: samples(1.0) },
        Series { tag: tag("A", "pv"), samples: samples(-1e-7) },
        Series { tag: tag("B", "a, \"b\"\nü"), samples: samples(1e9) },
    ];
    let rows = vec![
        Row::Diagnosis(DiagnosisRow {
            control_loop: "A".into(),
            finished: 5.0,
            f: Some(0.25),
            report: pack("{\"f\":0.25}"),
            ..DiagnosisRow::default()
        }),
        Row::Transition(TransitionRow {
            control_loop: "B".into(),
            at: 6.0,
            before: "normal".into(),
            after: "shelved".into(),
            by: Some("eve".into()),
            ..TransitionRow::default()
        }),
    ];
    store.write(&Batch { series, rows }).expect("writes");
    store
}

/// Stamp and value to the last bit, and the quality.
type Exact = (u64, u64, Quality);

fn everything(folder: &Folder) -> Vec<(TagName, Vec<Exact>)> {
    let mut reader = Reader::open(&folder.0).expect("opens");
    let tags = reader.tags().expect("reads");
    let mut found: Vec<_> = tags.into_iter().map(|tag| (tag.id, tag.name, Vec::new())).collect();
    let mut from = 0;
    while let Some(start) = reader.next_start(from).expect("reads") {
        for (id, samples) in reader.chunk(start, None).expect("reads") {
            let own = found.iter_mut().find(|(own, ..)| *own == id).expect("a tag");
            own.2.extend(samples.iter().map(|s| (s.t.to_bits(), s.value.to_bits(), s.quality)));
        }
        from = start + 1;
    }
    let mut found: Vec<_> = found.into_iter().map(|(_, name, samples)| (name, samples)).collect();
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

fn no_source(_: &str, _: &str) -> Option<(String, String)> {
    None
}

/// A file as `stictiond store import` takes it.
fn import(
    file: &Path,
    source: Sources<'_>,
    take: &mut dyn FnMut(&Batch) -> Result<(), StoreError>,
) -> Result<Gathered, ArchiveError> {
    let mut import = Import::new(source, take);
    stream(Source::File(file), &Options::default(), &mut |tag, sample| {
        let place = Place {
            control_loop: &tag.owner,
            tag: &tag.name,
            source: tag.source.as_deref(),
            unit: tag.unit.as_deref(),
        };
        import.sample(&place, sample).map_err(Refused::from)
    })?;
    import.end()
}

/// Either of the two who may refuse.
struct Refused(ArchiveError);

impl From<TableError> for Refused {
    fn from(error: TableError) -> Self {
        Self(ArchiveError::Format(error.to_string()))
    }
}

impl From<ArchiveError> for Refused {
    fn from(error: ArchiveError) -> Self {
        Self(error)
    }
}

impl From<Refused> for ArchiveError {
    fn from(Refused(error): Refused) -> Self {
        error
    }
}

#[test]
fn what_is_exported_and_imported_is_the_same_to_the_last_bit_and_never_twice() {
    for format in [Format::Csv, Format::Parquet] {
        let (old, new) = (Folder::new(), Folder::new());
        drop(filled(&old));
        let file = old.0.join("out");
        let mut reader = Reader::open(&old.0).expect("opens");
        let rows = export(&mut reader, Kind::Samples, &Choice::default(), format, &file).expect("exports");
        assert_eq!(rows, 1500);
        let again = export(&mut reader, Kind::Samples, &Choice::default(), format, &file);
        assert!(matches!(again, Err(ArchiveError::Io(_))), "a file that is there is left alone");
        let mut store = Store::open(&Config::new(&new.0)).expect("opens");
        for _ in 0..2 {
            let read = import(&file, &no_source, &mut |batch| store.insert(batch)).expect("reads");
            assert_eq!(read, Gathered { handed_on: 1500, undated: 0 });
        }
        assert_eq!(everything(&new), everything(&old), "{format:?}");
    }
}

#[test]
fn loops_and_times_are_chosen_and_every_kind_has_its_table() {
    let folder = Folder::new();
    drop(filled(&folder));
    let mut reader = Reader::open(&folder.0).expect("opens");
    let choice = Choice { loops: vec!["A".into()], from: Some(1_763_700_100.0), to: Some(1_763_700_199.5) };
    let mut exported = |kind, format, choice: &Choice| {
        let file = folder.0.join(format!("{kind:?}-{format:?}"));
        let rows = export(&mut reader, kind, choice, format, &file).expect("exports");
        (rows, fs::read(&file).expect("can be read"))
    };
    assert_eq!(exported(Kind::Samples, Format::Csv, &choice).0, 2 * 100);
    assert_eq!(exported(Kind::Trends, Format::Csv, &choice).0, 0);
    let endless = Choice { to: Some(1e300), ..Choice::default() };
    assert_eq!(exported(Kind::Trends, Format::Parquet, &endless).0, 0, "a time that no whole number holds");
    let all = Choice::default();
    let (rows, text) = exported(Kind::Diagnoses, Format::Csv, &all);
    let text = String::from_utf8(text).expect("text");
    assert!(rows == 1 && text.contains("0.25") && text.contains("{\"\"f\"\":0.25}"), "{text}");
    let (rows, text) = exported(Kind::Alarms, Format::Csv, &all);
    assert_eq!(rows, 1);
    assert!(String::from_utf8(text).expect("text").ends_with("B,6,normal,shelved,,eve,,,,\n"));
    for kind in [Kind::Diagnoses, Kind::Alarms] {
        assert!(exported(kind, Format::Parquet, &all).1.starts_with(b"PAR1"));
    }
}

#[test]
fn a_file_that_is_none_is_refused() {
    let folder = Folder::new();
    fs::create_dir_all(&folder.0).expect("writable");
    let file = folder.0.join("in");
    let refused = |text: &str| {
        fs::write(&file, text).expect("writable");
        import(&file, &no_source, &mut |_| Ok(())).expect_err(text).to_string()
    };
    let rows = "loop,tag,t,value,quality\nA,op,1763700000,2,good\n";
    for (text, said) in [
        (String::new(), "empty file"),
        (format!("{rows}A,op,x,2,good\n"), "line 3, column 3 (t): \"x\" is no time"),
        (format!("{rows}A,op,,2,good\n"), "line 3, column 3 (t): the cell is empty"),
        ("loop,tag,t,value,quality\nA,op,-3,2,good\n".into(), "times must be seconds since 1970"),
        (format!("{rows},op,1763700001,2,good\n"), "say which with --loop"),
        (format!("loop,tag,t,value\n\"{}", "x".repeat(3 << 20)), "a quote left open"),
        ("PAR1 and no more".into(), "Parquet: "),
    ] {
        let error = refused(&text);
        assert!(error.contains(said), "{error}");
    }
}

#[test]
fn a_tag_without_a_source_takes_the_one_it_is_read_from() {
    let folder = Folder::new();
    let mut store = Store::open(&Config::new(&folder.0)).expect("opens");
    let file = folder.0.join("in.csv");
    let rows = "T,Value,tag,LOOP\n1763700005,1.5,op,A\n1763700006,,op,A\n1763700005,2.5,op,B\n";
    fs::write(&file, rows).expect("writable");
    let source = |own: &str, _: &str| (own == "A").then(|| ("register 7".to_string(), "%".to_string()));
    let read = import(&file, &source, &mut |batch| store.insert(batch)).expect("reads");
    assert_eq!(read, Gathered { handed_on: 3, undated: 0 });
    let found = everything(&folder);
    assert_eq!((found[0].0.source.as_str(), found[1].0.source.as_str()), ("register 7", "import"));
    assert_eq!(found[0].1[1].2.as_str(), "bad:not_a_number", "a blank value is a sample that has none");
    assert_eq!(Format::of(Path::new("a.CSV")), Some(Format::Csv));
    assert_eq!(Format::of(Path::new("a.txt")), None);
}

/// A sample without a date is left out and counted, and a table that has no other is none.
#[test]
fn samples_without_a_date_are_refused() {
    let folder = Folder::new();
    fs::create_dir_all(&folder.0).expect("writable");
    let file = folder.0.join("in.csv");
    let clock = |k: u32| format!("13:{:02}:{:02}", k / 60, k % 60);
    let since_start = |k: u32| (2 * k).to_string();
    let times: [(&str, &dyn Fn(u32) -> String); 2] = [("clock", &clock), ("since the start", &since_start)];
    for (what, time) in times {
        let rows: String = (0..200).map(|k| format!("{},A,op,{}\n", time(k), 50 + k % 7)).collect();
        fs::write(&file, format!("t,loop,tag,value\n{rows}")).expect("writable");
        let mut taken = 0;
        let read = import(&file, &no_source, &mut |batch| {
            taken += batch.series.len();
            Ok(())
        });
        let error = read.expect_err(what).to_string();
        assert!(error.contains("has a date") && error.contains("--time-unit"), "{what}: {error}");
        assert_eq!(taken, 0, "{what}: nothing is handed on");
    }
    // A device had sent two samples before its clock was set.
    let mut handed_on = Vec::new();
    let mut keep = |batch: &Batch| {
        handed_on.extend(batch.series.iter().flat_map(|series| series.samples.clone()));
        Ok::<_, StoreError>(())
    };
    let mut gathering = Import::new(&no_source, &mut keep);
    let place = Place { control_loop: "A", tag: "op", source: None, unit: None };
    for t in [0.0, 86_400.0, 1_763_700_000.0] {
        gathering.sample(&place, Sample::good(t, 50.0)).expect("it belongs somewhere");
    }
    assert_eq!(gathering.end().expect("one has a date"), Gathered { handed_on: 1, undated: 2 });
    assert_eq!(handed_on, [Sample::good(1_763_700_000.0, 50.0)]);
}

proptest! {
    #[test]
    fn rubbish_is_refused_or_read_without_a_panic(text in "[loptagvue,\"\n0-9.eE\\-]{0,300}") {
        let folder = Folder::new();
        fs::create_dir_all(&folder.0).expect("writable");
        let file = folder.0.join("in.csv");
        fs::write(&file, format!("loop,tag,t,value\n{text}")).expect("writable");
        let _ = import(&file, &no_source, &mut |_| Ok(()));
    }
}
