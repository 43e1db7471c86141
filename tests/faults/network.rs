//! A network in memory, and devices on it that answer late, twice, wrongly or not at all, as their seed says.
//!
//! Every value that a device says is said once: its tag, whether the valve sticks, and a number. So of every sample it is
//! known who said it, when, and whether it was meant to be believed.

use crate::plant::POLL_S;
use crate::time::TimeLine;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::collections::{BTreeMap, HashMap};
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use stictiond::collect::modbus::{Dial, Wire};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
use tokio::time::sleep;

/// Longest wait for an answer (s), as configured.
pub const TIMEOUT_S: f64 = 0.4;
/// Pairs of registers that a device has.
pub const PAIRS: usize = 8;
/// An answer that comes late holds up those behind it for no longer (s).
const LATE_S: f64 = 2.0;
/// Values count up to this.
const NUMBERS: u32 = 1 << 24;

/// What a value says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Value {
    /// Register pair of the device.
    pub tag: u32,
    pub sticks: bool,
    pub number: u32,
}

impl Value {
    pub fn of(value: f64) -> Option<Self> {
        let whole = value.fract() == 0.0 && (0.0..f64::from(u32::MAX)).contains(&value);
        let bits = whole.then_some(value as u32)?;
        Some(Self { tag: bits >> 25, sticks: bits >> 24 & 1 == 1, number: bits % NUMBERS })
    }

    fn bits(self) -> u32 {
        (self.tag << 25) | (u32::from(self.sticks) << 24) | (self.number % NUMBERS)
    }
}

/// When a value was asked for (s), and whether its answer may be believed.
#[derive(Clone, Copy, Debug)]
pub struct Said {
    pub asked: f64,
    pub sound: bool,
}

/// What a device does with a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Does {
    Answers,
    InPieces,
    Late,
    Twice,
    OfAnother,
    OfAnotherUnit,
    TooShort,
    TooLong,
    OfAnotherFunction,
    Refuses,
    Noise,
    CutsBefore,
    CutsWithin,
    SaysNothing,
}

const FAULTS: [Does; 13] = [
    Does::InPieces,
    Does::Late,
    Does::Twice,
    Does::OfAnother,
    Does::OfAnotherUnit,
    Does::TooShort,
    Does::TooLong,
    Does::OfAnotherFunction,
    Does::Refuses,
    Does::Noise,
    Does::CutsBefore,
    Does::CutsWithin,
    Does::SaysNothing,
];

struct Net {
    random: Pcg64,
    said: HashMap<u32, Said>,
    number: u32,
    /// How likely a fault is, of each device.
    faults: [f64; 2],
    /// Links that are cut, of each device.
    cut: [bool; 2],
    sticks: [bool; 2 * PAIRS],
    /// When a device answered soundly, and nothing was in the way (s).
    answered: [Vec<f64>; 2],
    /// When something was in the way, or it did anything else (s).
    troubled: [Vec<f64>; 2],
    /// A device that lies so that nobody can tell: the harness must.
    undetectable: bool,
    counts: BTreeMap<&'static str, u64>,
}

/// The network.
#[derive(Clone)]
pub struct Network {
    net: Arc<Mutex<Net>>,
    time: Arc<Mutex<TimeLine>>,
}

impl Network {
    pub fn new(seed: u64, time: Arc<Mutex<TimeLine>>, undetectable: bool) -> Self {
        let mut random = Pcg64::seed_from_u64(seed);
        let net = Net {
            sticks: random.random(),
            random,
            said: HashMap::new(),
            number: 0,
            faults: [0.0; 2],
            cut: [false; 2],
            answered: [Vec::new(), Vec::new()],
            troubled: [Vec::new(), Vec::new()],
            undetectable,
            counts: BTreeMap::new(),
        };
        Self { net: Arc::new(Mutex::new(net)), time }
    }

    fn lock(&self) -> MutexGuard<'_, Net> {
        self.net.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> f64 {
        self.time.lock().unwrap_or_else(PoisonError::into_inner).now()
    }

    pub fn said(&self, value: Value) -> Option<Said> {
        self.lock().said.get(&value.bits()).copied()
    }

    /// When a device last answered soundly up to a moment (s).
    pub fn answered(&self, device: usize, until: f64) -> f64 {
        let net = self.lock();
        net.answered[device].iter().rev().find(|at| **at <= until).copied().unwrap_or(0.0)
    }

