//! What a sample costs on its way from an edge to a centre: `cargo bench --bench fleet [-- --loops 1000,5000,20000]`.
//!
//! Loops of three tags at 1 Hz, a message of 5 s for each, half a minute of plant: packed as an edge does, sent through a
//! nats-server of Debian with JetStream, read and unpacked as a centre does, and written to its store. Processor time of each
//! stage is that of the process in which it runs; bytes are those of the messages and of the files. Prints a table.

#[path = "../tests/peers/nats.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod nats;

use nats::Nats;
use prost::Message;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use stictiond::fleet::config::Config;
use stictiond::fleet::convert::block;
use stictiond::fleet::link::{Link, Outgoing};
use stictiond::fleet::message::{Place, Samples};
use stictiond::fleet::streams::SAMPLES;
use stictiond::fleet::subject::{Subject, What, all};
use stictiond::signal::Sample;
use stictiond::store::{self, Batch, Series, Store, TagName, codec};

/// Seconds of plant in a message, and messages of a loop.
const SECONDS: usize = 5;
const ROUNDS: usize = 6;
const TAGS: [&str; 3] = ["op", "pv", "sp"];
const START: f64 = 1_763_700_000.0;
/// Samples of a window that a worker gets.
const WINDOW: usize = 1000;

type Failed = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failed> {
    let mut arguments = std::env::args().skip_while(|argument| argument != "--loops");
    let loops = arguments.nth(1).unwrap_or_else(|| "1000,5000,20000".into());
    println!(
        "| loops | edge packs, µs | message, bytes | edge sends, µs | NATS, µs | NATS on disk, bytes | centre reads and unpacks, µs \
         | centre stores, µs | store on disk, bytes |\n|---|---|---|---|---|---|---|---|---|"
    );
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    for loops in loops.split(',') {
        let costs = runtime.block_on(measure(loops.trim().parse()?))?;
        println!("| {loops} | {} |", costs.map(|cost| format!("{cost:.2}")).join(" | "));
    }
    let samples = values("FIC1", 0, WINDOW);
    let bytes: usize = samples.iter().map(|samples| block("pv", "", samples).block.len()).sum();
    println!("\neach for one sample; a window of {WINDOW} rows of {} tags is {bytes} bytes", TAGS.len());
    Ok(())
}

