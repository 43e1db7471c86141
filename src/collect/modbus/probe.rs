//! `probe`: shows registers in every type and byte order, for the day the addresses are checked against
//! the plant's screens. Reads only.

use super::config::{Framing, MAX_BITS, MAX_REGISTERS, Tolerated};
use super::decode::bytes;
use super::kinds::{ByteOrder, Register};
use super::link::{Link, Lost};
use super::plan::Span;
use super::wire::sockets;
use crate::host::host_and_port;
use std::fmt;
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncRead, AsyncWrite};

/// What to read, once.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeTarget {
    /// `host:port`.
    pub address: String,
    /// Unit identifier.
    pub unit_id: u8,
    /// 0 or 1, as in the device's configuration.
    pub address_base: u8,
    /// Which table.
    pub register: Register,
    /// First address, counted from `address_base`.
    pub start: u16,
    /// Number of addresses: at most 125 registers, or 2000 coils or discrete inputs.
    pub count: u16,
    /// Longest wait for the connection and for the answer.
    pub timeout: Duration,
}

/// Why nothing can be shown.
#[derive(Debug, Error)]
pub enum ProbeError {
    /// The question itself is impossible.
    #[error("arguments: {0}")]
    Arguments(String),
    /// No connection, no answer, or a broken one.
    #[error("{address}: {why}")]
    Link {
        /// Who was asked.
        address: String,
        /// What happened.
        why: String,
    },
    /// The device answered with an exception or the wrong number of values.
    #[error("device {address} refuses {count} from {register} {start}: {why}")]
    Device {
        /// Who was asked.
        address: String,
        /// Which table.
        register: Register,
        /// First address, as given.
        start: u16,
        /// Number of addresses.
        count: u16,
        /// What it said.
        why: String,
    },
}

/// The words read; `Display` lays them out, one line for each address and byte order.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Which table of the device.
    pub register: Register,
    /// First address, counted as in the target.
    pub start: u16,
    /// One word an address; 0 or 1 for coils and discrete inputs.
    pub words: Vec<u16>,
}

/// Reads the target's registers once.
///
/// # Errors
/// [`ProbeError`]: impossible arguments, no link, or a device that refuses.
pub async fn probe(target: &ProbeTarget) -> Result<Table, ProbeError> {
    let span = span(target)?;
    let link = Link::open(&sockets(), &target.address, Framing::Tcp, target.timeout).await;
    ask(link.map_err(|why| lost(target, &why))?, target, span, &[]).await
}

/// Reads the target's registers once, over a connection that is there.
///
/// # Errors
/// As [`probe`].
pub async fn probe_over<S>(
    stream: S,
    framing: Framing,
    tolerate: &[Tolerated],
    target: &ProbeTarget,
) -> Result<Table, ProbeError>
where
    S: AsyncRead + AsyncWrite + fmt::Debug + Unpin + Send + 'static,
{
    ask(Link::over(stream, framing), target, span(target)?, tolerate).await
}

fn lost(target: &ProbeTarget, why: &Lost) -> ProbeError {
    ProbeError::Link { address: target.address.clone(), why: why.to_string() }
}

async fn ask(
    link: Link,
    target: &ProbeTarget,
    span: Span,
    tolerate: &[Tolerated],
) -> Result<Table, ProbeError> {
    let asked = link.read(target.unit_id, span, tolerate, target.timeout).await;
    let (_, answer) = asked.map_err(|why| lost(target, &why))?;
    let words = answer.map_err(|refusal| ProbeError::Device {
        address: target.address.clone(),
        register: target.register,
        start: target.start,
        count: target.count,
        why: refusal.to_string(),
    })?;
    Ok(Table { register: target.register, start: target.start, words })
}

fn span(target: &ProbeTarget) -> Result<Span, ProbeError> {
    let most = if target.register.is_bits() { MAX_BITS } else { MAX_REGISTERS };
    if let Err(why) = host_and_port(&target.address) {
        let message = format!("'{}' is not host:port, such as 10.0.0.5:502: {why}", target.address);
        return Err(ProbeError::Arguments(message));
    }
    if target.address_base > 1 {
        return Err(ProbeError::Arguments("the address base must be 0 or 1".into()));
    }
    if !(1..=most).contains(&target.count) {
        let message = format!("the count must be 1 to {most} for {} registers", target.register);
        return Err(ProbeError::Arguments(message));
    }
    let start = target.start.checked_sub(u16::from(target.address_base));
    match start.filter(|start| start.checked_add(target.count - 1).is_some()) {
        Some(start) => Ok(Span { register: target.register, start, count: target.count }),
        None => Err(ProbeError::Arguments(format!(
            "{} addresses from {} do not lie within the device's 65536",
            target.count, target.start
        ))),
    }
}

