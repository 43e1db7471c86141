//! The connection that writes: a term, what the device made of it, and only then a heartbeat.

use super::config::{IN_EXCHANGE, Target, TermType, WordOrder};
use crate::compensation::gate::{Order, Time, WriteFault};
use std::borrow::Cow;
use std::io;
use std::sync::Arc;
use tokio::net::TcpStream;
use tokio::time::{Instant, timeout_at};
use tokio_modbus::client::{Client, Context, tcp};
use tokio_modbus::{Error, Request, Response, Slave};

/// Both clocks.
pub type Clocks = Arc<dyn Fn() -> Time + Send + Sync>;

/// Writes one loop's orders over a connection of its own, which is opened when it is needed. After any failure it is
/// dropped: a late answer would be taken for the next one.
pub struct Writer {
    target: Target,
    clocks: Clocks,
    link: Option<Link>,
    /// When the exchange has to be over.
    until: Instant,
    /// The device closes its connections in the middle of an exchange: each request gets one of its own, until one outlives it.
    closes: bool,
    /// What went wrong last, for the log.
    why: String,
}

/// A connection, and the same socket once more: whether the peer has closed it is seen there before anything is sent.
struct Link {
    context: Context,
    socket: std::net::TcpStream,
}

/// Why a request has no answer.
enum Lost {
    /// The connection broke.
    Broken(String),
    /// It was refused, answered too late, or by something else.
    Refused(String),
}

impl Writer {
    /// A writer that is not connected yet.
    pub fn new(target: Target, clocks: Clocks) -> Self {
        Self { target, clocks, link: None, until: Instant::now(), closes: false, why: String::new() }
    }

    /// Writes the term, reads it back, and writes the heartbeat once the device holds what was written: a device that
    /// takes no term, or another, never sees a heart beat. Nothing is sent of an order that does not hold any more, and nothing
    /// is written twice.
    ///
    /// # Errors
    /// [`WriteFault::Failed`] when a request was refused, not answered in time, or the link broke: nobody knows then
    /// whether the term arrived. [`WriteFault::ReadBack`] when the device holds something else. [`WriteFault::Withheld`] when the
    /// order became too old.
    pub async fn write(&mut self, order: &Order) -> Result<(), WriteFault> {
        let words = encode(order.term() / self.target.scale, self.target.term_type, self.target.order);
        self.until = Instant::now() + IN_EXCHANGE * self.target.timeout;
        // Many devices close a connection that idled.
        self.link.take_if(|link| !link.is_open());
        // One that outlived its exchange was not closed after an answer: the next may be asked over again and again, too.
        if self.closes && self.link.take().is_some() {
            self.closes = false;
        }
        let written = self.exchange(&words, order).await;
        if written.is_err() {
            self.link = None;
        }
        written
    }

    /// Closes the connection.
    pub fn close(&mut self) {
        (self.link, self.closes) = (None, false);
    }

    /// What went wrong last.
    pub fn why(&self) -> &str {
        &self.why
    }

    async fn exchange(&mut self, words: &[u16], order: &Order) -> Result<(), WriteFault> {
        let Target { term, heartbeat: at, .. } = self.target;
        self.put(term, words, order).await?;
        let held = self.read(term, words.len() as u16).await?;
        if held != words {
            self.why = format!("the device holds {held:04x?}, written was {words:04x?}");
            return Err(WriteFault::ReadBack);
        }
        self.put(at, &[order.heartbeat()], order).await
    }

    async fn put(&mut self, start: u16, words: &[u16], order: &Order) -> Result<(), WriteFault> {
        self.open().await?;
        // After a process was frozen the answer that it waited for is there, and no time-out is told.
        if !order.holds((self.clocks)()) {
            return Err(WriteFault::Withheld);
        }
        let count = words.len() as u16;
        match self.ask(Request::WriteMultipleRegisters(start, Cow::Owned(words.to_vec()))).await {
            Ok(Response::WriteMultipleRegisters(at, written)) if (at, written) == (start, count) => Ok(()),
            Ok(other) => Err(self.failed(format!("a write was answered with {other:?}"))),
            Err(Lost::Broken(why) | Lost::Refused(why)) => Err(self.failed(why)),
        }
    }