/// The costs of a sample at each stage, in the order of the table.
async fn measure(loops: usize) -> Result<[f64; 8], Failed> {
    let hub = Nats::hub();
    let folder = std::env::temp_dir().join(format!("stictiond-bench-fleet-{}-{loops}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    let config: Config = toml::from_str(&format!("servers = [{:?}]\nsamples_mb = 1000", hub.url()))?;
    let link = Link::connect(&config, "bench").await?;
    while !link.is_up() {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    link.make_streams(&config).await?;
    let mut store = Store::open(&store::Config { max_mb: 1_000_000, ..store::Config::new(&folder) })?;
    let [mut packs, mut sends, mut nats, mut unpacks, mut stores] = [0.0; 5];
    let mut bytes = 0;
    for round in 0..ROUNDS {
        let measured: Vec<(String, [Vec<Sample>; 3])> = (0..loops)
            .map(|i| format!("FIC{i}"))
            .map(|id| (id.clone(), values(&id, round * SECONDS, SECONDS)))
            .collect();
        let before = cpu_s("self");
        let messages: Vec<Outgoing> = measured.iter().map(|(id, samples)| packed(id, samples)).collect();
        packs += cpu_s("self") - before;
        drop(measured);
        bytes += messages.iter().map(|message| message.body.len()).sum::<usize>();
        let (before, server) = (cpu_s("self"), cpu_s(&hub.pid()));
        link.send(&messages).await.map_err(|(_, error)| error)?;
        sends += cpu_s("self") - before;
        drop(messages);
        let before = cpu_s("self");
        let batch = unpacked(&link, loops).await?;
        unpacks += cpu_s("self") - before;
        nats += cpu_s(&hub.pid()) - server;
        let before = cpu_s("self");
        store.write(&batch)?;
        store.tidy(START + ((round + 1) * SECONDS) as f64)?;
        stores += cpu_s("self") - before;
    }
    let before = cpu_s("self");
    store.tidy(START + 1e4)?;
    stores += cpu_s("self") - before;
    let samples = (loops * TAGS.len() * SECONDS * ROUNDS) as f64;
    let kept = store.usage()?.used_bytes as f64;
    let on_disk = size(&hub.folder().join("js"));
    let _ = fs::remove_dir_all(&folder);
    let us = |s: f64| s * 1e6 / samples;
    Ok([
        us(packs),
        bytes as f64 / samples,
        us(sends),
        us(nats),
        on_disk as f64 / samples,
        us(unpacks),
        us(stores),
        kept / samples,
    ])
}

/// OP as a register of hundredths, PV as a single float with noise, SP that stands still.
fn values(id: &str, from: usize, n: usize) -> [Vec<Sample>; 3] {
    let mut state =
        id.bytes().fold(7 + from as u64, |state, byte| state.wrapping_mul(31).wrapping_add(u64::from(byte)));
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut out = [Vec::new(), Vec::new(), Vec::new()];
    for k in from..from + n {
        let (t, wave) = (START + k as f64 + 1e-3 * random(), (0.05 * k as f64).sin());
        let op = (5000.0 + 800.0 * wave + 10.0 * random()).round() * 0.01;
        let pv = f64::from((50.0 + 5.0 * wave + 0.2 * random()) as f32);
        out.iter_mut().zip([op, pv, 50.0]).for_each(|(tag, value)| tag.push(Sample::good(t, value)));
    }
    out
}

/// As an edge sends it.
fn packed(id: &str, samples: &[Vec<Sample>; 3]) -> Outgoing {
    let source = |tag: &str| format!("modbus 10.0.0.1 unit 1 holding {id} {tag}");
    let place = |(tag, samples): (&&str, &Vec<Sample>)| Place {
        tag: (*tag).to_string(),
        source: source(tag),
        last: samples.last().map_or(f64::NAN, |sample| sample.t),
    };
    let message = Samples {
        tags: TAGS.iter().zip(samples).map(|(tag, samples)| block(tag, &source(tag), samples)).collect(),
        places: TAGS.iter().zip(samples).map(place).collect(),
        edge: "edge-north".to_string(),
    };
    Outgoing::once(Subject::new("north", id, What::Samples).to_string(), message.encode_to_vec())
}

/// As a centre takes it.
async fn unpacked(link: &Link, messages: usize) -> Result<Batch, Failed> {
    let filter = all(None, What::Samples);
    let mut reading = link.read(SAMPLES, "centre", &filter).await?;
    let (mut batch, mut taken) = (Batch::default(), 0);
    while taken < messages {
        for message in reading.next(500, Duration::from_secs(5)).await? {
            let subject = Subject::read(message.subject()).ok_or("another subject")?;
            for tag in Samples::decode(message.body())?.tags {
                let samples = codec::decode(&tag.block).ok_or("a damaged block")?;
                let name = TagName {
                    control_loop: format!("{}:{}", subject.site, subject.name),
                    tag: tag.tag,
                    source: tag.source,
                    unit: "%".into(),
                };
                batch.series.push(Series { tag: Arc::new(name), samples });
            }
            message.done().await?;
            taken += 1;
        }
    }
    Ok(batch)
}

/// Processor time of a process (s).
fn cpu_s(process: &str) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let behind = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks: f64 =
        behind.split_whitespace().skip(11).take(2).filter_map(|field| field.parse::<f64>().ok()).sum();
    ticks / 100.0
}

/// Bytes of all files below a folder.
fn size(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.metadata() {
            Ok(found) if found.is_dir() => size(&entry.path()),
            Ok(found) => found.len(),
            Err(_) => 0,
        })
        .sum()
}
