//! `stictiond check --config FILE`: what `run` would do with it, without doing it.

use super::{Failure, print};
use std::fmt::Write;
use std::path::PathBuf;
use stictiond::collect::opcua;
use stictiond::config::{self, Config, Plant};
use stictiond::history::BYTES_PER_SAMPLE;

#[derive(clap::Args)]
pub struct Args {
    /// The configuration
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

/// Loads, plans and prints a summary.
pub fn run(args: &Args) -> Result<(), Failure> {
    let config = config::load(&args.config).map_err(Failure::BadConfig)?;
    let plant = config.plant().map_err(|issues| {
        let issues: Vec<String> =
            issues.into_iter().map(|issue| format!("{}: {}", issue.field, issue.message)).collect();
        Failure::in_file(&args.config, issues.join("; "))
    })?;
    print(&format!("{}: good\n{}", args.config.display(), summary(&config, &plant)))
}

fn summary(config: &Config, plant: &Plant) -> String {
    let periods = || config.loops.iter().map(|own| config.period_s(own));
    let (shortest, longest) = (periods().fold(f64::INFINITY, f64::min), periods().fold(0.0, f64::max));
    let mut out = String::new();
    // Writing into a String cannot fail.
    let _ = writeln!(
        out,
        "loops    {}, diagnosed every {shortest} s{}",
        plant.loops.len(),
        if longest > shortest { format!(" to {longest} s") } else { String::new() }
    );
    let requests: usize = plant.plans.iter().map(|plan| plan.requests.len()).sum();
    let tags: usize = plant.loops.iter().map(|own| own.tags.len()).sum();
    let devices = plant.plans.len() + plant.opcua.len() + plant.mqtt.len();
    let _ = writeln!(out, "devices  {devices}, {requests} requests a round");
    for plan in &plant.plans {
        let _ = writeln!(
            out,
            "         {}: {} unit {}, {} tags in {} requests every {} ms",
            plan.name,
            plan.address,
            plan.unit_id,
            plan.tags.len(),
            plan.requests.len(),
            plan.period.as_millis()
        );
    }
    for plan in &plant.opcua {
        let server = &plan.config;
        let (how, every) = match server.mode {
            opcua::Mode::Subscribe => ("sampled by the server", server.sampling_ms),
            opcua::Mode::Poll => ("read", server.sampling_ms),
        };
        let _ = writeln!(
            out,
            "         {}: {} {:?}, {} nodes {how} every {every} ms",
            server.name,
            server.url,
            server.security_policy,
            plan.tags.len()
        );
    }
    for plan in &plant.mqtt {
        let broker = &plan.config;
        let _ = writeln!(
            out,
            "         {}: {}, {} tags by topic, as client {}",
            broker.name,
            broker.address,
            plan.tags.len(),
            broker.client_id
        );
    }
    let samples = config.history.samples_per_tag;
    let megabytes = (tags * samples * BYTES_PER_SAMPLE) as f64 / 1e6;
    let _ = writeln!(
        out,
        "memory   {megabytes:.1} MB for {tags} tags, {samples} samples each, {BYTES_PER_SAMPLE} bytes a sample"
    );
    let _ = writeln!(out, "listen   {}", config.server.listen);
    out
}
