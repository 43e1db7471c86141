//! Where a store is in these tests: in a folder, or in a PostgreSQL of its own.

use crate::postgres::Cluster;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use stictiond::signal::Sample;
use stictiond::store::{Batch, Checked, Config, Reader, Series, TagName, check_of};

pub struct Place {
    pub folder: PathBuf,
    pub cluster: Option<Cluster>,
}

impl Place {
    pub fn folder() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("store-both-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&folder);
        Self { folder, cluster: None }
    }

    pub fn postgres() -> Self {
        let mut place = Self::folder();
        place.cluster = Some(Cluster::with(None, false));
        place
    }

    /// In PostgreSQL with what stands in for TimescaleDB.
    pub fn hypertables() -> Self {
        let mut place = Self::postgres();
        let mut client = place.cluster().client().expect("answers");
        client.batch_execute(include_str!("timescaledb.sql")).expect("a superuser may");
        place
    }

    pub fn config(&self) -> Config {
        let own = self.cluster.as_ref().map_or_else(|| Config::new(&self.folder), |c| c.config(&self.folder));
        Config { chunk_s: 60, ..own }
    }

    /// The same place under another name.
    pub fn beside(&self) -> Config {
        Config { schema: "beside".into(), folder: self.folder.join("beside"), ..self.config() }
    }

    pub fn reader(&self) -> Reader {
        Reader::of(&self.config()).expect("opens")
    }

    pub fn cluster(&mut self) -> &mut Cluster {
        self.cluster.as_mut().expect("a place in PostgreSQL")
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

pub fn tag(control_loop: &str, tag: &str) -> Arc<TagName> {
    Arc::new(TagName {
        control_loop: control_loop.into(),
        tag: tag.into(),
        source: "register 7".into(),
        unit: "%".into(),
    })
}

pub fn batch(tag: &Arc<TagName>, samples: Vec<Sample>) -> Batch {
    Batch { series: vec![Series { tag: tag.clone(), samples }], rows: Vec::new() }
}

pub fn good(range: std::ops::Range<u32>) -> Vec<Sample> {
    range.map(|i| Sample::good(1000.0 + f64::from(i), f64::from(i) * 0.5)).collect()
}

/// Everything that is kept, by the names of the tags and in each by era, chunk by chunk.
pub fn all_of(config: &Config) -> BTreeMap<(TagName, i64), Vec<Sample>> {
    let mut reader = Reader::of(config).expect("opens");
    let tags = reader.tags().expect("reads");
    let mut found: BTreeMap<(TagName, i64), Vec<Sample>> = BTreeMap::new();
    let mut from = 0;
    while let Some(start) = reader.next_start(from).expect("reads") {
        for (id, samples) in reader.chunk(start, None).expect("reads") {
            let tag = tags.iter().find(|tag| tag.id == id).expect("a tag");
            found.entry((tag.name.clone(), tag.era)).or_default().extend(samples);
        }
        from = start + 1;
    }
    assert_eq!(reader.damaged(), 0);
    found
}

/// Everything of one tag, era after era.
pub fn all(place: &Place, tag: &TagName) -> Vec<Sample> {
    let found = all_of(&place.config());
    found.into_iter().filter(|((name, _), _)| name == tag).flat_map(|(_, samples)| samples).collect()
}

pub fn whole(place: &Place) -> Checked {
    let checked = check_of(&place.config()).expect("can be read");
    assert_eq!(checked.faults, [""; 0]);
    checked
}