    /// Reads registers; over another connection once more where the device closed this one behind its last answer.
    async fn read(&mut self, start: u16, count: u16) -> Result<Vec<u16>, WriteFault> {
        self.open().await?;
        let mut answer = self.ask(Request::ReadHoldingRegisters(start, count)).await;
        if let Err(Lost::Broken(_)) = answer {
            self.closes = true;
            self.open().await?;
            answer = self.ask(Request::ReadHoldingRegisters(start, count)).await;
        }
        match answer {
            Ok(Response::ReadHoldingRegisters(held)) => Ok(held),
            Ok(other) => Err(self.failed(format!("a read was answered with {other:?}"))),
            Err(Lost::Broken(why) | Lost::Refused(why)) => Err(self.failed(why)),
        }
    }

    /// Opens a connection where there is none that can be asked over.
    async fn open(&mut self) -> Result<(), WriteFault> {
        let closes = self.closes;
        if self.link.take_if(|link| closes || !link.is_open()).is_some() {
            self.closes = true;
        }
        if self.link.is_none() {
            match timeout_at(self.limit(), Link::open(&self.target)).await {
                Ok(Ok(link)) => self.link = Some(link),
                Ok(Err(error)) => return Err(self.failed(format!("cannot connect: {error}"))),
                Err(_) => return Err(self.failed("no connection in time".into())),
            }
        }
        Ok(())
    }

    async fn ask(&mut self, request: Request<'_>) -> Result<Response, Lost> {
        let limit = self.limit();
        let Some(link) = &mut self.link else {
            return Err(Lost::Broken("no connection".into()));
        };
        match timeout_at(limit, link.context.call(request)).await {
            Ok(Ok(Ok(response))) => Ok(response),
            Ok(Ok(Err(refused))) => Err(Lost::Refused(format!("refused: {refused}"))),
            Ok(Err(Error::Transport(error))) => Err(Lost::Broken(format!("the connection broke: {error}"))),
            Ok(Err(error)) => Err(Lost::Refused(error.to_string())),
            Err(_) => {
                let ms = self.target.timeout.as_millis();
                Err(Lost::Refused(format!(
                    "no answer within timeout_ms = {ms}, or {IN_EXCHANGE} times that in all"
                )))
            }
        }
    }

    /// When the next answer has to be there.
    fn limit(&self) -> Instant {
        self.until.min(Instant::now() + self.target.timeout)
    }

    fn failed(&mut self, why: String) -> WriteFault {
        self.why = why;
        WriteFault::Failed
    }
}

impl Link {
    async fn open(target: &Target) -> io::Result<Self> {
        let stream = TcpStream::connect(&target.address).await?;
        // A request is one small segment; waiting for more to send would only delay it.
        stream.set_nodelay(true)?;
        let stream = stream.into_std()?;
        let socket = stream.try_clone()?;
        let context = tcp::attach_slave(TcpStream::from_std(stream)?, Slave(target.unit_id));
        Ok(Self { context, socket })
    }

    /// Whether the peer has neither closed it nor said what nobody asked.
    fn is_open(&self) -> bool {
        self.socket.peek(&mut [0]).is_err_and(|error| error.kind() == io::ErrorKind::WouldBlock)
    }
}

/// A value as registers. Integers are cut towards 0, so that a rounding never goes beyond the clamp.
fn encode(raw: f64, term_type: TermType, order: WordOrder) -> Vec<u16> {
    let bytes: Vec<u8> = match term_type {
        TermType::I16 => (raw as i16).to_be_bytes().to_vec(),
        TermType::I32 => (raw as i32).to_be_bytes().to_vec(),
        TermType::F32 => (raw as f32).to_be_bytes().to_vec(),
        TermType::F64 => raw.to_be_bytes().to_vec(),
    };
    let mut words: Vec<u16> =
        bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
    if matches!(order, WordOrder::Cdab | WordOrder::Dcba) {
        words.reverse();
    }
    if matches!(order, WordOrder::Badc | WordOrder::Dcba) {
        words.iter_mut().for_each(|word| *word = word.swap_bytes());
    }
    words
}

#[cfg(test)]
pub(super) mod tests;
