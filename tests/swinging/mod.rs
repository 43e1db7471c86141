//! Half a day of 24 coupled loops in a store, one of which a load swings, and the configuration of a daemon over it: nobody
//! answers at the device's address.

use std::path::PathBuf;
use stictiond::config::{self, Config};
use stictiond::history::TagKind;
use stictiond::signal::{Role, Sample};
use stictiond::sim::units::{Plant, Source, plant};
use stictiond::store::{self, Batch, Series, Store, TagName};

/// Length of the past (h).
const HOURS: f64 = 12.0;
/// When it ends: 2026-01-01T00:00:00Z.
pub const START: f64 = 1_767_225_600.0;

/// The plant, and a daemon's configuration over it.
pub struct Site {
    folder: PathBuf,
    pub config: Config,
    pub of: Plant,
}

impl Drop for Site {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The loops as a configuration, their past in a store. Nobody answers at the device's address.
pub fn site(name: &str) -> Site {
    let of = plant(12, 2, &[(Source::Load, Some(3))]);
    let mut text = "[plantwide]\nperiod_s = 60\npersist_s = 60\n[history]\nsamples_per_tag = 2000\n[schedule]\nperiod_s = 100000\n\
        [[modbus]]\nname = \"d\"\naddress = \"127.0.0.1:1\"\npoll_ms = 60000\ntimeout_ms = 100\naddress_base = 0\n"
        .to_string();
    for (at, own) in of.loops.iter().enumerate() {
        text += &format!(
            "[[loop]]\nid = \"{}\"\ndescription = \"loop {at} of the unit\"\nop_span = 100.0\n",
            own.name
        );
        if at == 3 {
            text += "cost = { per_sd = 10.0, unit = \"EUR/day\" }\n";
        }
        for (role, address) in [("op", 2 * at), ("pv", 2 * at + 1)] {
            text += &format!(
                "[loop.{role}]\ndevice = \"d\"\nregister = \"holding\"\naddress = {address}\ntype = \"u16\"\n"
            );
        }
    }
    let mut config = config::parse("test.toml", &text).unwrap_or_else(|wrong| panic!("{wrong:?}\n{text}"));
    let folder =
        PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("plantwide-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    let own = store::Config { sync_ms: 20, ..store::Config::new(&folder) };
    let mut kept = Store::open(&own).expect("can be made");
    kept.insert(&past(&of, &config)).expect("can be written");
    config.store = Some(own);
    Site { folder, config, of }
}

fn past(of: &Plant, config: &Config) -> Batch {
    let wired = config.plant().expect("checked");
    let runs = of.run(HOURS, &[true]);
    let series = wired.loops.iter().zip(&runs).flat_map(|(own, run)| {
        own.tags.iter().map(move |tag| {
            let values = if tag.kind == TagKind::Role(Role::Op) { &run.op } else { &run.pv };
            let at = |t: f64| START - 3600.0 * HOURS + t - run.t[0];
            let samples = run.t.iter().zip(values).map(|(t, x)| Sample::good(at(*t), *x)).collect();
            let name = TagName {
                control_loop: own.id.to_string(),
                tag: tag.kind.name().to_string(),
                source: tag.source.clone(),
                unit: tag.unit.clone(),
            };
            Series { tag: name.into(), samples }
        })
    });
    Batch { series: series.collect(), rows: Vec::new() }
}
