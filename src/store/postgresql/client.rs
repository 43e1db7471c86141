//! A connection that is asked one thing at a time, and for a bounded time: whether the other end ever answers is not in our
//! hands, and neither keep-alive nor the server's own limits notice what stands between and swallows everything.

use super::super::StoreError;
use super::super::backend::Beat;
use crate::bounded::{Bounded, POSTGRES};
use std::cell::Cell;
use std::fmt;
use std::future::Future;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::UnixStream;
use tokio::runtime::{Builder, Runtime};
use tokio::task::JoinHandle;
use tokio_postgres::config::Host;
use tokio_postgres::tls::{MakeTlsConnect, NoTls, TlsStream};
use tokio_postgres::types::ToSql;
use tokio_postgres::{Connection, Error, Row, Socket, Statement, ToStatement};

/// Longest wait for a connection that is let in, whatever the number of addresses.
const CONNECT: Duration = Duration::from_secs(10);
/// Longest wait for the other end to say farewell.
const FAREWELL: Duration = Duration::from_millis(200);
/// The server gives a statement up, and says so, this long before we give the server up.
const MARGIN: Duration = Duration::from_secs(3);

/// Values of a statement.
pub(super) type Values<'v> = &'v [&'v (dyn ToSql + Sync)];

/// The connection.
pub(super) struct Client {
    asking: Asking,
    /// `None` while it is dropped.
    inner: Option<tokio_postgres::Client>,
    driver: Option<JoinHandle<()>>,
}

/// What waits for an answer.
struct Asking {
    /// `None` while it is dropped.
    runtime: Option<Runtime>,
    /// Longest wait for an answer.
    patience: Duration,
    /// An answer did not come: whatever comes now belongs to another question.
    silent: Cell<bool>,
    /// Hears each answer.
    beat: Beat,
}

impl fmt::Debug for Client {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Client").field("closed", &self.is_closed()).finish_non_exhaustive()
    }
}

impl Asking {
    fn new(patience: Duration) -> Result<Self, StoreError> {
        let none = |error: io::Error| StoreError::Away(format!("there is nothing to connect with: {error}"));
        let runtime = Builder::new_current_thread().enable_all().build().map_err(none)?;
        Ok(Self { runtime: Some(runtime), patience, silent: Cell::new(false), beat: Beat::default() })
    }

    fn runtime(&self) -> Result<&Runtime, StoreError> {
        self.runtime.as_ref().ok_or_else(gone)
    }

    fn ask<T>(&self, answer: impl Future<Output = Result<T, Error>>) -> Result<T, StoreError> {
        if self.silent.get() {
            return Err(gone());
        }
        let bounded = async { tokio::time::timeout(self.patience, answer).await };
        match self.runtime()?.block_on(bounded) {
            Ok(answered) => {
                self.beat.heard();
                Ok(answered?)
            }
            Err(_) => {
                self.silent.set(true);
                Err(StoreError::Away(format!("no answer for {} s", self.patience.as_secs())))
            }
        }
    }
}

impl Drop for Asking {
    fn drop(&mut self) {
        // Who looks a name up may hang for as long as it takes, and nobody waits for what was given up.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn refused(error: Error) -> StoreError {
    StoreError::Away(super::said(&error))
}

fn gone() -> StoreError {
    StoreError::Away("the connection is given up".to_string())
}

impl Client {
    /// Connects and waits for at most `patience` for each answer from then on.
    ///
    /// # Errors
    /// [`StoreError::Away`].
    pub fn connect<T>(
        options: &tokio_postgres::Config,
        tls: T,
        patience: Duration,
    ) -> Result<Self, StoreError>
    where
        T: MakeTlsConnect<Socket>,
        T::Stream: Send + 'static,
    {
        let connecting = async { options.connect(tls).await.map_err(refused) };
        Self::driven(Asking::new(patience)?, connecting)
    }

    /// The same by a socket in the file system. A server that is stopped takes no connection: once the queue of those that wait
    /// for it is full, an attempt fails at once.
    ///
    /// # Errors
    /// [`StoreError::Away`].
    pub fn connect_here(options: &tokio_postgres::Config, patience: Duration) -> Result<Self, StoreError> {
        let port = options.get_ports().first().copied().unwrap_or(5432);
        let folder = options.get_hosts().iter().find_map(|host| match host {
            Host::Unix(folder) => Some(folder),
            Host::Tcp(_) => None,
        });
        let path = folder.ok_or_else(gone)?.join(format!(".s.PGSQL.{port}"));
        let away = |error: io::Error| {
            let why = match error.kind() {
                io::ErrorKind::WouldBlock => "nobody takes the connections that wait there".to_string(),
                _ => error.to_string(),
            };
            StoreError::Away(format!("{}: {why}", path.display()))
        };
        let connecting = async {
            let stream = UnixStream::connect(&path).await.map_err(away)?;
            options.connect_raw(Bounded::new(stream, POSTGRES), NoTls).await.map_err(refused)
        };
        Self::driven(Asking::new(patience)?, connecting)
    }

