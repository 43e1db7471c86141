//! Reads from the API of a running demo what it says of its loops.

use super::rates::Diagnosis;
use serde_json::Value;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Diagnoses that are asked for at once.
const PAGE: usize = 20;

/// The answer of the API at `address` to a GET.
pub async fn get(address: SocketAddr, path: &str) -> Result<Value, String> {
    let failed = |error: std::io::Error| format!("GET {path}: {error}");
    let mut stream = TcpStream::connect(address).await.map_err(failed)?;
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.map_err(failed)?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.map_err(failed)?;
    let parts = answer.split_once("\r\n\r\n").filter(|(head, _)| head.starts_with("HTTP/1.1 200"));
    let (_, body) = parts.ok_or_else(|| format!("GET {path}: {answer}"))?;
    serde_json::from_str(body).map_err(|error| format!("GET {path}: {error}"))
}

/// A reader that looks at every loop as often as it is diagnosed. The list of a loop's diagnoses has no effects, so that they are
/// taken from each report while it is the latest.
pub struct Reader {
    address: SocketAddr,
    /// Kinds of the effects, by loop and time.
    effects: BTreeMap<(String, String), Vec<String>>,
}

impl Reader {
    /// Of the API at this address.
    pub fn new(address: SocketAddr) -> Self {
        Self { address, effects: BTreeMap::new() }
    }

    /// The list of loops. The report of each diagnosis that is new is read.
    pub async fn look(&mut self) -> Result<Value, String> {
        let list = get(self.address, "/api/v1/loops?limit=1000").await?;
        let items = list["items"].as_array().ok_or("the list of loops has no items")?;
        for item in items {
            let (Some(id), Some(time)) = (item["id"].as_str(), item["time"].as_str()) else { continue };
            if !self.has_read(id, time) {
                self.read(id).await?;
            }
        }
        Ok(list)
    }

    fn has_read(&self, id: &str, time: &str) -> bool {
        self.effects.contains_key(&(id.to_string(), time.to_string()))
    }

    /// Reads the latest report of a loop.
    async fn read(&mut self, id: &str) -> Result<(), String> {
        let report = get(self.address, &format!("/api/v1/loops/{id}/diagnosis")).await?;
        let (time, effects) = (report["time"].as_str(), report["residual"]["effects"].as_array());
        let (time, effects) =
            time.zip(effects).ok_or_else(|| format!("the report of {id} is none: {report}"))?;
        let kinds = effects.iter().filter_map(|effect| effect["kind"].as_str().map(str::to_string));
        self.effects.insert((id.to_string(), time.to_string()), kinds.collect());
        Ok(())
    }

    /// Every diagnosis of a loop that the daemon remembers, newest first, page by page.
    pub async fn diagnoses(&mut self, id: &str) -> Result<Vec<Diagnosis>, String> {
        let mut all = Vec::new();
        let mut after = String::new();
        loop {
            let path = format!("/api/v1/loops/{id}/diagnoses?limit={PAGE}{after}");
            let page = get(self.address, &path).await?;
            let items = page["items"].as_array().ok_or_else(|| format!("GET {path}: no items"))?;
            for item in items {
                all.push(Diagnosis::of(item).ok_or_else(|| format!("GET {path}: {item}"))?);
            }
            match page["next"].as_str() {
                Some(next) => after = format!("&after={next}"),
                None => break,
            }
        }
        // The newest may have ended since the last look.
        if all.first().is_some_and(|own| own.has_report() && !self.has_read(id, &own.time)) {
            self.read(id).await?;
        }
        for own in &mut all {
            let known = self.effects.get(&(id.to_string(), own.time.clone())).cloned();
            // A run that failed names nothing.
            own.effects = if own.has_report() { known } else { Some(Vec::new()) };
        }
        Ok(all)
    }
}
