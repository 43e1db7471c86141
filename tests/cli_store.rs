//! `stictiond store` as a shell meets it: what it prints, and its exit codes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use stictiond::signal::Sample;
use stictiond::store::{Batch, Config, Series, Store, TagName, codec};

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("writable");
    path
}

/// Exit code, stdout, stderr; stderr is at most one line.
fn run(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_stictiond")).arg("store").args(arguments).output().expect("runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    let (out, err) = (text(output.stdout), text(output.stderr));
    assert!(err.lines().count() <= 1, "{err}");
    (output.status.code(), out, err)
}

/// 2025-11-21T04:40:00Z.
const START: f64 = 1_763_700_000.0;

fn filled(at: &Path) {
    let mut store = Store::open(&Config::new(at)).expect("opens");
    let name = TagName { control_loop: "A".into(), tag: "op".into(), source: "s".into(), unit: "%".into() };
    let samples = (0..300).map(|i| Sample::good(START + f64::from(i), f64::from(i))).collect();
    store
        .insert(&Batch { series: vec![Series { tag: Arc::new(name), samples }], rows: Vec::new() })
        .expect("writes");
}

#[test]
fn what_is_exported_can_be_imported_and_checked() {
    let folder = folder("cli-store");
    let path = |name: &str| folder.join(name).display().to_string();
    let (old, new) = (path("old"), path("new"));
    filled(Path::new(&old));
    let again = " kept, 100 left out, as their tag has a sample at the same time";
    for (file, kept) in
        [(path("out.csv"), "100 samples".to_string()), (path("out.parquet"), format!("0 samples{again}"))]
    {
        let (code, out, err) =
            run(&["export", &old, &file, "--from", "1763700100", "--to-time", "2025-11-21T04:43:19Z"]);
        assert_eq!((code, out, err), (Some(0), format!("{file}: 100 rows\n"), String::new()));
        let (code, _, err) = run(&["export", &old, &file]);
        assert_eq!((code, err), (Some(2), format!("stictiond: {file}: the file is there already\n")));
        let (code, out, _) = run(&["import", &new, &file]);
        assert!(code == Some(0) && out.starts_with(&format!("{file}: {kept}, read as: ")), "{out}");
    }
    let (code, out, _) = run(&["check", &new]);
    assert_eq!(code, Some(0));
    assert!(
        out.starts_with(&format!("{new}: good, version ")) && out.contains("samples     100 from 1 tag,"),
        "{out}"
    );

    // One bit within the bytes of the first chunk, wherever it lies.
    let first: Vec<Sample> = (0..60).map(|i| Sample::good(START + f64::from(i), f64::from(i))).collect();
    let blob = codec::encode(&first);
    let database = Path::new(&old).join("store.db");
    let mut bytes = fs::read(&database).expect("can be read");
    let at =
        bytes.windows(blob.len()).position(|window| window == blob).expect("the chunk is there as it is");
    bytes[at + blob.len() / 2] ^= 4;
    fs::write(&database, bytes).expect("writable");
    let (code, out, err) = run(&["check", &old]);
    assert_eq!((code, err), (Some(1), format!("stictiond: {old}: 1 things are damaged\n")), "{out}");
    assert!(out.contains(" pages are not what was written") && out.contains("1 blobs damaged"), "{out}");
    let (code, _, err) = run(&["export", &old, &path("rest.csv")]);
    assert!(
        code == Some(1) && err.contains("a store that is damaged") && err.contains("1 blobs damaged"),
        "{err}"
    );
    let rest = fs::read_to_string(path("rest.csv")).expect("what is left is there");
    assert!(rest.lines().count() > 1, "{rest}");
    let (code, out, err) = run(&["check", "--repair", &old]);
    assert!(code == Some(0) && out.contains("repaired") && out.contains("damaged-1"), "{out}{err}");
    let (code, out, err) = run(&["check", &old]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    fs::remove_dir_all(&folder).expect("writable");
}

/// Its database is whole: so nothing is salvaged and no file is put aside.
#[test]
fn a_second_copy_that_is_emptied_is_told_and_written_anew() {
    let folder = folder("cli-store-copy");
    let own = folder.join("own").display().to_string();
    filled(Path::new(&own));
    let copy = Path::new(&own).join("states.log");
    fs::write(&copy, "").expect("writable");
    let (code, out, err) = run(&["check", &own]);
    assert_eq!((code, err), (Some(1), format!("stictiond: {own}: 1 things are damaged\n")), "{out}");
    assert!(out.contains("damaged     states.log") && out.contains("1 of 1 records cannot be read"), "{out}");
    let store = Store::open(&Config::new(&own)).expect("opens");
    fs::write(&copy, "").expect("writable");
    let (code, _, err) = run(&["check", "--repair", &own]);
    assert!(code == Some(1) && err.contains("in use by another process"), "{err}");
    drop(store);
    let (code, out, err) = run(&["check", "--repair", &own]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    assert!(out.contains("what lies beside the database is made anew"), "{out}");
    let (code, out, _) = run(&["check", &own]);
    assert!(code == Some(0) && out.starts_with(&format!("{own}: good, version ")), "{out}");
    assert!(!Path::new(&own).join("damaged-1").exists());
    fs::remove_dir_all(&folder).expect("writable");
}

#[test]
fn bad_arguments_end_with_2_and_a_store_in_use_with_1() {
    let folder = folder("cli-store-bad");
    let path = |name: &str| folder.join(name).display().to_string();
    let (nowhere, own) = (path("nowhere"), path("own"));
    filled(Path::new(&own));
    fs::write(path("bad.csv"), "a,b\n1,2\n").expect("writable");
    for (arguments, code, said) in [
        (vec!["check", &nowhere], 2, "there is no store"),
        (vec!["export", &own, &path("out.txt")], 2, "must end in .csv or .parquet"),
        (vec!["export", &own, &path("out.csv"), "--from", "5", "--to-time", "4"], 2, "--from is later"),
        (
            vec!["export", &own, &path("out.csv"), "--loop", "A", "--loop", "B"],
            2,
            "no loop \"B\" in this store",
        ),
        (vec!["import", &own, &path("bad.csv")], 2, "no column t, op, pv"),
        (vec!["import", &path("new"), "/dev/null"], 2, "is a pipe or a device, and a table is read twice"),
        (vec!["import", &own, &path("gone.csv")], 2, "gone.csv"),
    ] {
        let (ended, out, err) = run(&arguments);
        assert_eq!((ended, out.as_str()), (Some(code), ""), "{err}");
        assert!(err.starts_with("stictiond: ") && err.contains(said), "{err}");
    }
    assert!(!Path::new(&path("out.csv")).exists() && !Path::new(&path("new")).exists());
    let store = Store::open(&Config::new(&own)).expect("opens");
    let (code, _, err) = run(&["import", &own, &path("bad.csv")]);
    assert!(code == Some(1) && err.contains("in use by another process"), "{err}");
    assert_eq!(run(&["check", &own]).0, Some(0), "reading goes on beside a writer");
    drop(store);
    fs::remove_dir_all(&folder).expect("writable");
}

/// History from elsewhere fills the rings of the loops that read the same tags.
#[test]
fn with_a_configuration_imported_samples_are_those_of_its_loops() {
    let folder = folder("cli-store-config");
    let (own, config, file) = (folder.join("own"), folder.join("c.toml"), folder.join("in.csv"));
    fs::write(
        &config,
        "[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n[[loop]]\nid = 'A'\n\
         [loop.op]\ndevice = 'd'\nregister = 'input'\naddress = 0\ntype = 'f32'\nunit = '%'\n\
         [loop.pv]\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n",
    )
    .expect("writable");
    fs::write(&file, "loop,tag,t,value\nA,op,1763700000,2\nX,op,1763700000,2\n").expect("writable");
    let text = |path: &Path| path.display().to_string();
    let (code, _, err) = run(&["import", &text(&own), &text(&file), "--config", &text(&config)]);
    assert_eq!(code, Some(0), "{err}");
    let tags = stictiond::store::Reader::open(&own).and_then(|reader| reader.tags()).expect("can be read");
    assert_eq!(tags[0].name.source, "modbus 127.0.0.1:9 unit 1 input 0 from 0 f32 ABCD");
    assert_eq!((tags[0].name.unit.as_str(), tags[1].name.source.as_str()), ("%", "import"));
    fs::remove_dir_all(&folder).expect("writable");
}

/// A record of one loop whose times are written so.
fn table(time: &dyn Fn(u32) -> String) -> String {
    let row = |k: u32| format!("{},{},{}\n", time(k), 50 + k % 7, 20 + k % 5);
    "time,op,pv\n".to_string() + &(0..200).map(row).collect::<String>()
}

#[test]
fn numbers_that_count_from_1970_or_as_spreadsheets_do_are_imported_at_their_time() {
    let folder = folder("cli-store-epochs");
    let text = |path: &Path| path.display().to_string();
    let seconds = |k: u32| 1_763_700_000 + u64::from(k);
    let serial = |k: u32| format!("{:.9}", seconds(k) as f64 / 86_400.0 + 25_569.0);
    let times: [(&str, &dyn Fn(u32) -> String); 5] = [
        ("s", &|k| seconds(k).to_string()),
        ("ms", &|k| format!("{}000", seconds(k))),
        ("us", &|k| format!("{}000000", seconds(k))),
        ("ns", &|k| format!("{}000000000", seconds(k))),
        ("days", &serial),
    ];
    for (unit, time) in times {
        let (own, file) = (folder.join(unit), folder.join(unit).with_extension("csv"));
        fs::write(&file, table(time)).expect("writable");
        let (code, out, err) = run(&["import", &text(&own), &text(&file), "--loop", "A"]);
        assert_eq!(code, Some(0), "{unit}: {err}");
        assert!(out.starts_with(&format!("{}: 400 samples, read as: ", text(&file))), "{unit}: {out}");
        let mut reader = stictiond::store::Reader::open(&own).expect("opens");
        let kept = reader.between("A", "op", 0.0, 1e11).expect("can be read");
        assert_eq!(kept.len(), 200, "{unit}");
        for (k, sample) in (0..).zip(&kept) {
            assert!((sample.t - START - f64::from(k)).abs() < 1e-3, "{unit}: {sample:?}");
        }
    }
    fs::remove_dir_all(&folder).expect("writable");
}

#[test]
fn a_table_without_dates_is_refused_and_what_has_none_within_one_is_counted() {
    let folder = folder("cli-store-undated");
    let (own, file) = (folder.join("own"), folder.join("in.csv"));
    let text = |path: &Path| path.display().to_string();
    let import =
        |more: &[&str]| run(&[&["import", text(&own).as_str(), text(&file).as_str()], more].concat());
    let times: [&dyn Fn(u32) -> String; 3] = [
        &|k| format!("13:{:02}:{:02}", k / 60, k % 60),
        &|k| format!("{}:00:{:02}", 25 + k / 60, k % 60),
        &|k| (2 * k).to_string(),
    ];
    for time in times {
        fs::write(&file, table(time)).expect("writable");
        let (code, out, err) = import(&["--loop", "A"]);
        assert_eq!((code, out.as_str()), (Some(2), ""), "{err}");
        assert!(err.contains("times must be seconds since 1970, or dates"), "{err}");
        assert!(err.contains("--time-format") && err.contains("--time-unit"), "{err}");
        let tags = stictiond::store::Reader::open(&own).and_then(|reader| reader.tags());
        assert!(tags.expect("can be read").is_empty(), "nothing of it is kept");
    }
    // Stamps of a clock that was not set yet, in an archive of others.
    let rows = "loop,tag,t,value\nA,op,5,1\nA,op,6,2\nA,op,1763700000,3\nA,op,1763700001,4\n";
    fs::write(&file, rows).expect("writable");
    let (code, out, err) = import(&["--time-unit", "s"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains(": 2 samples kept, 2 refused, whose times have no date"), "{out}");
    // Milliseconds taken for seconds, and days of astronomers for days of a spreadsheet.
    let millis = |k: u32| format!("{}000", 1_763_700_000 + u64::from(k));
    let julian = |k: u32| format!("{:.7}", 2_461_192.75 + f64::from(k) / 43_200.0);
    for (table, unit) in [(table(&millis), "s"), (table(&julian), "days"), (table(&julian), "datenum")] {
        fs::write(&file, table).expect("writable");
        let (code, out, err) = import(&["--loop", "B", "--time-unit", unit]);
        assert_eq!((code, out.as_str()), (Some(2), ""), "{unit}: {err}");
        assert!(err.contains("line 2, column 1 (time): ") && err.contains("--time-unit"), "{unit}: {err}");
        assert!(err.contains("is no time before 2100"), "{unit}: {err}");
        let tags = stictiond::store::Reader::open(&own).and_then(|reader| reader.tags());
        assert!(tags.expect("can be read").iter().all(|tag| tag.name.control_loop == "A"), "{unit}");
    }
    fs::remove_dir_all(&folder).expect("writable");
}

/// What `diagnose` refuses as two records in one file, `import` does not keep either.
#[test]
fn two_records_in_one_file_are_not_imported_and_what_comes_twice_is_counted() {
    let folder = folder("cli-store-twice");
    let (own, file) = (folder.join("own"), folder.join("in.csv"));
    let text = |path: &Path| path.display().to_string();
    let rows = |from: f64, count: u32, value: f64| -> String {
        let row = |k: u32| {
            let ms = ((from + 2.0 * f64::from(k)) * 1e3).round() as i64;
            let time = jiff::Timestamp::from_millisecond(ms).expect("a time of ours");
            format!("{time},{},{}\n", value + f64::from(k % 7), k % 5)
        };
        (0..count).map(row).collect()
    };
    let first = rows(START, 300, 50.0);
    for second in [rows(START, 300, 20.0), rows(START + 0.7, 300, 20.0), rows(START + 450.4, 75, 50.0)] {
        fs::write(&file, format!("t,op,pv\n{first}{second}")).expect("writable");
        let (code, out, err) = run(&["import", &text(&own), &text(&file), "--loop", "A"]);
        assert_eq!((code, out.as_str()), (Some(2), ""), "{err}");
        assert!(err.contains("line 302: times go back over ") && err.contains("recorded already"), "{err}");
        let tags = stictiond::store::Reader::open(&own).and_then(|reader| reader.tags());
        assert!(tags.expect("can be read").is_empty(), "nothing of it is kept");
    }
    // Two exports of the same record, of which the second begins within the first.
    let again: String = first.lines().skip(100).map(|line| format!("{line}\n")).collect();
    fs::write(&file, format!("t,op,pv\n{first}{again}")).expect("writable");
    let (code, out, err) = run(&["import", &text(&own), &text(&file), "--loop", "A"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(
        out.contains(": 600 samples kept, 400 left out, as their tag has a sample at the same time"),
        "{out}"
    );
    let kept = stictiond::store::Reader::open(&own).and_then(|mut own| own.between("A", "op", 0.0, 1e11));
    assert_eq!(kept.expect("can be read").len(), 300);
    fs::remove_dir_all(&folder).expect("writable");
}
