//! Between the client and the servers. The client's library opens a socket of its own and keeps what comes until a line or a
//! message ends. So it connects to us, on loopback, and here it is counted what a server says before the library has it. What
//! is encrypted cannot be counted: certificates are checked here, too.
//!
//! Others on this machine may connect to us as well. They are not let through, because our client gives a secret of this run
//! in place of its name.

use super::config::Config;
use super::digest::hex;
use super::login;
use super::ops::{LOG, MOST_LINE, Refused, Watch};
use crate::dial;
use async_nats::{Event, ServerAddr};
use serde_json::{Map, Value};
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, split};
use tokio::net::{TcpListener, TcpStream, lookup_host};
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_util::sync::{CancellationToken, DropGuard};

/// Longest wait for one of a server's addresses to answer.
const REACHED: Duration = Duration::from_secs(2);
/// Longest time until both have said who they are.
const BEGUN: Duration = Duration::from_secs(10);
/// Longest wait for somebody to take what is passed on.
const TAKEN: Duration = Duration::from_secs(60);
/// Longest wait for a farewell.
const FAREWELL: Duration = Duration::from_secs(1);
/// Pause after there was no handle for a connection.
const PAUSE: Duration = Duration::from_millis(100);
/// Passed on at once (bytes).
const PIECE: usize = 1 << 16;
/// Connections at once. Our client has one; those before it may wait for a server that takes nothing any more.
const MOST: usize = 16;
/// Servers that are known, those included of which others tell.
const MOST_SERVERS: usize = 64;
/// Longest address of a server of which another tells (bytes).
const MOST_ADDRESS: usize = 256;

/// A stream to a server, encrypted or not.
trait Far: AsyncRead + AsyncWrite + Send + Unpin {}
impl<S: AsyncRead + AsyncWrite + Send + Unpin> Far for S {}

/// Where the client connects to, until this is dropped.
pub(super) struct Relay {
    address: SocketAddr,
    secret: String,
    _ends: DropGuard,
}

impl Relay {
    /// Begins to pass on what the client and the servers of the configuration say; they know the client by `name`.
    ///
    /// # Errors
    /// In one line.
    pub(super) async fn start(config: &Config, name: String) -> Result<Self, String> {
        let servers =
            config.servers.iter().map(|server| Server::of(server)).collect::<Result<Vec<_>, _>>()?;
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| format!("there are no random numbers: {error}"))?;
        let secret = hex(&bytes);
        let none = |error: io::Error| format!("there is no port on 127.0.0.1: {error}");
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.map_err(none)?;
        let address = listener.local_addr().map_err(none)?;
        let config = config.clone();
        let between = Between { config, name, secret: secret.clone(), servers: Mutex::new(servers) };
        let stop = CancellationToken::new();
        tokio::spawn(serve(listener, Arc::new(between), stop.clone()));
        Ok(Self { address, secret, _ends: stop.drop_guard() })
    }

    /// Where the client finds it.
    pub(super) fn url(&self) -> String {
        format!("nats://{}", self.address)
    }

    /// What the client calls itself.
    pub(super) fn secret(&self) -> &str {
        &self.secret
    }

    /// Logs what happens to the client's connection.
    pub(super) fn tell(&self, event: &Event) {
        tracing::info!(target: LOG, %event, "NATS");
    }
}

/// Takes connections until it is told to stop; they end with it.
async fn serve(listener: TcpListener, between: Arc<Between>, stop: CancellationToken) {
    let mut open = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            // Whoever keeps connecting must not keep it alive.
            biased;
            () = stop.cancelled() => return,
            accepted = listener.accept() => accepted,
        };
        while open.try_join_next().is_some() {}
        match accepted {
            Ok((near, _)) if open.len() < MOST => {
                let between = between.clone();
                open.spawn(async move { between.connection(near).await });
            }
            Ok(_) => {}
            Err(_) => sleep(PAUSE).await,
        }
    }
}

/// A server that may be connected to.
struct Server {
    address: ServerAddr,
    /// Attempts since it last let us in.
    failed: u32,
    /// Why the last attempt failed, as it was logged.
    told: Option<String>,
}

impl Server {
    fn of(address: &str) -> Result<Self, String> {
        let address = address.parse::<ServerAddr>().map_err(|error| format!("servers {address}: {error}"))?;
        Ok(Self { address, failed: 0, told: None })
    }
}

/// A connection on which both have said who they are, and what they said behind that.
struct Begun {
    far: Box<dyn Far>,
    from_far: Vec<u8>,
    from_near: Vec<u8>,
}

struct Between {
    config: Config,
    name: String,
    secret: String,
    servers: Mutex<Vec<Server>>,
}

impl Between {
    fn servers(&self) -> MutexGuard<'_, Vec<Server>> {
        self.servers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The server to try: one of those that failed least. Any of them, so that not all of a fleet are at one.
    fn chosen(&self) -> Option<ServerAddr> {
        let servers = self.servers();
        let least = servers.iter().map(|server| server.failed).min()?;
        let good: Vec<&Server> = servers.iter().filter(|server| server.failed == least).collect();
        let any = getrandom::u32().unwrap_or_default() as usize % good.len();
        Some(good[any].address.clone())
    }

