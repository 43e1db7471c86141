use super::super::device::Device;
use super::*;
use crate::config::{self, Config};
use crate::results::Results;
use crate::schedule::Clock;
use std::sync::Arc;

/// One loop that has write-back, off.
pub(in crate::app) fn config() -> Config {
    let tag = |role: &str, address: u8, own: &str| {
        format!("[loop.{role}]\ndevice = 'd'\nregister = 'holding'\naddress = {address}\n{own}\n")
    };
    let [op, pv, sp] = [("op", 0), ("pv", 2), ("sp", 4)].map(|(role, at)| tag(role, at, "type = 'f32'"));
    let mode = tag("mode", 6, "type = 'u16'\nauto_values = [1]");
    let text = format!(
        "[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n[[loop]]\nid = 'A'\nop_span = 100.0\n\
         op_limits = [0.0, 100.0]\nfrozen_pv_s = 60.0\n{op}{pv}{sp}{mode}[loop.writeback]\ndevice = 'd'\n\
         term_address = 100\nterm_type = 'f32'\nterm_byte_order = 'ABCD'\nterm_scale_percent = 1.0\n\
         heartbeat_address = 102\nheartbeat_timeout_ms = 10000\nwrite_ms = 1000\ntimeout_ms = 500\n\
         clamp_percent = 3.0\nrate_percent_per_s = 5.0\nwithdraw_percent_per_s = 1.0\nwithdraw_limit_s = 20.0\n\
         dead_band_percent = 0.1\nrest_ms = 3000\nmax_step_ms = 4000\nclock_tolerance_ms = 1000\n\
         max_sample_age_ms = 5000\nmax_missed_polls_per_minute = 5\nop_margin_percent = 5.0\nsp_rate_per_s = 0.1\n\
         sp_settle_s = 60.0\nevidence_max_age_s = 86400.0\nf_margin_percent = 0.2\ngrant_max_s = 28800.0\n\
         measure_s = 3600.0\nprove_s = 7200.0\nise_gain = 1.5\nise_limit = 1.5\ntravel_limit = 10.0\n\
         reversal_band_percent = 0.2\n"
    );
    config::parse("f", &text).unwrap_or_else(|errors| panic!("{errors:?}"))
}

/// The rings of a configuration, and its results.
pub(super) fn parts(config: &Config) -> (Arc<History>, Arc<Results>) {
    let wired = config.plant().expect("it was checked");
    let history = Arc::new(History::new(&wired.loops, &config.history));
    (history, Arc::new(Results::new(&[LoopId::new("A")], 3, &config.alarm)))
}

#[tokio::test]
async fn a_term_of_a_daemon_that_was_killed_ended_as_the_dcs_dropped_it() {
    let config = config();
    let (history, results) = parts(&config);
    let ring =
        history.tag_index(&LoopId::new("A"), &TagKind::Role(Role::Term)).and_then(|at| history.ring(at));
    let ring = ring.expect("a loop with write-back has a term");
    let control = WritebackControl::new(&config, Clock::wall(), &results).expect("nothing to open");
    let begin = || control.begin(&config, &history, &[] as &[Device]);
    begin();
    assert_eq!(ring.latest(), None, "where there was no term nothing is said of one");
    ring.push(Sample::good(1.0, 2.3));
    begin();
    // It is recorded again each 60 s while it is in force, and the DCS has a time-out of 10 s.
    assert_eq!(ring.latest(), Some(Sample::good(71.0, 0.0)), "and not as of now");
    begin();
    assert_eq!(ring.pushed(), 2, "it ends once");
    let ago = Clock::wall().now() - 5.0;
    ring.push(Sample::good(ago, 2.3));
    begin();
    let last = ring.latest().expect("there");
    assert!(
        last.value == 0.0 && (ago + 5.0..ago + 60.0).contains(&last.t),
        "it may still be in force: {last:?}"
    );
}
