//! Alerts for Prometheus' Alertmanager, by its API v2. What stands is sent again and again until it is over; what is over is
//! said for a while, so that an Alertmanager that was down or was started again hears of it too.

mod config;
mod table;

pub use config::Config;

use super::notice::Source;
use super::outlet::{Heard, News};
use super::payload;
use super::state::State;
use super::{http::Endpoint, secret, time};
use crate::results::Event;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hyper::header::{AUTHORIZATION, HeaderName, HeaderValue};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use table::Table;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{error, info, warn};

/// Alerts in one request.
const CHUNK: usize = 200;
/// How long others are waited for after something happened.
const GATHER: Duration = Duration::from_millis(500);
/// First pause after a failure.
const FIRST_PAUSE: Duration = Duration::from_secs(1);

/// Keeps one Alertmanager informed.
pub struct Informer {
    config: Config,
    endpoint: Endpoint,
    source: Source,
    state: Arc<State>,
    /// Taken when it begins.
    news: Option<News>,
}

/// Whether alerts are sent soon after this was heard; `None` where nothing more will be. What it says is looked up then.
fn soon(heard: Result<Heard, RecvError>) -> Option<bool> {
    Some(match heard {
        Ok(Heard::Untold(untold)) => {
            untold.keep();
            true
        }
        Ok(Heard::Event(Event::Alarm(_) | Event::Reloaded { .. })) | Err(RecvError::Lagged(_)) => true,
        Ok(Heard::Event(_)) => false,
        Err(RecvError::Closed) => return None,
    })
}

impl Informer {
    /// Hears of everything from now on.
    ///
    /// # Errors
    /// Why its address cannot be used; `check` says so before.
    pub fn new(config: &Config, source: Source, state: Arc<State>) -> Result<Self, String> {
        let (config, endpoint, news) = (config.clone(), config.endpoint()?, Some(source.news()));
        Ok(Self { config, endpoint, source, state, news })
    }

    /// Informs until `stop` is cancelled. Alerts that stand then stand on until they expire: a restart goes on with them.
    pub async fn run(mut self, stop: CancellationToken) {
        let mut table = Table::default();
        let mut random = Pcg32::seed_from_u64(time::wall().to_bits());
        let (mut next, mut failures) = (Instant::now(), 0u32);
        let Some(mut news) = self.news.take() else { return };
        loop {
            tokio::select! {
                () = stop.cancelled() => break,
                heard = news.recv() => {
                    let Some(soon) = soon(heard) else { break };
                    // After a failure its own pause counts.
                    if soon && failures == 0 {
                        next = next.min(Instant::now() + GATHER);
                    }
                }
                () = sleep_until(next) => {
                    let mut meanwhile = false;
                    let informed = {
                        let mut informing = pin!(self.inform(&mut table));
                        loop {
                            // Who hands news over waits for no Alertmanager.
                            tokio::select! {
                                () = stop.cancelled() => break None,
                                informed = &mut informing => break Some(informed),
                                heard = news.recv() => match soon(heard) {
                                    Some(soon) => meanwhile |= soon,
                                    None => break None,
                                },
                            }
                        }
                    };
                    let Some(informed) = informed else { break };
                    let again = Duration::try_from_secs_f64(self.config.resend_s).unwrap_or_default();
                    let pause = match informed {
                        Ok(()) => {
                            failures = 0;
                            if meanwhile { GATHER } else { again }
                        }
                        Err(why) => {
                            if self.state.refused(&why, (self.source.now)()) {
                                warn!(receiver = self.config.name, "alerts were not taken: {why}");
                            }
                            let factor = 1u32.checked_shl(failures).unwrap_or(u32::MAX);
                            failures = failures.saturating_add(1);
                            FIRST_PAUSE.saturating_mul(factor).min(again).mul_f64(random.random_range(0.5..1.0))
                        }
                    };
                    next = Instant::now() + pause;
                }
            }
        }
        while let Ok(untold) = news.try_recv() {
            untold.keep();
        }
    }

