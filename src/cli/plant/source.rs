//! Where the loops come from: files of records and tables, or a store. They are read one after the other, as often as they are needed.

use super::Args;
use super::files::Files;
use super::stored::Stored;
use crate::cli::{Failure, import_tags};
use std::path::Path;
use stictiond::config::LoopConfig;
use stictiond::diagnosis::Settings;
use stictiond::signal::Record;

/// Most loops.
pub const MOST: usize = 20_000;

/// A loop as its source has it.
pub struct OneLoop {
    /// Its name.
    pub name: String,
    /// How many loops there are about, as far as is known.
    pub of: usize,
    /// Its record, or why it cannot be used.
    pub record: Result<Record, String>,
}

/// What is done with a loop; it says whether the loop is used.
pub type Take<'t> = &'t mut dyn FnMut(OneLoop) -> bool;

/// Where the loops come from.
pub enum Source {
    Files(Files),
    Stored(Box<Stored>),
}

impl Source {
    /// Finds out what the argument names.
    pub fn open(args: &Args) -> Result<Self, Failure> {
        if let Some(stored) = Stored::open(args)? {
            if args.loops.is_some() {
                let why = "--loops: a store knows its loops; it is for tables with columns of several";
                return Err(Failure::BadInput(why.into()));
            }
            return Ok(Self::Stored(Box::new(stored)));
        }
        let listed = args.loops.as_deref().map(import_tags::loop_columns).transpose()?;
        Files::open(args, listed).map(Self::Files)
    }

    /// Hands on every loop that is `wanted`. `whole`: with the tags that are no role of it, too.
    pub fn each(
        &mut self,
        args: &Args,
        whole: bool,
        wanted: &dyn Fn(&str) -> bool,
        take: Take<'_>,
    ) -> Result<(), Failure> {
        match self {
            Self::Files(files) => {
                files.each(args, wanted, take);
                Ok(())
            }
            Self::Stored(stored) => stored.each(args, whole, wanted, take),
        }
    }

    /// Why there is nothing, where there is no loop at all.
    pub fn no_loop(&self) -> &'static str {
        match self {
            Self::Files(_) => "there is no record in it, and it is no store",
            Self::Stored(stored) => stored.no_loop(),
        }
    }

    /// From when to when it is read, in words; `None` for files, which are read whole unless somebody says otherwise.
    pub fn span(&self) -> Option<String> {
        match self {
            Self::Files(_) => None,
            Self::Stored(stored) => Some(stored.span()),
        }
    }

    /// What went wrong with all of it.
    pub fn remark(&self) -> Option<String> {
        match self {
            Self::Files(_) => None,
            Self::Stored(stored) => stored.remark(),
        }
    }

    /// What the configuration says of a loop.
    pub fn configured(&self, name: &str) -> Option<&LoopConfig> {
        match self {
            Self::Files(_) => None,
            Self::Stored(stored) => stored.configured(name),
        }
    }

    /// How valves are diagnosed.
    pub fn settings(&self) -> Settings {
        match self {
            Self::Files(_) => Settings::default(),
            Self::Stored(stored) => stored.settings(),
        }
    }
}

/// Why something cannot be used, without the name of its file.
pub fn why(path: &Path, failure: Failure) -> String {
    let why = match failure {
        Failure::BadInput(why) | Failure::Failed(why) => why,
        Failure::BadConfig(_) => "the options contradict each other".into(),
    };
    why.strip_prefix(&format!("{}: ", path.display())).map(str::to_string).unwrap_or(why)
}
