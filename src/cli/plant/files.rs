//! Loops out of files: a record of one loop each, or a table with columns of several.

use super::Args;
use super::source::{MOST, OneLoop, Take, why};
use crate::cli::{Failure, table};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use stictiond::signal::{Record, Sample};
use stictiond::table::{LoopColumns, OneOf, Options, Source, Table, each_of_several};

/// The files, and what is in them.
pub struct Files {
    files: Vec<File>,
    /// The columns of each loop, where somebody lists them.
    listed: Option<Vec<LoopColumns>>,
}

struct File {
    path: PathBuf,
    holds: Holds,
}

/// What a file holds.
enum Holds {
    /// It was not read yet.
    NotKnown,
    /// Nothing that is used.
    Nothing,
    /// The loop of its name.
    One,
    /// Columns of these loops.
    Several(Vec<String>),
}

impl Files {
    /// The tables of a folder, or one file.
    pub fn open(args: &Args, listed: Option<Vec<LoopColumns>>) -> Result<Self, Failure> {
        let path = &args.source;
        let mut paths = if path.is_file() { vec![path.clone()] } else { tables(path)? };
        if paths.len() > MOST {
            return Err(Failure::in_file(path, format!("{} records, {MOST} are the most", paths.len())));
        }
        if listed.is_some() && names_columns(args) {
            let why = "--loops names the columns of every loop: leave --op, --pv and the like out";
            return Err(Failure::BadInput(why.into()));
        }
        paths.sort();
        let file = |path| File { path, holds: Holds::NotKnown };
        Ok(Self { files: paths.into_iter().map(file).collect(), listed })
    }

    /// Hands on every loop that is `wanted`; the first time all of them have to be.
    pub fn each(&mut self, args: &Args, wanted: &dyn Fn(&str) -> bool, take: Take<'_>) {
        let (many, listed) = (self.files.len(), self.listed.as_deref());
        let mut taken: HashMap<String, PathBuf> = HashMap::new();
        for file in &mut self.files {
            let name = file.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let mut to = HandOn {
                path: &file.path,
                others: many - 1,
                taken: &mut taken,
                take: &mut *take,
                handed: 0,
                used: Vec::new(),
            };
            match &file.holds {
                Holds::NotKnown => file.holds = look(args, &name, listed, &mut to),
                Holds::One if wanted(&name) => to.one(&name, 1, || one(args, &file.path)),
                Holds::Several(names) => {
                    let here = |own: &str| wanted(own) && names.iter().any(|name| name == own);
                    if names.iter().any(|name| wanted(name)) {
                        // It could be read before.
                        let _ = several(args, listed.unwrap_or_default(), 1, &here, &mut to);
                    }
                }
                Holds::One | Holds::Nothing => {}
            }
        }
    }
}

/// Reads a file for the first time, and says what it holds.
fn look(args: &Args, name: &str, listed: Option<&[LoopColumns]>, to: &mut HandOn<'_>) -> Holds {
    let all = |_: &str| true;
    if let Some(listed) = listed {
        if let Err(why) = several(args, listed, 1, &all, to) {
            to.one(name, 1, || Err(why));
            return Holds::Nothing;
        }
        return to.several();
    }
    let path = to.path;
    // What has a name that is taken is not read.
    let read = if to.is_taken(name) { None } else { Some(table::read(path, &args.table.options(None))) };
    let refused = match read {
        None => None,
        Some(Ok(table)) => {
            to.one(name, 1, || record(args, path, table));
            return if to.used.is_empty() { Holds::Nothing } else { Holds::One };
        }
        Some(Err(failure)) => Some(why(path, failure)),
    };
    // Those of one loop have to leave no doubt as a record.
    if refused.is_some() && !names_columns(args) {
        let read = several(args, &[], 2, &all, to);
        if to.handed > 0 {
            if let Err(why) = read {
                to.one(name, 1, || Err(why));
            }
            return to.several();
        }
    }
    to.one(name, 1, || Err(refused.unwrap_or_default()));
    Holds::Nothing
}

