//! `stictiond check --config FILE`: what `run` would do with it, without doing it.

mod surroundings;

use super::{Failure, print};
use std::fmt::Write;
use std::path::PathBuf;
use stictiond::access::{Role, file};
use stictiond::collect::opcua;
use stictiond::config::{self, Config, Plant, without_number};
use stictiond::history::Ring;
use stictiond::schedule::Clock;
use stictiond::serve;
use stictiond::signal::many;

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
    let (mut summary, faults) = summary(&config, &plant);
    let damaged = damaged(&config);
    damaged.iter().for_each(|line| summary += line);
    let good = match faults.is_empty() {
        false => "run will not start with it".to_string(),
        true if !damaged.is_empty() => "run will start with it and refuse changes".to_string(),
        true if config.fleet.is_some() => format!("good for {}", parts(&config).join(" and ")),
        true => "good".to_string(),
    };
    print(&format!("{}: {good}\n{summary}", args.config.display()))?;
    if faults.is_empty() {
        return Ok(());
    }
    Err(Failure::in_file(&args.config, format!("run will not start: {}", faults.join("; "))))
}

/// What `run` would do, and why it would not start: files beside the configuration that it cannot use.
fn summary(config: &Config, plant: &Plant) -> (String, Vec<String>) {
    let periods = || config.loops.iter().map(|own| config.period_s(own));
    let (shortest, longest) = (periods().fold(f64::INFINITY, f64::min), periods().fold(0.0, f64::max));
    let mut out = String::new();
    // Writing into a String cannot fail.
    let every = match plant.loops.is_empty() {
        true => String::new(),
        false if longest > shortest => format!(", diagnosed every {shortest} s to {longest} s"),
        false => format!(", diagnosed every {shortest} s"),
    };
    let _ = writeln!(out, "loops    {}{every}", plant.loops.len());
    let mut faults = Vec::new();
    if config.fleet.is_some() {
        let _ = writeln!(out, "fleet    {}; `stictiond run` refuses [fleet]", fleet(config, &mut faults));
    }
    let requests: usize = plant.plans.iter().map(|plan| plan.requests.len()).sum();
    let tags: usize = plant.loops.iter().map(|own| own.tags.len()).sum();
    let devices = plant.plans.len() + plant.opcua.len() + plant.mqtt.len();
    let _ = writeln!(out, "devices  {devices}, {} a round", many(requests, "request"));
    for plan in &plant.plans {
        let _ = writeln!(
            out,
            "         {}: {} unit {}, {} in {} every {} ms",
            plan.name,
            plan.address,
            plan.unit_id,
            many(plan.tags.len(), "tag"),
            many(plan.requests.len(), "request"),
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
            broker.client_id()
        );
    }
    for control_loop in &config.loops {
        let Some(own) = control_loop.writeback.as_ref().filter(|own| own.enabled) else { continue };
        let _ = writeln!(
            out,
            "WRITES   {}: holding registers {} (term) and {} (heartbeat) of {}, at most ±{} % of OP's span",
            control_loop.id, own.term_address, own.heartbeat_address, own.device, own.clamp_percent
        );
    }
    let samples = config.history.samples_per_tag;
    let rings =
        || plant.loops.iter().flat_map(|own| &own.tags).map(|tag| config.history.samples_of(&tag.kind));
    let [least, most] = [Ring::bytes as fn(usize) -> usize, Ring::wide_bytes]
        .map(|bytes| rings().map(bytes).sum::<usize>() as f64 / 1e6);
    let _ = writeln!(
        out,
        "memory   {least:.1} MB for {tags} tags, {samples} samples each; {most:.1} MB if their values are not 32-bit floats"
    );
    let _ = writeln!(out, "listen   {}", config.server.listen);
    let _ = writeln!(out, "access   {}", access(config, &mut faults));
    faults.extend(config.unwritable());
    faults.extend(surroundings::unwritable_logs(config));
    let of_store = config.no_store().into_iter().chain(config.too_little_room());
    let remarks = config.remarks().into_iter().chain(config.missing_files()).chain(of_store);
    for remark in remarks.chain(config.fleet_remarks()).chain(surroundings::remarks(config)) {
        let _ = writeln!(out, "remark   {remark}");
    }
    (out, faults)
}

/// A line for each audit log that was changed: `run` starts all the same, and refuses what needs an entry in it.
fn damaged(config: &Config) -> Vec<String> {
    let line =
        |why: String| format!("DAMAGED  {why}; `stictiond audit renew` puts it aside and begins a new one\n");
    surroundings::damaged_logs(config).into_iter().map(line).collect()
}

/// For whom of a fleet it is.
fn fleet(config: &Config, faults: &mut Vec<String>) -> String {
    let good: Vec<String> = parts(config).iter().map(|part| format!("`stictiond {part}`")).collect();
    if good.is_empty() {
        let whys = config.fleet_parts().into_iter().filter_map(|(_, starts)| starts.err());
        faults.push(whys.collect::<Vec<_>>().join("; "));
        return "for no part of a fleet".to_string();
    }
    format!("for {}", good.join(" and "))
}

/// The parts of a fleet that would start with it.
fn parts(config: &Config) -> Vec<&'static str> {
    config.fleet_parts().into_iter().filter_map(|(part, starts)| starts.is_ok().then_some(part)).collect()
}

/// Who gets in, in a sentence: nobody is to be locked out, or let in, by surprise.
fn access(config: &Config, faults: &mut Vec<String>) -> String {
    let server = &config.server;
    // Without a log-in write-back is acted on from this machine only.
    let (everybody, all) = if serve::is_loopback(server.listen) {
        ("everybody on this machine", "read and do everything")
    } else {
        ("everybody who reaches it", "read everything and do everything but write-back")
    };
    let way = match &server.tls {
        Some(tls) => match serve::Tls::load(tls) {
            Err(error) => {
                let error = without_number(&error.to_string());
                faults.push(error.clone());
                format!("; BUT RUN WILL NOT START: {error}")
            }
            Ok(_) if tls.client_ca_file.is_some() => {
                "; by TLS, and only clients that show a certificate".to_string()
            }
            Ok(_) => "; by TLS".to_string(),
        },
        None if serve::is_loopback(server.listen) => String::new(),
        None => "; in the clear, so it can be read and changed on the way".to_string(),
    };
    let Some(access) = &config.access else {
        return format!("{everybody} may {all}: there is no log-in{way}");
    };
    let reads = if access.anyone_may_read {
        format!("{everybody} may read, changes need")
    } else {
        "everything but /healthz and /readyz needs".to_string()
    };
    let path = access.file.display();
    let who = match file::load(&access.file) {
        _ if !access.file.exists() => {
            format!("{path} is not there, so nobody can log in: make it by stictiond user add")
        }
        Ok(book) => {
            let (users, tokens) = (book.users.len(), book.tokens.len());
            let mut who = format!("{users} users, {tokens} tokens in {path}");
            let now = Clock::wall().now();
            let writing =
                config.loops.iter().any(|own| own.writeback.as_ref().is_some_and(|own| own.enabled));
            let needed = Role::ALL.into_iter().filter(|role| writing || *role != Role::Approver);
            for role in needed.filter(|role| !book.has(*role, now)) {
                who += &format!(", nobody is {role}");
            }
            who
        }
        Err(error) => {
            let error = without_number(&error.to_string());
            faults.push(format!("[access] file: {error}"));
            format!("NOBODY GETS IN, run will not start: {error}")
        }
    };
    format!("{reads} a log-in or token: {who}{way}")
}