    /// Sends everything that stands and what is over.
    async fn inform(&self, table: &mut Table) -> Result<(), String> {
        if !self.source.speaks() {
            // Another machine of the fleet informs.
            return Ok(());
        }
        let (source, filter, now) = (self.source.clone(), self.config.filter.clone(), (self.source.now)());
        let mut own = std::mem::take(table);
        let expires = now + self.config.expires_s;
        let looked_up = spawn_blocking(move || {
            own.update(&source, &filter, now);
            let alerts = own.alerts(expires);
            let bodies: Vec<String> = alerts.chunks(CHUNK).map(payload::alerts).collect();
            let standing = own.standing();
            (own, bodies, standing)
        });
        let (own, bodies, standing) = looked_up.await.map_err(|error| {
            error!(receiver = self.config.name, %error, "alerts could not be made");
            error.to_string()
        })?;
        *table = own;
        self.state.queue.store(standing as u64, Relaxed);
        let bodies = match bodies.is_empty() {
            true if !self.state.is_failing() => return Ok(()),
            // Nothing is left to tell, and whether it takes alerts again is known by asking only.
            true => vec![payload::alerts(&[])],
            false => bodies,
        };
        let limit = Duration::try_from_secs_f64(self.config.timeout_s).unwrap_or_default();
        let headers = self.headers().await?;
        // One that is refused does not keep the others back.
        let mut refused = None;
        for body in bodies {
            let answer = self.endpoint.post(headers.clone(), body.into_bytes(), limit).await?;
            if !answer.status.is_success() {
                refused.get_or_insert(format!("{} {}", answer.status, answer.text));
            }
        }
        if let Some(why) = refused {
            return Err(why);
        }
        self.state.queue.store(0, Relaxed);
        if self.state.took(now) {
            info!(receiver = self.config.name, "takes alerts again");
        }
        Ok(())
    }

    async fn headers(&self) -> Result<Vec<(HeaderName, HeaderValue)>, String> {
        let Some((user, password)) = self.config.login() else { return Ok(Vec::new()) };
        let read =
            spawn_blocking(move || secret::lines(&password)).await.map_err(|error| error.to_string())?;
        let password = read?.into_iter().next().unwrap_or_default();
        let basic = format!("Basic {}", STANDARD.encode(format!("{user}:{password}")));
        let mut value = HeaderValue::from_str(&basic).map_err(|error| error.to_string())?;
        value.set_sensitive(true);
        Ok(vec![(AUTHORIZATION, value)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm;
    use crate::notify::notice::Places;
    use crate::results::Results;
    use std::sync::RwLock;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    fn informer(port: u16, state: Arc<State>) -> Informer {
        let source = Source {
            results: Arc::new(Results::new(&[], 5, &alarm::Config::default())),
            places: Arc::new(RwLock::new(Arc::new(Places::default()))),
            now: Arc::new(|| 0.0),
            site: None,
            public_url: None,
            outlet: None,
        };
        let config = Config {
            name: "it".into(),
            url: format!("http://127.0.0.1:{port}"),
            allow_plain_http: false,
            ca_file: None,
            user: None,
            password_file: None,
            password_env: None,
            timeout_s: 5.0,
            resend_s: 60.0,
            expires_s: 300.0,
            filter: crate::notify::Filter::default(),
        };
        Informer::new(&config, source, state).unwrap()
    }

    #[tokio::test]
    async fn one_that_fails_is_asked_though_nothing_is_left_to_tell() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let answering = tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let (mut request, mut chunk) = (Vec::new(), [0; 1024]);
            while !request.ends_with(b"\r\n\r\n[]") {
                let n = stream.read(&mut chunk).await.unwrap();
                assert!(n > 0, "{}", String::from_utf8_lossy(&request));
                request.extend(&chunk[..n]);
            }
            stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n").await.unwrap();
        });
        let state = Arc::new(State::default());
        let informer = informer(port, state.clone());
        informer.inform(&mut Table::default()).await.unwrap();
        assert_eq!(state.snapshot().sent, 0, "there is nothing to tell and nothing to find out");
        state.refused("away", 0.0);
        informer.inform(&mut Table::default()).await.unwrap();
        assert_eq!((state.snapshot().failing, state.snapshot().sent), (None, 1));
        answering.await.unwrap();
    }
}
