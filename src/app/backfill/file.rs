//! A table of samples in the folder of `[tables]`, and nowhere else.

use super::MOST_SAMPLES;
use crate::serve::{BackfillFile, BackfillRefusal, BackfillRequest};
use crate::signal::{LoopId, Sample};
use crate::table::{self, Config, Options, Source};
use std::path::{Component, Path, PathBuf};

/// A file that may be read, and what is told of it.
pub(super) struct Table {
    path: PathBuf,
    options: Options,
}

/// The file that is meant.
pub(super) fn named(file: &BackfillFile, id: &LoopId, config: &Config) -> Result<Table, BackfillRefusal> {
    let refused = |why: String| Err(BackfillRefusal::File(why));
    let Some(folder) = &config.folder else {
        return refused("no folder is configured in [tables], so no file is read".into());
    };
    // One name, without a path: nothing outside the folder can be meant, and no link leads there.
    let mut parts = Path::new(&file.name).components();
    let (Some(Component::Normal(name)), None) = (parts.next(), parts.next()) else {
        return refused(format!("{:?} is no name of a file in the folder of [tables]", file.name));
    };
    let path = folder.join(name);
    if !path.symlink_metadata().is_ok_and(|found| found.is_file()) {
        return refused(format!("there is no file {:?} in the folder of [tables]", file.name));
    }
    let mut options = Options { of_loop: None, ..config.defaults.of_all_tables() };
    for (name, value) in &file.options {
        if !options.set(name, value.clone()) {
            return refused(format!("table: no option is called {name:?}"));
        }
    }
    if let Err(error) = options.told() {
        return refused(format!("table: {error}"));
    }
    options.of_loop = Some(id.to_string());
    Ok(Table { path, options })
}

impl Table {
    /// Its record within the time that is asked for, how it was read, and OP's unit where the file tells it.
    pub(super) fn read(&self, request: &BackfillRequest) -> Result<table::Table, String> {
        let source = Source::File(&self.path);
        let mut read = table::read(source, &self.options).map_err(|error| error.to_string())?;
        let record = &mut read.record;
        let within = |sample: &Sample| (request.from..=request.to).contains(&sample.t);
        // What is told only when it changes is in force from before the first window on.
        record.op.retain(within);
        record.pv.retain(within);
        // As from the store: the loop's own tags, for the past is asked of them.
        record.tags.clear();
        if record.op.len() + record.pv.len() > MOST_SAMPLES {
            return Err(format!("more than {MOST_SAMPLES} samples; cut the file"));
        }
        Ok(read)
    }
}
