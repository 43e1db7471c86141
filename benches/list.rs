//! How fast the list of loops is answered: `cargo bench --bench list [-- --loops 100000]`.
//!
//! Loops of 20 sites in 1,000 units, each with a diagnosis as a centre has it from an edge, a third of them sticking, asked
//! over HTTP on loopback one after the other. Prints a table of the time until the whole answer is there.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Instant;
use stictiond::app::App;
use stictiond::config;
use stictiond::results::{Outcome, Run, Summary, Told, Trigger};
use stictiond::schedule::Clock;
use stictiond::signal::LoopId;
use tokio::net::TcpListener;

const SITES: usize = 20;
const UNITS: usize = 50;
/// Times that each is asked.
const TIMES: usize = 20;
const START: f64 = 1_767_225_600.0;

/// What is asked, and how it is called.
const ASKED: [(&str, &str); 7] = [
    ("a page by severity", "/api/v1/loops?limit=100"),
    ("a page by name", "/api/v1/loops?limit=100&sort=id"),
    ("sticking ones", "/api/v1/loops?limit=100&verdict=stiction"),
    ("search: one loop's name", "/api/v1/loops?limit=100&q=s07-fic-4711"),
    ("search: a letter that all have", "/api/v1/loops?limit=100&q=f"),
    ("search: nothing", "/api/v1/loops?limit=100&q=nowhere"),
    ("a unit", "/api/v1/loops?limit=100&group=s03/u17"),
];

type Failed = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failed> {
    let mut arguments = std::env::args().skip_while(|argument| argument != "--loops");
    let loops: usize = arguments.nth(1).map_or(Ok(100_000), |text| text.parse())?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(ask(loops))
}

async fn ask(loops: usize) -> Result<(), Failed> {
    let told =
        |wrong: Vec<config::Diagnostic>| wrong.iter().map(|d| d.to_string() + "\n").collect::<String>();
    let config = config::parse("list.toml", &configuration(loops)).map_err(told)?;
    let app = App::build(config, Clock::plant(START, 1.0), App::diagnosis())?;
    for at in 0..loops {
        app.results().learn(diagnosed(at), None, START);
    }
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?;
    tokio::spawn(axum::serve(listener, app.routes()).into_future());
    println!("| {loops} loops | answer, kB | median, ms | slowest, ms |\n|---|---|---|---|");
    let table = tokio::task::spawn_blocking(move || -> std::io::Result<()> {
        for (name, path) in ASKED {
            get(address, path)?;
            let (mut ms, mut bytes) = (Vec::with_capacity(TIMES), 0);
            for _ in 0..TIMES {
                let began = Instant::now();
                bytes = get(address, path)?;
                ms.push(1e3 * began.elapsed().as_secs_f64());
            }
            ms.sort_by(f64::total_cmp);
            println!("| {name} | {:.0} | {:.1} | {:.1} |", bytes as f64 / 1e3, ms[TIMES / 2], ms[TIMES - 1]);
        }
        Ok(())
    });
    Ok(table.await??)
}

fn id(at: usize) -> String {
    format!("S{:02}-FIC-{at:05}", at % SITES)
}

fn configuration(loops: usize) -> String {
    let mut text = "[history]\nsamples_per_tag = 200\n[[modbus]]\nname = \"d\"\naddress = \"127.0.0.1:1\"\naddress_base = 0\n".to_string();
    for at in 0..loops {
        let (site, unit, register) = (at % SITES, at / SITES % UNITS, at % 10_000 * 4);
        text += &format!(
            "[[loop]]\nid = \"{}\"\ngroup = \"S{site:02}/U{unit:02}\"\ndescription = \"Feed {at} to column {unit}\"\nop_span = 100.0\n\
             op = {{ device = \"d\", register = \"holding\", address = {register}, type = \"f32\" }}\n\
             pv = {{ device = \"d\", register = \"holding\", address = {}, type = \"f32\" }}\n",
            id(at),
            register + 2
        );
    }
    text
}

/// A diagnosis of another machine.
fn diagnosed(at: usize) -> Run {
    let sticks = at.is_multiple_of(3);
    let summary = Summary {
        time: START - (at % 3600) as f64,
        took_s: 0.1,
        trigger: Trigger::Periodic,
        outcome: if sticks { "stiction" } else { "no_stiction" }.into(),
        reason_code: None,
        reason: "f 0.52 % OP [0.47, 0.58], 431 better than the best explanation without friction".into(),
        f: sticks.then_some(0.1 + (at % 977) as f64 / 200.0),
        f_ci95: sticks.then_some([0.05, 6.0]),
        f_in_percent: true,
        delta_aic: Some((at % 1009) as f64),
        compensated: None,
    };
    Run {
        id: LoopId::new(id(at)),
        started: summary.time - 0.1,
        finished: summary.time,
        took_s: summary.took_s,
        trigger: summary.trigger,
        op_span: Some(100.0),
        basis: None,
        outcome: Outcome::Elsewhere(Box::new(Told {
            summary,
            report: Some("{}".into()),
            quality: "good".into(),
            doubtful: false,
            effects: Vec::new(),
            structure: None,
            unexplained: None,
        })),
    }
}

fn get(to: SocketAddr, path: &str) -> std::io::Result<usize> {
    let mut stream = TcpStream::connect(to)?;
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {to}\r\nconnection: close\r\n\r\n")?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    if !text.starts_with("HTTP/1.1 200") {
        return Err(std::io::Error::other(text.lines().next().unwrap_or_default().to_string()));
    }
    Ok(text.len())
}
