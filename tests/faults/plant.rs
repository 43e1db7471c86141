//! The plant that is simulated: two devices, up to three loops, and the configurations between which it is reloaded.

use hyper_util::service::TowerToHyperService;
use std::path::Path;
use stictiond::app::App;
use stictiond::config::{self, Config};
use stictiond::store;

pub const LOOPS: [&str; 3] = ["A", "B", "C"];
/// Runs of a loop that are remembered.
pub const KEEP: usize = 8;
/// A device is down after so long without a good sample (s).
pub const DOWN_AFTER_S: f64 = 12.0;
/// An alarm tells of a bad tag after so long (s).
pub const TAG_BAD_AFTER_S: f64 = 6.0;
/// Time between two polls (s), and between two looks at what tags are like (s).
pub const POLL_S: f64 = 1.0;
pub const TICK_S: f64 = 1.0;
/// Time between two diagnoses of a loop (s).
pub const PERIOD_S: f64 = 7.0;
/// Configurations that there are.
pub const VARIANTS: usize = 4;

/// One of the configurations.
pub fn config(variant: usize, folder: &Path) -> Config {
    let mut text = format!(
        "[schedule]\nperiod_s = {PERIOD_S:?}\nkeep_results = {KEEP}\n[history]\nsamples_per_tag = 400\n\
         [alarm.collector_down]\nafter_s = {DOWN_AFTER_S:?}\n[alarm.tag_bad]\nafter_s = {TAG_BAD_AFTER_S:?}\n"
    );
    for (device, framing) in [("d0", "tcp"), ("d1", "rtu")] {
        text += &format!(
            "[[modbus]]\nname = \"{device}\"\naddress = \"{device}:502\"\nframing = \"{framing}\"\npoll_ms = 1000\n\
             timeout_ms = 400\nreconnect_max_ms = 4000\naddress_base = 0\nmax_gap = 2\n"
        );
    }
    // A loop, and of OP and PV the device and the register.
    let a = if variant == 2 { ("A", 0, 0, 0, 10) } else { ("A", 0, 0, 0, 2) };
    let (b, c) = (("B", 0, 4, 1, 0), ("C", 0, 6, 0, 14));
    let loops = match variant {
        0 | 2 => vec![a, b],
        1 => vec![c, a, b],
        _ => vec![b],
    };
    for (id, op_device, op, pv_device, pv) in loops {
        text += &format!("[[loop]]\nid = \"{id}\"\nop_span = 100.0\n");
        for (role, device, address) in [("op", op_device, op), ("pv", pv_device, pv)] {
            text += &format!(
                "[loop.{role}]\ndevice = \"d{device}\"\nregister = \"holding\"\naddress = {address}\ntype = \"u32\"\n"
            );
        }
    }
    let mut config = config::parse("plant.toml", &text).unwrap_or_else(|wrong| panic!("{wrong:?}\n{text}"));
    config.store = Some(store::Config { chunk_s: 60, ..store::Config::new(folder) });
    config
}

/// The devices that a loop's tags are read from, whatever the configuration.
pub fn devices(id: &str) -> &'static [usize] {
    if id == "B" { &[0, 1] } else { &[0] }
}

/// What the daemon counts: by what is counted (`device`, `store`) and event.
pub async fn told(app: &App) -> Result<impl Fn(&str, &str) -> f64 + use<>, String> {
    use hyper::service::Service;
    let request = axum::http::Request::get("/metrics").header("host", "localhost");
    let request = request.body(axum::body::Body::empty()).expect("a request");
    let answer = TowerToHyperService::new(app.routes()).call(request).await.expect("it answers");
    let body = axum::body::to_bytes(answer.into_body(), 1 << 24).await.map_err(|error| error.to_string())?;
    let text = String::from_utf8_lossy(&body).into_owned();
    Ok(move |what: &str, event: &str| {
        let (series, event) = (format!("stictiond_{what}_events_total"), format!("event=\"{event}\""));
        let own = text.lines().filter(|line| line.starts_with(&series) && line.contains(&event));
        own.filter_map(|line| line.rsplit(' ').next()?.parse::<f64>().ok()).sum()
    })
}
