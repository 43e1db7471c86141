//! One connection to one device, and the only place that talks to a socket. It can only read.

use super::config::{Framing, Tolerated};
use super::head;
use super::kinds::Register;
use super::plan::Span;
use super::wire::{Asked, Dial};
use std::fmt;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::timeout;
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::slave::SlaveContext;
use tokio_modbus::{Error, ExceptionCode, FunctionCode, ProtocolError, Request, Response, Slave};

/// An open connection on which no question is unanswered.
///
/// [`Link::read`] takes the link and gives it back only after a whole, matching answer: after a time-out or
/// a broken answer there is nothing left to read a late answer from.
pub(super) struct Link {
    context: Context,
}

/// Why there is no link any more.
#[derive(Debug)]
pub(super) enum Lost {
    /// No answer in time.
    Timeout,
    /// The device closed the connection, and no part of an answer came.
    Closed,
    /// The connection broke, or carried something that does not answer the question.
    Broken(String),
}

impl fmt::Display for Lost {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Lost::Timeout => out.write_str("no answer in time"),
            Lost::Closed => out.write_str("link: closed by the device"),
            Lost::Broken(why) => write!(out, "link: {why}"),
        }
    }
}

/// The device answered, but not with the values asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// A Modbus exception.
    Exception(ExceptionCode),
    /// More or fewer values than asked for: nobody knows which they are.
    WrongCount {
        /// Values asked for.
        asked: u16,
        /// Values that came.
        came: usize,
    },
}

impl Refusal {
    /// True when a smaller request may succeed: the address or the length was refused.
    pub(super) fn may_be_a_hole(self) -> bool {
        use ExceptionCode::{IllegalDataAddress, IllegalDataValue};
        matches!(self, Refusal::WrongCount { .. } | Refusal::Exception(IllegalDataAddress | IllegalDataValue))
    }

    /// True when the device has taken the request and cannot answer it now.
    pub(super) fn is_busy(self) -> bool {
        use ExceptionCode::{Acknowledge, ServerDeviceBusy};
        matches!(self, Refusal::Exception(Acknowledge | ServerDeviceBusy))
    }

    /// True when a gateway speaks for a unit it cannot reach: asking on would only cost its time-outs.
    pub(super) fn is_gateway(self) -> bool {
        use ExceptionCode::{GatewayPathUnavailable, GatewayTargetDevice};
        matches!(self, Refusal::Exception(GatewayPathUnavailable | GatewayTargetDevice))
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refusal::Exception(code) => write!(out, "{code} (exception {})", u8::from(*code)),
            Refusal::WrongCount { asked, came } => write!(out, "answered {came} values, not {asked}"),
        }
    }
}

/// What a device said: one word per address (0 or 1 for coils and discrete inputs), or a refusal.
pub(super) type Answer = Result<Vec<u16>, Refusal>;

impl Link {
    /// Connects to `host:port`, within the time-out.
    pub(super) async fn open(
        dial: &Dial,
        address: &str,
        framing: Framing,
        limit: Duration,
    ) -> Result<Link, Lost> {
        match timeout(limit, dial(address)).await {
            Err(_) => {
                Err(Lost::Broken(format!("no connection to {address} within {} ms", limit.as_millis())))
            }
            Ok(Err(error)) => Err(Lost::Broken(format!("cannot connect to {address}: {error}"))),
            Ok(Ok(stream)) => Ok(Link::over(Asked::new(stream), framing)),
        }
    }

    /// A link over a stream that is there.
    pub(super) fn over<S>(stream: S, framing: Framing) -> Link
    where
        S: AsyncRead + AsyncWrite + fmt::Debug + Unpin + Send + 'static,
    {
        let context = match framing {
            Framing::Tcp => tcp::attach(stream),
            Framing::Rtu => rtu::attach(stream),
        };
        Link { context }
    }

    /// Asks `unit` for `span`. Gives the link back with the answer, or tells why it is lost.
    pub(super) async fn read(
        mut self,
        unit: u8,
        span: Span,
        tolerate: &[Tolerated],
        limit: Duration,
    ) -> Result<(Link, Answer), Lost> {
        self.context.set_slave(Slave(unit));
        // The request is sent as such, because the client's read methods assert the length of the answer.
        let request = match span.register {
            Register::Holding => Request::ReadHoldingRegisters(span.start, span.count),
            Register::Input => Request::ReadInputRegisters(span.start, span.count),
            Register::Coil => Request::ReadCoils(span.start, span.count),
            Register::Discrete => Request::ReadDiscreteInputs(span.start, span.count),
        };
        let function = request.function_code();
        let answer = match timeout(limit, self.context.call(request)).await {
            Err(_) => return Err(Lost::Timeout),
            Ok(Err(error)) => despite(error, function, tolerate)?,
            Ok(Ok(answer)) => answer,
        };
        let answer = match answer {
            Err(code) => Err(Refusal::Exception(code)),
            Ok(Response::ReadHoldingRegisters(words) | Response::ReadInputRegisters(words)) => {
                counted(words.len(), usize::from(span.count), span.count).map(|()| words)
            }
            Ok(Response::ReadCoils(bits) | Response::ReadDiscreteInputs(bits)) => {
                // Bits come in whole bytes; which of the last byte are filling, the answer does not say.
                let whole = usize::from(span.count).div_ceil(8) * 8;
                counted(bits.len(), whole, span.count)
                    .map(|()| bits[..usize::from(span.count)].iter().map(|bit| u16::from(*bit)).collect())
            }
            Ok(_) => return Err(Lost::Broken("the answer is of another function".into())),
        };
        Ok((self, answer))
    }
}

fn counted(came: usize, due: usize, asked: u16) -> Result<(), Refusal> {
    if came == due { Ok(()) } else { Err(Refusal::WrongCount { asked, came }) }
}

/// The answer of a gateway that does not give the request's head back, where the configuration takes it; else why the link
/// is lost.
fn despite(
    error: Error,
    asked: FunctionCode,
    tolerate: &[Tolerated],
) -> Result<Result<Response, ExceptionCode>, Lost> {
    match error {
        Error::Transport(io) if is_closed(&io) => Err(Lost::Closed),
        Error::Protocol(ProtocolError::HeaderMismatch { message, result }) => {
            head::judge(&message, tolerate).map_err(Lost::Broken)?;
            let (answered, answer) = match result {
                Ok(response) => (response.function_code(), Ok(response)),
                Err(refused) => (refused.function, Err(refused.exception)),
            };
            if answered == asked {
                Ok(answer)
            } else {
                Err(Lost::Broken("the answer is of another function".into()))
            }
        }
        other => Err(Lost::Broken(other.to_string())),
    }
}

/// Whether the peer ended the connection. The client reports that as the operating system's last error, whatever it was, and
/// an answer that was cut short as an error without a number.
fn is_closed(error: &io::Error) -> bool {
    use io::ErrorKind::{BrokenPipe, ConnectionAborted, ConnectionReset, NotConnected};
    let ended = matches!(error.kind(), BrokenPipe | ConnectionAborted | ConnectionReset | NotConnected);
    ended || error.raw_os_error().is_some()
}
