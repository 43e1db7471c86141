//! Metrics for Prometheus, made anew at each scrape from what is known: no series outlives its loop.

use super::{Context, DeviceState, Machine, Plant};
use crate::alarm::State;
use crate::history::History;
use crate::indicators::series::NAMED;
use crate::quiet;
use crate::results::{Known, f_unit};
use crate::work::State as WorkState;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use std::collections::HashSet;
use std::sync::atomic::AtomicU64;

type Labels = Vec<(&'static str, String)>;
type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;
type Counts = Family<Labels, Counter<f64, AtomicU64>>;

/// One day (s).
const DAY_S: f64 = 86_400.0;

/// The exposition text.
pub fn text(context: &Context) -> String {
    let mut registry = Registry::with_prefix("stictiond");
    let plant = context.plant();
    let now = context.clock.now();
    loops(&mut registry, context, &plant, now);
    alarms(&mut registry, context, now);
    plantwide(&mut registry, context, &plant);
    runs(&mut registry, context);
    devices(&mut registry, &(plant.devices)(), now);
    history(&mut registry, &plant.history);
    writeback(&mut registry, context, &plant);
    store(&mut registry, context, now);
    audit(&mut registry, context);
    receivers(&mut registry, context);
    fleet(&mut registry, context, now);
    process(&mut registry);
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = encode(&mut text, &registry);
    text
}

/// The exposition text as readers want it that do not know OpenMetrics, Prometheus' format 0.0.4: a counter is described under
/// the name that its series have.
pub fn plain(open: &str) -> String {
    let counter = |line: &str| line.strip_prefix("# TYPE ")?.strip_suffix(" counter").map(str::to_string);
    let counters: HashSet<String> = open.lines().filter_map(counter).collect();
    let mut out = String::with_capacity(open.len() + 64 * counters.len());
    for line in open.lines().filter(|line| *line != "# EOF" && !line.starts_with("# UNIT ")) {
        let mut parts = line.splitn(4, ' ');
        match (parts.next(), parts.next(), parts.next(), parts.next()) {
            (Some("#"), Some(what), Some(name), Some(rest)) if counters.contains(name) => {
                out += &format!("# {what} {name}_total {rest}");
            }
            _ => out += line,
        }
        out.push('\n');
    }
    out
}

fn gauges(registry: &mut Registry, name: &str, help: &str) -> Gauges {
    let family = Gauges::default();
    registry.register(name, help, family.clone());
    family
}

fn counts(registry: &mut Registry, name: &str, help: &str) -> Counts {
    let family = Counts::default();
    registry.register(name, help, family.clone());
    family
}

/// A gauge without labels.
fn gauge(registry: &mut Registry, name: &str, help: &str, value: f64) {
    let gauge = Gauge::<f64, AtomicU64>::default();
    gauge.set(value);
    registry.register(name, help, gauge);
}

/// A counter without labels.
fn counter(registry: &mut Registry, name: &str, help: &str, value: f64) {
    let counter = Counter::<f64, AtomicU64>::default();
    counter.inc_by(value);
    registry.register(name, help, counter);
}

fn history(registry: &mut Registry, rings: &History) {
    let (bytes, refused) = (rings.memory_bytes() as f64, rings.refused() as f64);
    gauge(registry, "history_memory_bytes", "Bytes held by the sample rings", bytes);
    counter(registry, "history_refused_samples", "Samples refused for want of a single writer", refused);
}

fn labels(pairs: &[(&'static str, &str)]) -> Labels {
    pairs.iter().map(|(name, value)| (*name, (*value).to_string())).collect()
}

fn set(family: &Gauges, pairs: &[(&'static str, &str)], value: f64) {
    family.get_or_create(&labels(pairs)).set(value);
}

fn count(family: &Counts, pairs: &[(&'static str, &str)], value: f64) {
    family.get_or_create(&labels(pairs)).inc_by(value);
}

/// Indicators that are worth a series for each loop: those by which somebody is told.
const INDICATORS: [&str; 6] = ["score", "service_factor", "error_sd", "harris", "swing", "compression"];

fn plantwide(registry: &mut Registry, context: &Context, plant: &Plant) {
    let Some(port) = &context.plantwide else { return };
    let indicator = gauges(
        registry,
        "loop_indicator",
        "Indicators of the loop by the latest look at the plant; absent when that is older than two periods of looks",
    );
    let wanted: Vec<(usize, &str)> = NAMED
        .iter()
        .enumerate()
        .filter(|(_, own)| INDICATORS.contains(&own.0))
        .map(|(at, own)| (at, own.0))
        .collect();
    for info in plant.loops() {
        let Some(values) = port.latest(&info.id) else { continue };
        for (at, name) in &wanted {
            if let Some(value) = values[*at] {
                set(&indicator, &[("loop", info.id.as_str()), ("indicator", name)], value);
            }
        }
    }
    let orders = gauges(registry, "work_orders", "Orders of the work list by state");
    let work = port.work();
    for state in WorkState::ALL {
        let count = work.iter().filter(|line| line.order.state == state).count();
        set(&orders, &[("state", state.as_str())], count as f64);
    }
    let groups = port.overview().map_or(0, |found| found.groups.len());
    gauge(registry, "swing_groups", "Groups of loops that swing together", groups as f64);
}

fn loops(registry: &mut Registry, context: &Context, plant: &Plant, now: f64) {
    gauge(registry, "loops", "Loops watched", plant.loops().len() as f64);
    let f =
        gauges(registry, "loop_friction", "Friction parameter f; absent when not identifiable; see f_unit");
    let bound = gauges(registry, "loop_friction_ci95", "Bounds of the 95 % interval of f");
    let evidence = gauges(
        registry,
        "loop_evidence",
        "Evidence for friction against the best explanation without it, difference of AIC",
    );
    let verdict =
        gauges(registry, "loop_verdict", "1 for the latest verdict; no series before the first diagnosis");
    let valid = gauges(registry, "loop_identifiable", "1 when the latest diagnosis could tell, 0 when not");
    let age = gauges(
        registry,
        "loop_diagnosis_age_seconds",
        "Plant time since the latest diagnosis whose source was not silent",
    );
    let alarm = gauges(registry, "loop_alarm_state", "1 for the state of the loop's alarm");
    for info in plant.loops() {
        let Some(Known { summary, looked_at, alarm: view, .. }) = context.results.get(&info.id, now) else {
            continue;
        };
        let id = info.id.as_str();
        set(&alarm, &[("loop", id), ("state", view.state.as_str())], 1.0);
        let Some(summary) = summary else { continue };
        let unit = f_unit(summary.f_in_percent);
        set(&verdict, &[("loop", id), ("verdict", &summary.outcome)], 1.0);
        set(&valid, &[("loop", id)], f64::from(u8::from(summary.f.is_some())));
        set(&age, &[("loop", id)], (now - looked_at.unwrap_or(summary.time)).max(0.0));
        if let Some(value) = summary.f {
            set(&f, &[("loop", id), ("f_unit", unit)], value);
        }
        if let Some([low, high]) = summary.f_ci95 {
            set(&bound, &[("loop", id), ("f_unit", unit), ("bound", "low")], low);
            set(&bound, &[("loop", id), ("f_unit", unit), ("bound", "high")], high);
        }
        if let Some(value) = summary.delta_aic {
            set(&evidence, &[("loop", id)], value);
        }
    }
}

fn alarms(registry: &mut Registry, context: &Context, now: f64) {
    let state = gauges(registry, "alarm_state", "1 for the state of an alarm that is not normal");
    let flags =
        gauges(registry, "alarm_flag", "1 for an alarm that is chattering, stale or grouped in a flood");
    for view in context.results.alarms(now).iter().filter(|view| view.state != State::Normal) {
        let own = [("subject", view.id.subject.as_str()), ("kind", view.id.kind.as_str())];
        let [subject, kind] = own;
        let priority = ("priority", view.priority.as_str());
        set(&state, &[subject, kind, priority, ("state", view.state.as_str())], 1.0);
        let raised = [("chattering", view.chattering), ("stale", view.stale), ("grouped", view.grouped)];
        for (flag, _) in raised.iter().filter(|(_, is)| *is) {
            set(&flags, &[subject, kind, ("flag", flag)], 1.0);
        }
    }
    let flood = context.results.flood(now);
    let is_flood = f64::from(u8::from(flood.since.is_some()));
    gauge(registry, "alarm_flood", "1 while more alarms are raised than flood_raises allows", is_flood);
    let recent = flood.recent as f64;
    gauge(registry, "alarms_raised_recently", "Alarms raised within flood_s, over the plant", recent);
}

fn runs(registry: &mut Registry, context: &Context) {
    let counters = context.scheduler.counters();
    let ended = counts(registry, "runs", "Diagnoses by how they ended");
    count(&ended, &[("outcome", "diagnosed")], counters.diagnosed as f64);
    count(&ended, &[("outcome", "deadline_exceeded")], counters.deadline_exceeded as f64);
    count(&ended, &[("outcome", "panicked")], counters.panicked as f64);
    let confirmed = counters.confirmed as f64;
    counter(
        registry,
        "runs_confirmed",
        "Diagnoses that searched for nothing, because the last model still fits",
        confirmed,
    );
    let skipped = counts(registry, "runs_skipped", "Diagnoses that were due and not begun");
    count(&skipped, &[("reason", "waits_or_runs")], counters.skipped_waiting as f64);
    count(&skipped, &[("reason", "late")], counters.skipped_late as f64);
    gauge(registry, "runs_running", "Diagnoses that run now", counters.running as f64);
    gauge(
        registry,
        "runs_queued",
        "Diagnoses that wait for a slot now; one that was asked for while it was due counts twice",
        counters.queued as f64,
    );
    let left_out = quiet::left_out() as f64;
    counter(registry, "log_lines_left_out", "Lines of libraries that were too many for the log", left_out);
    counter(registry, "runs_busy_seconds", "Time spent in diagnoses, on the wall clock", counters.busy_s);
}

fn devices(registry: &mut Registry, devices: &[DeviceState], now: f64) {
    let connected =
        gauges(registry, "device_connected", "1 while a connection is open; judge by the age instead");
    let age = gauges(registry, "device_last_good_age_seconds", "Time since the last good sample");
    let events =
        counts(registry, "device_events", "What happened on a device: polls, timeouts, exceptions, ...");
    for device in devices {
        let name = device.name.as_str();
        set(&connected, &[("device", name)], f64::from(u8::from(device.connected)));
        if let Some(t) = device.last_good {
            set(&age, &[("device", name)], (now - t).max(0.0));
        }
        for &(event, value) in &device.counters {
            count(&events, &[("device", name), ("event", event)], value as f64);
        }
    }
}

fn writeback(registry: &mut Registry, context: &Context, plant: &Plant) {
    let Some(writeback) = &context.writeback else { return };
    let state = gauges(registry, "writeback_state", "1 for the state of the loop's write-back");
    let term = gauges(registry, "writeback_term_percent", "The term in force, in % of OP's span");
    let ise = gauges(registry, "writeback_ise_gain", "ISE before over ISE with the term");
    let travel = gauges(registry, "writeback_travel_ratio", "Valve travel with the term over travel before");
    for info in plant.loops() {
        let Some(status) = writeback.status(&info.id) else { continue };
        let id = info.id.as_str();
        set(&state, &[("loop", id), ("state", status.state.as_str())], 1.0);
        set(&term, &[("loop", id)], status.in_force);
        if let (Some(before), Some(with)) = (status.before, status.with) {
            set(&ise, &[("loop", id)], before.ise / with.ise);
            set(&travel, &[("loop", id)], with.travel / before.travel);
        }
    }
}

fn store(registry: &mut Registry, context: &Context, now: f64) {
    let Some(ask) = &context.store else { return };
    let state = ask();
    let working = f64::from(u8::from(state.failing.is_none()));
    gauge(registry, "store_working", "1 while what is new is made durable, 0 while the store fails", working);
    let checked = state.checked.unwrap_or(if state.failing.is_none() { 1.0 } else { 0.0 });
    gauge(registry, "store_checked_ratio", "Share compared with its checksums (0..1)", checked);
    if let Some(at) = state.written_at {
        gauge(
            registry,
            "store_written_age_seconds",
            "Time since something was last made durable",
            (now - at).max(0.0),
        );
    }
    if let Some((there, waiting)) = state.database {
        let there = f64::from(u8::from(there));
        gauge(registry, "store_database_connected", "1 while the database of the store is there", there);
        gauge(registry, "store_spool_bytes", "Bytes that wait on disk for that database", waiting as f64);
    }
    gauge(registry, "store_used_bytes", "Bytes of the store's database in use", state.used_bytes as f64);
    gauge(registry, "store_max_bytes", "Bytes that it may take", state.max_bytes as f64);
    let events = counts(registry, "store_events", "What the store did: samples and rows written, lost, …");
    for (event, value) in state.counters {
        count(&events, &[("event", event)], value as f64);
    }
}

/// The audit logs, where there are any.
fn audit(registry: &mut Registry, context: &Context) {
    let records = context.records();
    if records.is_empty() {
        return;
    }
    let working = f64::from(u8::from(records.iter().all(|record| record.works())));
    let help = "1 while changes are put on record, 0 while an audit log is damaged or cannot be written";
    gauge(registry, "audit_working", help, working);
}

/// Those who are told of alarms.
fn receivers(registry: &mut Registry, context: &Context) {
    let all = context.notifications.as_ref().map(|port| port.receivers()).unwrap_or_default();
    if all.is_empty() {
        return;
    }
    let working = gauges(registry, "notify_working", "1 while a receiver takes what it is sent, 0 while not");
    let queue = gauges(registry, "notify_queue", "Notices and messages that wait for a receiver");
    let dead = gauges(registry, "notify_dead_letters", "Messages that never reached a receiver");
    let events = counts(
        registry,
        "notify_events",
        "Messages taken (sent), attempts that failed, changes not told one by one (dropped)",
    );
    for own in all {
        let labels = [("receiver", own.name.as_str()), ("kind", own.kind)];
        set(&working, &labels, f64::from(u8::from(own.failing.is_none())));
        set(&queue, &labels, own.queue as f64);
        set(&dead, &labels, own.dead_letters as f64);
        let [receiver, kind] = labels;
        for (event, value) in [("sent", own.sent), ("failed", own.failed), ("dropped", own.dropped)] {
            count(&events, &[receiver, kind, ("event", event)], value as f64);
        }
    }
}

/// What others of the fleet say.
fn fleet(registry: &mut Registry, context: &Context, now: f64) {
    let Some(port) = &context.fleet else { return };
    let help = "Messages of the fleet that were of no use, or would have taken too much memory";
    counter(registry, "fleet_refused_messages", help, port.refused() as f64);
    let help = "Messages left out because no edge has announced their loop, or because it is another edge's";
    counter(registry, "fleet_left_out_messages", help, port.left_out() as f64);
    let (load, heard) = (port.load(), port.seen().machines);
    let all = if heard.is_empty() { std::slice::from_ref(&load.own) } else { heard.as_slice() };
    machines(registry, all, now);
    // What this machine says of itself is not heard.
    let age = gauges(registry, "fleet_heard_age_seconds", "Time since a machine said last that it is there");
    for own in &heard {
        set(&age, &of_machine(own), (now - own.heard_at).max(0.0));
    }
    if let Some(windows) = load.windows {
        let help = "Windows that wait for a worker: of this edge, or at a centre of all edges";
        gauge(registry, "fleet_windows_waiting", help, windows as f64);
    }
    let help = "Share of a stream's room that is taken (0..1), at a centre";
    let fill = gauges(registry, "fleet_stream_fill_ratio", help);
    for (stream, share) in load.streams {
        set(&fill, &[("stream", stream)], share);
    }
}

fn of_machine(own: &Machine) -> [(&'static str, &str); 3] {
    [("role", own.role.as_str()), ("site", own.site.as_str()), ("machine", own.name.as_str())]
}

/// What machines say of themselves: at a centre all that it has heard of, at most 10,000, elsewhere this one.
fn machines(registry: &mut Registry, all: &[Machine], now: f64) {
    let help = "Age of the oldest that waits to be forwarded, or at a centre to be taken";
    let lag = gauges(registry, "fleet_lag_seconds", help);
    let help = "Days until the first of a machine's certificates ends, negative once it has";
    let certificate = gauges(registry, "fleet_certificate_days", help);
    for own in all {
        // A worker forwards nothing.
        if own.role != "worker" {
            set(&lag, &of_machine(own), own.lag_s);
        }
        if let Some((_, until)) = own.certificate {
            set(&certificate, &of_machine(own), (until - now) / DAY_S);
        }
    }
}

/// What the kernel says of the process; nothing where it says nothing.
fn process(registry: &mut Registry) {
    if let Some(kib) = status_kib("VmRSS:") {
        gauge(registry, "process_resident_memory_bytes", "Resident memory", kib * 1024.0);
    }
    if let Some(seconds) = cpu_seconds() {
        counter(registry, "process_cpu_seconds", "CPU time, user and system", seconds);
    }
}

/// Memory of the process (bytes), where the kernel says.
pub fn resident_bytes() -> Option<u64> {
    status_kib("VmRSS:").map(|kib| (kib * 1024.0) as u64)
}

fn status_kib(field: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix(field))?.split_whitespace().next()?.parse().ok()
}

/// User and system time: fields 14 and 15 of `stat`, in ticks of 10 ms on every Linux this runs on.
fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name in parentheses may hold anything; the fields after it are plain. The first of them is the third.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let ticks = fields.next()?.parse::<f64>().ok()? + fields.next()?.parse::<f64>().ok()?;
    Some(ticks / 100.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history;

    #[test]
    fn what_only_grows_is_a_counter() {
        let mut registry = Registry::with_prefix("stictiond");
        super::history(&mut registry, &History::new(&[], &history::Config::default()));
        let mut open = String::new();
        encode(&mut open, &registry).expect("a String takes it");
        assert!(open.contains("# TYPE stictiond_history_refused_samples counter\n"), "{open}");
        let plain = plain(&open);
        assert!(plain.contains("\nstictiond_history_refused_samples_total 0.0\n"), "{plain}");
        assert!(plain.contains("# TYPE stictiond_history_memory_bytes gauge\n"), "{plain}");
    }
}