    fn driven<S, T>(
        asking: Asking,
        connecting: impl Future<Output = Result<(tokio_postgres::Client, Connection<S, T>), StoreError>>,
    ) -> Result<Self, StoreError>
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
        T: TlsStream + Unpin + Send + 'static,
    {
        let patience = asking.patience;
        let connecting = async { tokio::time::timeout(CONNECT, connecting).await };
        let silent = |_| StoreError::Away(format!("no answer within {} s of connecting", CONNECT.as_secs()));
        let (inner, connection) = asking.runtime()?.block_on(connecting).map_err(silent)??;
        // What it fails with is told to whoever asks next.
        let driver = asking.runtime()?.spawn(async move { drop(connection.await) });
        let mut client = Self { asking, inner: Some(inner), driver: Some(driver) };
        client.set_patience(patience)?;
        Ok(client)
    }

    /// Waits for this long from now on, and has the server give up a little earlier.
    pub fn set_patience(&mut self, patience: Duration) -> Result<(), StoreError> {
        self.asking.patience = patience;
        let server = patience.saturating_sub(MARGIN).as_millis();
        self.batch_execute(&format!("SET statement_timeout TO '{server}ms'"))
    }

    /// Has each answer told from now on.
    pub fn tell_answers(&mut self, to: Beat) {
        self.asking.beat = to;
    }

    /// Whether nothing will ever be answered any more.
    pub fn is_closed(&self) -> bool {
        self.asking.silent.get() || self.inner.as_ref().is_none_or(tokio_postgres::Client::is_closed)
    }

    /// Begins a transaction, which is rolled back unless it is committed.
    pub fn transaction(&mut self) -> Result<Transaction<'_>, StoreError> {
        let inner = self.inner.as_mut().ok_or_else(gone)?;
        Ok(Transaction { inner: self.asking.ask(inner.transaction())?, asking: &self.asking })
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        drop(self.inner.take());
        if let Some(driver) = self.driver.take().filter(|_| !self.asking.silent.get())
            && let Ok(runtime) = self.asking.runtime()
        {
            let farewell = async { tokio::time::timeout(FAREWELL, driver).await };
            drop(runtime.block_on(farewell));
        }
    }
}

/// A transaction.
pub(super) struct Transaction<'c> {
    inner: tokio_postgres::Transaction<'c>,
    asking: &'c Asking,
}

impl Transaction<'_> {
    /// Makes it durable.
    pub fn commit(self) -> Result<(), StoreError> {
        self.asking.ask(self.inner.commit())
    }

    /// A statement that is used more than once.
    pub fn prepare(&mut self, sql: &str) -> Result<Statement, StoreError> {
        self.asking.ask(self.inner.prepare(sql))
    }
}

