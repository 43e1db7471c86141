//! The connection that writes: a term, what the device made of it, and only then a heartbeat.

use super::config::{Target, TermType, WordOrder};
use crate::compensation::gate::{Order, WriteFault};
use std::borrow::Cow;
use std::io;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_modbus::client::{Client, Context, tcp};
use tokio_modbus::{Request, Response, Slave};

/// Writes one loop's orders over a connection of its own, which is opened when it is needed. After any failure it is
/// dropped: a late answer would be taken for the next one.
pub struct Writer {
    target: Target,
    context: Option<Context>,
    /// What went wrong last, for the log.
    why: String,
}

impl Writer {
    /// A writer that is not connected yet.
    pub fn new(target: Target) -> Self {
        Self { target, context: None, why: String::new() }
    }

    /// Writes the term, reads it back, and writes the heartbeat once the device holds what was written: a device that
    /// takes no term, or another, never sees a heart beat.
    ///
    /// # Errors
    /// [`WriteFault::Failed`] when a request was refused, not answered in time, or the link broke: nobody knows then
    /// whether the term arrived. [`WriteFault::ReadBack`] when the device holds something else.
    pub async fn write(&mut self, order: &Order) -> Result<(), WriteFault> {
        let words = encode(order.term() / self.target.scale, self.target.term_type, self.target.order);
        let written = self.exchange(&words, order.heartbeat()).await;
        if written.is_err() {
            self.context = None;
        }
        written
    }

    /// Closes the connection.
    pub fn close(&mut self) {
        self.context = None;
    }

    /// What went wrong last.
    pub fn why(&self) -> &str {
        &self.why
    }

    async fn exchange(&mut self, words: &[u16], heartbeat: u16) -> Result<(), WriteFault> {
        let Target { term, heartbeat: at, .. } = self.target;
        self.put(term, words).await?;
        let count = words.len() as u16;
        let held = match self.ask(Request::ReadHoldingRegisters(term, count)).await? {
            Response::ReadHoldingRegisters(held) => held,
            other => return Err(self.failed(format!("a read was answered with {other:?}"))),
        };
        if held != words {
            self.why = format!("the device holds {held:04x?}, written was {words:04x?}");
            return Err(WriteFault::ReadBack);
        }
        self.put(at, &[heartbeat]).await
    }

    async fn put(&mut self, start: u16, words: &[u16]) -> Result<(), WriteFault> {
        let count = words.len() as u16;
        match self.ask(Request::WriteMultipleRegisters(start, Cow::Owned(words.to_vec()))).await? {
            Response::WriteMultipleRegisters(at, written) if (at, written) == (start, count) => Ok(()),
            other => Err(self.failed(format!("a write was answered with {other:?}"))),
        }
    }

    async fn ask(&mut self, request: Request<'_>) -> Result<Response, WriteFault> {
        let limit = self.target.timeout;
        if self.context.is_none() {
            let connected = timeout(limit, connect(&self.target.address)).await;
            let stream = match connected {
                Ok(Ok(stream)) => stream,
                Ok(Err(error)) => return Err(self.failed(format!("cannot connect: {error}"))),
                Err(_) => return Err(self.failed("no connection in time".into())),
            };
            self.context = Some(tcp::attach_slave(stream, Slave(self.target.unit_id)));
        }
        let Some(context) = &mut self.context else {
            return Err(self.failed("no connection".into()));
        };
        match timeout(limit, context.call(request)).await {
            Ok(Ok(Ok(response))) => Ok(response),
            Ok(Ok(Err(refused))) => Err(self.failed(format!("refused: {refused}"))),
            Ok(Err(error)) => Err(self.failed(error.to_string())),
            Err(_) => Err(self.failed(format!("no answer within {} ms", Duration::as_millis(&limit)))),
        }
    }

    fn failed(&mut self, why: String) -> WriteFault {
        self.why = why;
        WriteFault::Failed
    }
}

async fn connect(address: &str) -> io::Result<TcpStream> {
    let stream = TcpStream::connect(address).await?;
    // A request is one small segment; waiting for more to send would only delay it.
    stream.set_nodelay(true)?;
    Ok(stream)
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
mod tests {
    use super::*;

    /// 1.5 is 3FC0_0000 as f32 and 3FF8_0000_0000_0000 as f64; -15000 is FFFF_C568.
    #[test]
    fn words_by_hand() {
        assert_eq!(encode(1.5, TermType::F32, WordOrder::Abcd), [0x3FC0, 0]);
        assert_eq!(encode(1.5, TermType::F32, WordOrder::Cdab), [0, 0x3FC0]);
        assert_eq!(encode(-15000.0, TermType::I32, WordOrder::Badc), [0xFFFF, 0x68C5]);
        assert_eq!(encode(1.5, TermType::F64, WordOrder::Dcba), [0, 0, 0, 0xF83F]);
        assert_eq!(encode(-2.9, TermType::I16, WordOrder::Abcd), [(-2i16) as u16]);
        assert_eq!(encode(0.0, TermType::F32, WordOrder::Abcd), [0, 0]);
    }
}