impl fmt::Display for Table {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.register.is_bits() {
            writeln!(out, "{:>7}  {}", "address", self.register)?;
            for (at, word) in self.words.iter().enumerate() {
                writeln!(out, "{:>7}  {word}", usize::from(self.start) + at)?;
            }
            return Ok(());
        }
        writeln!(
            out,
            "{:>7}  {:<6} {:<5} {:>6} {:>6} {:>10} {:>11} {:>14} {:>22}",
            "address", "hex", "order", "u16", "i16", "u32", "i32", "f32", "f64"
        )?;
        for at in 0..self.words.len() {
            for order in ByteOrder::ALL {
                write_row(out, usize::from(self.start) + at, &self.words[at..], order)?;
            }
        }
        Ok(())
    }
}

/// One address in one byte order; `-` where too few registers were read for the type.
fn write_row(out: &mut fmt::Formatter<'_>, address: usize, words: &[u16], order: ByteOrder) -> fmt::Result {
    let text = |value: Option<String>| value.unwrap_or_else(|| "-".into());
    let one = bytes::<2>(words, order);
    let two = bytes::<4>(words, order);
    let four = bytes::<8>(words, order);
    let (label, hex) = match order {
        ByteOrder::Abcd => (address.to_string(), words.first().map(|word| format!("0x{word:04X}"))),
        _ => (String::new(), Some(String::new())),
    };
    writeln!(
        out,
        "{label:>7}  {:<6} {:<5} {:>6} {:>6} {:>10} {:>11} {:>14} {:>22}",
        text(hex),
        order.as_str(),
        text(one.map(|b| u16::from_be_bytes(b).to_string())),
        text(one.map(|b| i16::from_be_bytes(b).to_string())),
        text(two.map(|b| u32::from_be_bytes(b).to_string())),
        text(two.map(|b| i32::from_be_bytes(b).to_string())),
        text(two.map(|b| shortest(f64::from(f32::from_be_bytes(b)), f32::from_be_bytes(b).to_string()))),
        text(four.map(|b| shortest(f64::from_be_bytes(b), f64::from_be_bytes(b).to_string()))),
    )
}

/// Very large and very small values, which wrong byte orders give, in powers of ten to keep the columns.
fn shortest(value: f64, plain: String) -> String {
    if value == 0.0 || !value.is_finite() || (1e-4..1e9).contains(&value.abs()) {
        plain
    } else {
        format!("{value:.6e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(register: Register, start: u16, count: u16, address_base: u8) -> ProbeTarget {
        ProbeTarget {
            address: "127.0.0.1:1".into(),
            unit_id: 1,
            address_base,
            register,
            start,
            count,
            timeout: Duration::from_millis(100),
        }
    }

    #[test]
    fn impossible_questions_are_refused_before_anyone_is_asked() {
        let ok = |t: ProbeTarget| span(&t).is_ok();
        assert!(ok(target(Register::Holding, 0, 125, 0)));
        assert!(ok(target(Register::Coil, 0, 2000, 0)));
        assert!(ok(target(Register::Holding, 65535, 1, 0)));
        assert!(ok(target(Register::Holding, 65535, 2, 1)));
        assert!(!ok(target(Register::Holding, 65535, 2, 0)));
        assert!(!ok(target(Register::Holding, 0, 126, 0)));
        assert!(!ok(target(Register::Holding, 0, 0, 0)));
        assert!(!ok(target(Register::Holding, 0, 1, 1)));
        assert!(!ok(target(Register::Holding, 1, 1, 2)));
        assert!(!ok(target(Register::Discrete, 0, 2001, 0)));
        assert!(!ok(ProbeTarget { address: "localhost".into(), ..target(Register::Holding, 0, 1, 0) }));
    }

    #[test]
    fn the_table_shows_every_type_in_every_order() {
        let table = Table { register: Register::Holding, start: 100, words: vec![0x42F6, 0xE979] };
        let text = table.to_string();
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(lines.len(), 1 + 2 * 4);
        assert_eq!(
            lines[1],
            ["100", "0x42F6", "ABCD", "17142", "17142", "1123477881", "1123477881", "123.456", "-"]
        );
        assert_eq!(lines[2][0], "CDAB");
        assert_eq!(lines[2][3], "3917038326");
        assert_eq!(lines[5], ["101", "0xE979", "ABCD", "59769", "-5767", "-", "-", "-", "-"]);
        let width = text.lines().map(str::len).max();
        assert!(text.lines().all(|line| Some(line.len()) == width), "columns are straight:\n{text}");
    }

    #[test]
    fn coils_are_shown_as_bits() {
        let table = Table { register: Register::Coil, start: 7, words: vec![1, 0] };
        let lines: Vec<String> = table.to_string().lines().map(|l| l.trim().to_string()).collect();
        assert_eq!(lines, ["address  coil", "7  1", "8  0"]);
    }
}