/// Whoever can be asked.
pub(super) trait Ask {
    /// Any number of rows.
    fn query<S: ?Sized + ToStatement>(&mut self, sql: &S, values: Values<'_>)
    -> Result<Vec<Row>, StoreError>;
    /// How many rows it changed.
    fn execute<S: ?Sized + ToStatement>(&mut self, sql: &S, values: Values<'_>) -> Result<u64, StoreError>;
    /// Statements without values.
    fn batch_execute(&mut self, sql: &str) -> Result<(), StoreError>;
    /// Exactly one row.
    fn query_one<S: ?Sized + ToStatement>(&mut self, sql: &S, values: Values<'_>) -> Result<Row, StoreError>;
}

impl Ask for Client {
    fn query<S: ?Sized + ToStatement>(
        &mut self,
        sql: &S,
        values: Values<'_>,
    ) -> Result<Vec<Row>, StoreError> {
        self.asking.ask(self.inner.as_ref().ok_or_else(gone)?.query(sql, values))
    }

    fn execute<S: ?Sized + ToStatement>(&mut self, sql: &S, values: Values<'_>) -> Result<u64, StoreError> {
        self.asking.ask(self.inner.as_ref().ok_or_else(gone)?.execute(sql, values))
    }

    fn batch_execute(&mut self, sql: &str) -> Result<(), StoreError> {
        self.asking.ask(self.inner.as_ref().ok_or_else(gone)?.batch_execute(sql))
    }

    fn query_one<S: ?Sized + ToStatement>(&mut self, sql: &S, values: Values<'_>) -> Result<Row, StoreError> {
        self.asking.ask(self.inner.as_ref().ok_or_else(gone)?.query_one(sql, values))
    }
}

impl Ask for Transaction<'_> {
    fn query<S: ?Sized + ToStatement>(
        &mut self,
        sql: &S,
        values: Values<'_>,
    ) -> Result<Vec<Row>, StoreError> {
        self.asking.ask(self.inner.query(sql, values))
    }

    fn execute<S: ?Sized + ToStatement>(&mut self, sql: &S, values: Values<'_>) -> Result<u64, StoreError> {
        self.asking.ask(self.inner.execute(sql, values))
    }

    fn batch_execute(&mut self, sql: &str) -> Result<(), StoreError> {
        self.asking.ask(self.inner.batch_execute(sql))
    }

    fn query_one<S: ?Sized + ToStatement>(&mut self, sql: &S, values: Values<'_>) -> Result<Row, StoreError> {
        self.asking.ask(self.inner.query_one(sql, values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::embedded::tests::Folder;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
    use std::sync::mpsc::channel;
    use tokio::net::UnixSocket;

    /// A postmaster that is stopped: what connects to it stays in its queue, until that is full.
    #[test]
    fn a_socket_whose_queue_is_full_is_an_error_and_no_wait_for_ever() {
        let folder = Folder::new();
        std::fs::create_dir_all(&folder.0).expect("writable");
        let path = folder.0.join(".s.PGSQL.5432");
        let runtime = Builder::new_current_thread().enable_all().build().expect("a runtime");
        let (listener, queue) = runtime.block_on(async {
            let socket = UnixSocket::new_stream().expect("a socket");
            socket.bind(&path).expect("a free name");
            let listener = socket.listen(1).expect("listens");
            let mut queue = Vec::new();
            while let Ok(waiting) = UnixStream::connect(&path).await {
                queue.push(waiting);
                assert!(queue.len() < 100, "the queue has an end");
            }
            (listener, queue)
        });
        assert!(!queue.is_empty(), "somebody waits");
        let mut options = tokio_postgres::Config::new();
        options.host_path(&folder.0).user("stictiond");
        let (tell, told) = channel();
        std::thread::spawn(move || {
            let connected = Client::connect_here(&options, Duration::from_secs(1));
            tell.send(connected.map(drop))
        });
        let connected = told.recv_timeout(2 * CONNECT).expect("an answer while nobody accepts");
        let Err(StoreError::Away(why)) = connected else { panic!("nobody accepts there") };
        assert!(why.contains("nobody takes the connections"), "{why}");
        drop((listener, queue));
    }

    #[test]
    fn each_answer_is_told_and_silence_is_not() {
        let heard = Arc::new(AtomicUsize::new(0));
        let own = heard.clone();
        let mut asking = Asking::new(Duration::from_millis(10)).expect("a runtime");
        asking.beat = Beat::new(move || {
            own.fetch_add(1, Relaxed);
        });
        for answers in 1..=3 {
            asking.ask(async { Ok::<_, Error>(()) }).expect("an answer");
            assert_eq!(heard.load(Relaxed), answers);
        }
        assert!(asking.ask(std::future::pending::<Result<(), Error>>()).is_err());
        assert_eq!(heard.load(Relaxed), 3);
    }

    #[test]
    fn whoever_gives_up_does_not_wait_for_a_name_that_is_still_looked_up() {
        let asking = Asking::new(Duration::from_secs(1)).expect("a runtime");
        let ((end, ended), (begin, begun)) = (channel::<()>(), channel());
        // A lookup is such a task: it blocks a thread and nothing ends it.
        asking.runtime().expect("there").spawn_blocking(move || {
            begin.send(()).expect("waited for");
            ended.recv()
        });
        begun.recv().expect("it begins");
        let (tell, told) = channel();
        std::thread::spawn(move || {
            drop(asking);
            tell.send(())
        });
        let waited = told.recv_timeout(Duration::from_secs(10));
        drop(end);
        waited.expect("dropped while the lookup hangs");
    }
}