    /// Remembers servers of which another told.
    fn learn(&self, others: Vec<ServerAddr>) {
        let mut servers = self.servers();
        for address in others {
            if servers.len() < MOST_SERVERS && servers.iter().all(|server| server.address != address) {
                servers.push(Server { address, failed: 0, told: None });
            }
        }
    }

    /// A server let us in.
    fn let_in(&self, at: &ServerAddr) {
        if let Some(server) = self.servers().iter_mut().find(|server| server.address == *at) {
            (server.failed, server.told) = (0, None);
        }
    }

    /// A server did not let us in, or what it sent was refused. A reason is logged unless it is the last one again.
    fn failed(&self, at: &ServerAddr, why: Option<String>) {
        let mut servers = self.servers();
        let Some(server) = servers.iter_mut().find(|server| server.address == *at) else { return };
        server.failed = server.failed.saturating_add(1);
        if let Some(why) = why.filter(|why| server.told.as_ref() != Some(why)) {
            tracing::warn!(target: LOG, server = at.as_url_str(), %why, "no connection with this NATS server");
            server.told = Some(why);
        }
    }

    /// One connection of the client's, from begin to end.
    async fn connection(&self, mut near: TcpStream) {
        let Some(at) = self.chosen() else { return };
        let _ = near.set_nodelay(true);
        let begun = timeout(BEGUN, self.begin(&mut near, &at)).await;
        let ended = match begun.unwrap_or_else(|_| Err(format!("no answer within {} s", BEGUN.as_secs()))) {
            Ok(Some(begun)) => self.pass(&mut near, begun, &at).await.map_err(|refused| refused.to_string()),
            Ok(None) => return,
            Err(why) => Err(why),
        };
        match ended {
            Ok(true) => {}
            Ok(false) => self.failed(&at, None),
            Err(why) => {
                self.failed(&at, Some(why));
                // An end without a word is a fault to the library, which it logs each time; a reset is what it is.
                let _ = near.set_zero_linger();
            }
        }
    }

    /// Connects to a server and hears both say who they are; nothing where it is not our client that asks.
    async fn begin(&self, near: &mut TcpStream, at: &ServerAddr) -> Result<Option<Begun>, String> {
        let mut far = reach(at).await?;
        let (line, from_far) = first_line(&mut far).await.map_err(|error| error.to_string())?;
        let said = Said::read(&line).ok_or("what it says of itself cannot be read")?;
        let encrypts = said.encrypts || self.encrypts(at);
        let mut far: Box<dyn Far> = match encrypts {
            false => Box::new(far),
            // What anybody on the way could have said would count as said by the server.
            true if !from_far.is_empty() => {
                return Err("it goes on before the connection is encrypted".into());
            }
            true => Box::new(self.encrypted(far, at).await?),
        };
        self.learn(said.others);
        if near.write_all(&said.shown).await.is_err() {
            return Ok(None);
        }
        let Ok((line, from_near)) = first_line(near).await else { return Ok(None) };
        let Some(mut greeting) = self.introduced(&line, encrypts) else { return Ok(None) };
        for (field, value) in self.proof(said.nonce).await? {
            greeting.insert(field.into(), value.into());
        }
        let text = serde_json::to_vec(&greeting).map_err(|error| error.to_string())?;
        let greeting = [b"CONNECT ".as_slice(), text.as_slice(), b"\r\n"].concat();
        far.write_all(&greeting).await.map_err(|error| error.to_string())?;
        Ok(Some(Begun { far, from_far, from_near }))
    }

    /// Whether a server is to encrypt, whatever it says.
    fn encrypts(&self, at: &ServerAddr) -> bool {
        at.tls_required() || self.config.servers.iter().all(|server| server.starts_with("tls://"))
    }

    async fn encrypted(&self, far: TcpStream, at: &ServerAddr) -> Result<TlsStream<TcpStream>, String> {
        let config = self.config.clone();
        let made = spawn_blocking(move || login::tls(&config)).await.map_err(|error| error.to_string())?;
        let name = ServerName::try_from(at.host().to_string()).map_err(|_| "the host's name is none")?;
        let connecting = TlsConnector::from(Arc::new(made?)).connect(name, far);
        connecting.await.map_err(|error| format!("no TLS: {error}"))
    }

    /// What lets this machine in, by fields of the protocol. It is read from its files for each connection: passwords, credentials and
    /// keys are replaced while we run.
    async fn proof(&self, nonce: String) -> Result<Vec<(&'static str, String)>, String> {
        let config = self.config.clone();
        spawn_blocking(move || login::proof(&config, &nonce)).await.map_err(|error| error.to_string())?
    }

