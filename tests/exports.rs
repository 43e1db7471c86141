//! Tables as plants send them: one record in many clothes is the same record, what is doubtful is refused by name, and
//! nothing is ever read as other numbers than those that were written.

#[path = "exports/archive.rs"]
mod archive;
#[path = "exports/bombs.rs"]
mod bombs;
#[path = "exports/bombs_xls.rs"]
mod bombs_xls;
#[path = "exports/bombs_xlsb.rs"]
mod bombs_xlsb;
#[path = "exports/cells.rs"]
mod cells;
#[path = "exports/clocks.rs"]
mod clocks;
#[path = "exports/columns.rs"]
mod columns;
#[path = "exports/doubts.rs"]
mod doubts;
#[path = "exports/dress.rs"]
mod dress;
#[path = "exports/forms.rs"]
mod forms;
#[path = "exports/halves.rs"]
mod halves;
#[path = "exports/joined.rs"]
mod joined;
#[path = "exports/loops.rs"]
mod loops;
#[path = "exports/lost.rs"]
mod lost;
#[path = "exports/makers.rs"]
mod makers;
#[path = "exports/mixed.rs"]
mod mixed;
#[path = "exports/modes.rs"]
mod modes;
#[path = "exports/packed.rs"]
mod packed;
#[path = "exports/pairs.rs"]
mod pairs;
#[path = "exports/plants.rs"]
mod plants;
#[path = "exports/quality.rs"]
mod quality;
#[path = "exports/random.rs"]
mod random;
#[path = "exports/random_mixed.rs"]
mod random_mixed;
#[path = "exports/shared.rs"]
mod shared;
#[path = "exports/stated.rs"]
mod stated;
#[path = "exports/told.rs"]
mod told;
#[path = "exports/twice.rs"]
mod twice;
#[path = "exports/unlisted.rs"]
mod unlisted;
#[path = "exports/workbooks.rs"]
mod workbooks;
#[path = "exports/written.rs"]
mod written;
#[path = "exports/xls.rs"]
mod xls;
#[path = "exports/xlsb_records.rs"]
mod xlsb_records;

use std::path::{Path, PathBuf};
use stictiond::signal::Record;
use stictiond::table::{Options, Source, Table, read};

/// The record that every form is made of.
fn example() -> Record {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/example.csv");
    stictiond::table::record(&path).expect("the example is a record")
}

fn of_bytes(bytes: &[u8], options: &Options) -> Result<Table, String> {
    read(Source::Bytes(bytes), options).map_err(|error| error.to_string())
}

/// A file of its own, in the directory that cargo keeps for this test binary.
fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("exports-{}-{name}", std::process::id()))
}

/// Values of OP and PV to the last bit.
fn bits(record: &Record) -> [Vec<u64>; 2] {
    [&record.op, &record.pv].map(|series| series.iter().map(|sample| sample.value.to_bits()).collect())
}