    /// Whether a device answered every poll between two moments (s), at once and soundly: then its tags were good.
    pub fn was_sound(&self, device: usize, from: f64, to: f64) -> bool {
        let net = self.lock();
        let mut last = from;
        let is_steady = |at: &f64| at - std::mem::replace(&mut last, *at) < 1.2 * POLL_S;
        let answers = net.answered[device].iter().filter(|at| (from..=to).contains(*at));
        let troubled = net.troubled[device].iter().any(|at| (from - LATE_S..=to).contains(at));
        !troubled && answers.chain([&to]).all(is_steady)
    }

    fn trouble(&self, device: usize) {
        let now = self.now();
        self.lock().troubled[device].push(now);
    }

    pub fn set_faults(&self, device: usize, likely: f64) {
        self.lock().faults[device] = likely;
    }

    pub fn set_cut(&self, device: usize, cut: bool) {
        self.lock().cut[device] = cut;
    }

    pub fn set_sticks(&self, pair: usize, sticks: bool) {
        self.lock().sticks[pair] = sticks;
    }

    pub fn counts(&self) -> BTreeMap<&'static str, u64> {
        self.lock().counts.clone()
    }

    /// Connects to `d0:502`, which speaks Modbus/TCP, or `d1:502`, which speaks RTU.
    pub fn dial(&self) -> Dial {
        let network = self.clone();
        Arc::new(move |address| {
            let (network, device) = (network.clone(), usize::from(address.starts_with("d1")));
            Box::pin(async move {
                let (cut, takes) = {
                    let mut net = network.lock();
                    (net.cut[device], net.random.random_range(0..5))
                };
                sleep(Duration::from_millis(takes)).await;
                if cut {
                    network.trouble(device);
                    return Err(io::ErrorKind::ConnectionRefused.into());
                }
                let (ours, theirs) = duplex(4096);
                tokio::spawn(async move { network.serve(device, theirs).await });
                Ok(Box::new(ours) as Box<dyn Wire>)
            })
        })
    }

    /// Answers on one connection until it ends; an error is its end too.
    async fn serve(self, device: usize, mut stream: DuplexStream) -> Option<()> {
        let is_rtu = device == 1;
        loop {
            let mut request = [0; 12];
            let length = if is_rtu { 8 } else { 12 };
            stream.read_exact(&mut request[..length]).await.ok()?;
            let pdu = if is_rtu { &request[1..6] } else { &request[7..12] };
            let (function, start, count) = (pdu[0], word(pdu, 1), word(pdu, 3));
            let asked = self.now();
            let does = self.draws(device);
            if does != Some(Does::Answers) {
                self.trouble(device);
            }
            let does = does?;
            let head: &[u8] = if is_rtu { &request[..1] } else { &request[..7] };
            let answer = self.answer(device, head, (function, start, count), does, asked);
            self.send(device, &mut stream, does, &answer).await?;
        }
    }

    /// What is done with the next request; `None` cuts the link.
    fn draws(&self, device: usize) -> Option<Does> {
        let mut net = self.lock();
        if net.cut[device] {
            return None;
        }
        let likely = net.faults[device];
        let does = if net.random.random_bool(likely) {
            FAULTS[net.random.random_range(0..FAULTS.len())]
        } else {
            Does::Answers
        };
        *net.counts.entry(name(does)).or_default() += 1;
        Some(does)
    }

    /// The values of so many registers, two each, and what their number says.
    fn values(&self, device: usize, start: u16, count: u16, said: Said) -> Vec<u8> {
        let mut net = self.lock();
        let mut bytes = Vec::new();
        for register in (start..start + count).step_by(2) {
            let pair = usize::from(register / 2) % PAIRS + PAIRS * device;
            net.number += 1;
            let value = Value { tag: pair as u32, sticks: net.sticks[pair], number: net.number };
            net.said.insert(value.bits(), said);
            bytes.extend(value.bits().to_be_bytes());
        }
        bytes
    }

    /// The bytes of an answer, made wrong as the fault wants it.
    fn answer(
        &self,
        device: usize,
        head: &[u8],
        (function, start, count): (u8, u16, u16),
        does: Does,
        asked: f64,
    ) -> Vec<u8> {
        use Does::{
            Answers, InPieces, Late, Noise, OfAnother, OfAnotherFunction, OfAnotherUnit, Refuses, TooLong,
            TooShort, Twice,
        };
        let mut sound = matches!(does, Answers | InPieces | Twice | Late);
        // RTU frames have no number: the answer to another request is then no fault.
        sound |= does == OfAnother && head.len() == 1;
        let mut values = self.values(device, start, count, Said { asked, sound });
        match does {
            TooShort => values.truncate(values.len() - 4),
            TooLong => values.extend([0; 4]),
            _ => {}
        }
        let mut pdu = vec![function, values.len() as u8];
        pdu.extend(&values);
        let mut net = self.lock();
        match does {
            Refuses => pdu = vec![function | 0x80, [1, 2, 3, 4, 5, 6, 10, 11][net.random.random_range(0..8)]],
            OfAnotherFunction => pdu[0] = if function == 3 { 4 } else { 3 },
            Noise => return (0..net.random.random_range(1..200)).map(|_| net.random.random()).collect(),
            _ => {}
        }
        let unit = head[head.len() - 1] ^ if does == OfAnotherUnit { 0x20 } else { 0 };
        if head.len() == 1 {
            let mut frame = vec![unit];
            frame.extend(pdu);
            frame.extend(crc(&frame).to_le_bytes());
            return frame;
        }
        let number = word(head, 0).wrapping_add(if does == OfAnother { 0xfff0 } else { 0 });
        let mut frame = number.to_be_bytes().to_vec();
        frame.extend([0, 0]);
        frame.extend((pdu.len() as u16 + 1).to_be_bytes());
        frame.push(unit);
        frame.extend(pdu);
        frame
    }

    async fn send(&self, device: usize, stream: &mut DuplexStream, does: Does, answer: &[u8]) -> Option<()> {
        let (soon, late, again, at) = {
            let random = &mut self.lock().random;
            (
                random.random_range(1..25),
                random.random_range(350..1600),
                random.random_range(0..400),
                random.random_range(1..answer.len().max(2)),
            )
        };
        let pause = |ms| sleep(Duration::from_millis(ms));
        pause(soon).await;
        match does {
            Does::SaysNothing => return Some(()),
            Does::CutsBefore => return None,
            Does::CutsWithin => {
                let _ = stream.write_all(&answer[..at.min(answer.len())]).await;
                return None;
            }
            Does::Late => pause(late).await,
            Does::InPieces => {
                stream.write_all(&answer[..at.min(answer.len())]).await.ok()?;
                pause(again / 4).await;
                return stream.write_all(&answer[at.min(answer.len())..]).await.ok();
            }
            _ => {}
        }
        // The link was cut meanwhile.
        if self.lock().cut[device] {
            self.trouble(device);
            return None;
        }
        stream.write_all(answer).await.ok()?;
        if does == Does::Answers {
            let now = self.now();
            self.lock().answered[device].push(now);
        }
        if does == Does::Twice && self.lock().undetectable {
            self.lies_well(stream, answer).await?;
        } else if does == Does::Twice {
            pause(again).await;
            stream.write_all(answer).await.ok()?;
        }
        Some(())
    }

    /// Answers the next request with what it said before, under the right number: what a client that takes an answer that came
    /// twice for the next one would see.
    async fn lies_well(&self, stream: &mut DuplexStream, answer: &[u8]) -> Option<()> {
        let is_rtu = answer.len() < 7 || word(answer, 2) != 0;
        let mut request = [0; 12];
        let length = if is_rtu { 8 } else { 12 };
        stream.read_exact(&mut request[..length]).await.ok()?;
        let mut answer = answer.to_vec();
        if !is_rtu {
            answer[..2].copy_from_slice(&request[..2]);
        }
        stream.write_all(&answer).await.ok()
    }
}

fn name(does: Does) -> &'static str {
    match does {
        Does::Answers => "answers",
        Does::InPieces => "answers in two pieces",
        Does::Late => "late answers",
        Does::Twice => "answers that come twice",
        Does::OfAnother => "wrong transaction numbers",
        Does::OfAnotherUnit => "wrong units",
        Does::TooShort => "answers too short",
        Does::TooLong => "answers too long",
        Does::OfAnotherFunction => "wrong functions",
        Does::Refuses => "exceptions",
        Does::Noise => "noise",
        Does::CutsBefore => "links cut before an answer",
        Does::CutsWithin => "links cut within an answer",
        Does::SaysNothing => "requests without an answer",
    }
}

fn word(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}

/// The check sum of an RTU frame.
fn crc(frame: &[u8]) -> u16 {
    frame.iter().fold(0xffff, |sum, byte| {
        (0..8).fold(sum ^ u16::from(*byte), |sum, _| if sum & 1 == 1 { sum >> 1 ^ 0xa001 } else { sum >> 1 })
    })
}