    /// What the client says of itself, with its own name; nothing where it is not our client.
    fn introduced(&self, line: &[u8], is_encrypted: bool) -> Option<Map<String, Value>> {
        let mut said: Map<String, Value> = serde_json::from_slice(line.strip_prefix(b"CONNECT ")?).ok()?;
        if said.get("name").and_then(Value::as_str) != Some(self.secret.as_str()) {
            return None;
        }
        said.insert("name".into(), self.name.clone().into());
        said.insert("tls_required".into(), is_encrypted.into());
        Some(said)
    }

    /// Passes on what both say until one of them ends; whether the server let us in.
    async fn pass(&self, near: &mut TcpStream, begun: Begun, at: &ServerAddr) -> Result<bool, Refused> {
        let (mut near_read, mut near_write) = near.split();
        let (mut far_read, mut far_write) = split(begun.far);
        let (watch, mut is_in) = (Mutex::new(Watch::default()), false);
        let watched = || watch.lock().unwrap_or_else(PoisonError::into_inner);
        let down = carry(&mut far_read, &mut near_write, begun.from_far, |bytes| {
            if watched().server(bytes)? {
                is_in = true;
                self.let_in(at);
            }
            Ok(())
        });
        let up = carry(&mut near_read, &mut far_write, begun.from_near, |bytes| watched().client(bytes));
        let ended = tokio::select! {
            ended = down => ended,
            ended = up => ended,
        };
        ended.map(|()| is_in)
    }
}

/// Connects to the first address of a server that answers.
async fn reach(at: &ServerAddr) -> Result<TcpStream, String> {
    let nowhere = |error: io::Error| format!("its name has no address: {error}");
    let addresses: Vec<SocketAddr> = lookup_host((at.host(), at.port())).await.map_err(nowhere)?.collect();
    match timeout(REACHED, dial::to(addresses.as_slice())).await {
        Ok(dialled) => dialled.map_err(|error| format!("no connection: {error}")),
        Err(_) => Err(format!("no connection within {} s", REACHED.as_secs())),
    }
}

/// The first line of what comes, and what came with it.
async fn first_line(from: &mut (impl AsyncRead + Unpin)) -> io::Result<(Vec<u8>, Vec<u8>)> {
    let (mut line, mut piece) = (Vec::new(), [0; 4096]);
    while line.len() <= MOST_LINE {
        let n = from.read(&mut piece).await?;
        if n == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        // The last byte of the piece before may be half of the end.
        let looked_at = line.len().saturating_sub(1);
        line.extend_from_slice(&piece[..n]);
        if let Some(at) = line[looked_at..].windows(2).position(|two| two == b"\r\n") {
            let rest = line.split_off(looked_at + at + 2);
            return Ok((line, rest));
        }
    }
    Err(io::Error::new(io::ErrorKind::InvalidData, Refused::Line))
}

/// Passes on what one says to the other, who has it once it was `seen`, until one of them ends.
async fn carry(
    from: &mut (impl AsyncRead + Unpin),
    to: &mut (impl AsyncWrite + Unpin),
    first: Vec<u8>,
    mut seen: impl FnMut(&[u8]) -> Result<(), Refused>,
) -> Result<(), Refused> {
    let mut piece = vec![0; PIECE.max(first.len())];
    piece[..first.len()].copy_from_slice(&first);
    let mut n = first.len();
    loop {
        seen(&piece[..n])?;
        let written = async {
            to.write_all(&piece[..n]).await?;
            to.flush().await
        };
        if !matches!(timeout(TAKEN, written).await, Ok(Ok(()))) {
            return Ok(());
        }
        n = match from.read(&mut piece).await {
            Ok(0) | Err(_) => break,
            Ok(n) => n,
        };
    }
    let _ = timeout(FAREWELL, to.shutdown()).await;
    Ok(())
}

/// What a server says of itself.
struct Said {
    /// The same for a client behind us: it need not encrypt what stays on this machine, and connects to nobody else.
    shown: Vec<u8>,
    encrypts: bool,
    others: Vec<ServerAddr>,
    /// What it asks to be signed; empty where it asks for nothing.
    nonce: String,
}

impl Said {
    fn read(line: &[u8]) -> Option<Self> {
        let mut said: Map<String, Value> = serde_json::from_slice(line.strip_prefix(b"INFO ")?).ok()?;
        let encrypts = said.remove("tls_required") == Some(Value::Bool(true));
        let told = said.remove("connect_urls");
        let others = told.iter().filter_map(Value::as_array).flatten().filter_map(Value::as_str);
        let others = others.filter(|address| address.len() <= MOST_ADDRESS);
        let others = others.filter_map(|address| address.parse::<ServerAddr>().ok()).collect();
        let nonce = said.get("nonce").and_then(Value::as_str).unwrap_or_default().to_string();
        let text = serde_json::to_vec(&said).ok()?;
        let shown = [b"INFO ".as_slice(), text.as_slice(), b"\r\n"].concat();
        Some(Self { shown, encrypts, others, nonce })
    }
}

#[cfg(test)]
mod tests;
