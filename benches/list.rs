//! How fast the list of loops is answered: `cargo bench --bench list [-- --loops 100000]`.
//!
//! Loops of 20 sites in 1,000 units, each with a diagnosis as a centre has it from an edge, a third of them sticking, asked
//! over HTTP on loopback one after the other. Prints a table of the time until the whole answer is there. An answer without
//! the loops that were meant is an error.

#[path = "../tests/many/mod.rs"]
mod many;

use std::io::{Error, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Instant;

/// Times that each is asked.
const TIMES: usize = 20;
/// How the loops stand, one after the other: one in three sticks.
const LETTERS: &str = "SOO";

/// How it is called, what is asked, and how many loops are found.
const ASKED: [(&str, &str, Found); 9] = [
    ("a page by severity", "/api/v1/loops?limit=100", Found::All),
    ("a page by name", "/api/v1/loops?limit=100&sort=id", Found::All),
    ("sticking ones", "/api/v1/loops?limit=100&verdict=stiction", Found::Several),
    ("search: one loop's name", "/api/v1/loops?limit=100&q=s11:fic-04711", Found::One),
    ("search: a letter that all have", "/api/v1/loops?limit=100&q=f", Found::All),
    ("search: nothing", "/api/v1/loops?limit=100&q=nowhere", Found::Nothing),
    ("a site", "/api/v1/loops?limit=100&site=s03", Found::Several),
    ("a unit", "/api/v1/loops?limit=100&group=s03%20/%20U17", Found::Several),
    ("the map", "/api/v1/map", Found::All),
];

/// How many loops an answer is about.
#[derive(Clone, Copy)]
enum Found {
    All,
    Several,
    One,
    Nothing,
}

type Failed = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failed> {
    let mut arguments = std::env::args().skip_while(|argument| argument != "--loops");
    let loops: usize = arguments.nth(1).map_or(Ok(100_000), |text| text.parse())?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(ask(loops))
}

async fn ask(loops: usize) -> Result<(), Failed> {
    let own = many::loops(loops, LETTERS);
    let (address, _) = many::served(&own, many::machines(), |_| "{}".into()).await;
    println!("| {loops} loops | answer, kB | median, ms | slowest, ms |\n|---|---|---|---|");
    let table = tokio::task::spawn_blocking(move || -> std::io::Result<()> {
        for (name, path, found) in ASKED {
            check(name, &get(address, path)?, found, loops)?;
            let (mut ms, mut bytes) = (Vec::with_capacity(TIMES), 0);
            for _ in 0..TIMES {
                let began = Instant::now();
                bytes = get(address, path)?.len();
                ms.push(1e3 * began.elapsed().as_secs_f64());
            }
            ms.sort_by(f64::total_cmp);
            println!("| {name} | {:.0} | {:.1} | {:.1} |", bytes as f64 / 1e3, ms[TIMES / 2], ms[TIMES - 1]);
        }
        Ok(())
    });
    Ok(table.await??)
}

fn get(to: SocketAddr, path: &str) -> std::io::Result<String> {
    let mut stream = TcpStream::connect(to)?;
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {to}\r\nconnection: close\r\n\r\n")?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    if !text.starts_with("HTTP/1.1 200") {
        return Err(Error::other(text.lines().next().unwrap_or_default().to_string()));
    }
    Ok(text)
}

/// A request that finds nothing is fast, and says nothing of one that finds something.
fn check(name: &str, answer: &str, found: Found, loops: usize) -> std::io::Result<()> {
    let rest = answer.split_once("\"total\":").map_or("", |(_, rest)| rest);
    let total: Option<usize> = rest.split([',', '}']).next().and_then(|text| text.parse().ok());
    let is_right = |total: usize| match found {
        Found::All => total == loops,
        Found::Several => (2..loops).contains(&total),
        Found::One => total == 1,
        Found::Nothing => total == 0,
    };
    if total.is_some_and(is_right) {
        return Ok(());
    }
    Err(Error::other(format!("{name}: {total:?} of {loops} loops were found")))
}