/// Whether options name columns of one loop.
fn names_columns(args: &Args) -> bool {
    let told = args.table.options(None);
    [told.op, told.pv, told.sp, told.mv, told.mode].iter().any(Option::is_some)
}

/// Hands the loops of one file on.
struct HandOn<'h> {
    path: &'h Path,
    /// Files beside it.
    others: usize,
    /// The file of each loop that is used: one that was saved in another format too would swing together with itself.
    taken: &'h mut HashMap<String, PathBuf>,
    take: Take<'h>,
    /// Loops that were handed on, and those that are used.
    handed: usize,
    used: Vec<String>,
}

impl HandOn<'_> {
    fn is_taken(&self, name: &str) -> bool {
        self.taken.contains_key(name)
    }

    /// A loop, which is one of so many of its file.
    fn one(&mut self, name: &str, of: usize, record: impl FnOnce() -> Result<Record, String>) {
        let record = match self.taken.get(name) {
            Some(first) => Err(twice(name, self.path, first)),
            None => record(),
        };
        self.handed += 1;
        if (self.take)(OneLoop { name: name.to_string(), of: self.others + of, record }) {
            self.taken.insert(name.to_string(), self.path.to_path_buf());
            self.used.push(name.to_string());
        }
    }

    /// What the file holds, by what was used of it.
    fn several(&mut self) -> Holds {
        let used = std::mem::take(&mut self.used);
        if used.is_empty() { Holds::Nothing } else { Holds::Several(used) }
    }
}

/// Why a loop of a name that is taken is not used.
fn twice(name: &str, path: &Path, first: &Path) -> String {
    let [own, other] = [path, first].map(|path| path.file_name().unwrap_or_default().display());
    if [path, first].iter().all(|path| path.file_stem().is_some_and(|stem| stem == name)) {
        return format!("{own} has the name of {other}, which is read: take one away");
    }
    format!(
        "{own} has this loop too, and that of {other} is read: name one file, or take all into a store with `stictiond store import` \
         and name that"
    )
}

/// The loops of a table that has columns of so many or more.
fn several(
    args: &Args,
    listed: &[LoopColumns],
    least: usize,
    wanted: &dyn Fn(&str) -> bool,
    to: &mut HandOn<'_>,
) -> Result<(), String> {
    let path = to.path;
    table::readable_twice(path).map_err(|failure| why(path, failure))?;
    let options = Options { several: Some(listed.to_vec()), ..args.table.options(None) };
    let mut take = |OneOf { name, of, table }: OneOf| {
        if of >= least {
            to.one(&name, of, || record(args, path, table.map_err(|error| error.to_string())?));
        }
    };
    each_of_several(Source::File(path), &options, wanted, &mut take).map_err(|error| error.to_string())
}

/// The record of a file that has one loop.
fn one(args: &Args, path: &Path) -> Result<Record, String> {
    let table = table::read(path, &args.table.options(None)).map_err(|failure| why(path, failure))?;
    record(args, path, table)
}

/// A record with the span of its OP, in the time that is wanted.
fn record(args: &Args, path: &Path, read: Table) -> Result<Record, String> {
    let Table { mut record, found } = read;
    record.op_limits = args.op_limits.or(record.op_limits);
    table::scale_one_of_many(path, &mut record, found.op_unit.as_deref())
        .map_err(|failure| why(path, failure))?;
    let within = |sample: &Sample| {
        args.from.is_none_or(|from| sample.t >= from) && args.to_time.is_none_or(|to| sample.t <= to)
    };
    record.op.retain(within);
    record.pv.retain(within);
    Ok(record)
}

/// The tables of a folder but its index.
fn tables(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let entries = fs::read_dir(folder).map_err(|error| Failure::in_file(folder, &error))?;
    let is_table = |path: &PathBuf| {
        let known = ["csv", "txt", "tsv", "xlsx", "xls", "xlsb", "ods", "parquet"];
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        let index = path.file_stem().is_some_and(|name| name == "index");
        extension.is_some_and(|e| known.contains(&e.as_str())) && !index
    };
    Ok(entries.flatten().map(|e| e.path()).filter(|p| p.is_file() && is_table(p)).collect())
}
