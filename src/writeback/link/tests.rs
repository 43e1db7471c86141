use super::*;
use crate::compensation::gate::{Evidence, Gate, Inputs, Limits};
use crate::compensation::measure::Criteria;
use crate::signal::Sample;
use std::sync::Mutex;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;

const PATIENCE: Duration = Duration::from_secs(10);

pub const LIMITS: Limits = Limits {
    clamp: 3.0,
    rate: 2.0,
    withdraw_rate: 1.0,
    withdraw_limit_s: 3600.0,
    dead_band: 0.0,
    rest_s: 5.0,
    max_step_s: 2.0,
    silence_s: 2.6,
    clock_tolerance_s: 1.0,
    max_sample_age_s: 3.0,
    max_missed_polls: 1,
    op_span: 100.0,
    op_limits: [0.0, 100.0],
    op_margin: 5.0,
    sp_rate: 0.1,
    sp_settle_s: 3.0,
    evidence_max_age_s: 1000.0,
    f_margin: 0.1,
    grant_max_s: 100.0,
    criteria: Criteria {
        length_s: 5.0,
        prove_s: 50.0,
        ise_gain: 1.1,
        ise_limit: 100.0,
        travel_limit: 10.0,
        reversal_band: 0.1,
    },
};

pub fn target() -> Target {
    Target {
        address: "127.0.0.1:0".into(),
        unit_id: 1,
        term: 0,
        heartbeat: 2,
        term_type: TermType::F32,
        order: WordOrder::Abcd,
        scale: 1.0,
        timeout: Duration::from_millis(100),
    }
}

/// A loop with such friction at a time. OP rises, so that its valve moves.
pub fn seen(now: Time, f: f64) -> Inputs {
    let sample = |value| Some(Sample::good(now.wall, value));
    let began = now.wall - now.mono;
    let evidence = Evidence { sticky: true, f, f_ci95: [f - 0.1, f + 0.1], at: began, data_end: began };
    Inputs {
        op: sample(50.0 + 0.5 * now.mono),
        pv: sample(51.0),
        sp: sample(50.0),
        mode: sample(1.0),
        evidence: Some(evidence),
        audited: true,
        ..Inputs::default()
    }
}

/// The order of a gate that was opened for a term, and when it was made.
pub fn order(term: f64) -> (Order, Time) {
    let mut gate = Gate::new(LIMITS);
    gate.enable(Time { mono: 0.0, wall: 0.0 });
    for second in 1..30 {
        let now = Time { mono: f64::from(second), wall: f64::from(second) };
        if second == 9 {
            gate.grant("Ann", 60.0, now).and_then(|()| gate.approve("Bob", now)).expect("in shadow");
        }
        match gate.step(now, &seen(now, term)) {
            Some(order) if order.term() == term => return (order, now),
            Some(order) => gate.report(order, Ok(()), now),
            None => {}
        }
    }
    panic!("the gate gives no such order: {:?}", gate.status());
}

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

/// What a device does to its connections, and what came to it.
pub struct Device {
    /// Answers over one connection, after which it closes it; at none it takes a request and closes.
    answers: usize,
    registers: Mutex<[u16; 3]>,
    /// First registers of the writes that came, in order.
    writes: Mutex<Vec<u16>>,
    connections: Mutex<usize>,
    /// Called when a reading is asked for.
    read: Box<dyn Fn() + Send + Sync>,
}

impl Device {
    pub fn new(answers: usize) -> Self {
        let (registers, writes, connections) = Default::default();
        Self { answers, registers, writes, connections, read: Box::new(|| ()) }
    }

    /// Listens; where.
    pub async fn listen(self: &Arc<Self>) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("bound").to_string();
        let device = Arc::clone(self);
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                *device.connections.lock().expect("whole") += 1;
                tokio::spawn(Arc::clone(&device).serve(stream));
            }
        });
        address
    }

    async fn serve(self: Arc<Self>, mut stream: TcpStream) {
        for answered in 0.. {
            let mut head = [0u8; 6];
            if stream.read_exact(&mut head).await.is_err() {
                return;
            }
            let mut body = vec![0u8; usize::from(u16::from_be_bytes([head[4], head[5]]))];
            if stream.read_exact(&mut body).await.is_err() {
                return;
            }
            let answer = self.answer(&body);
            if answered == self.answers {
                return;
            }
            let length = (answer.len() as u16).to_be_bytes();
            let frame = [&head[..4], &length[..], &answer[..]].concat();
            if stream.write_all(&frame).await.is_err() || answered + 1 == self.answers {
                return;
            }
        }
    }

    /// Of a request without its head: unit, function, first register, count, and what is written.
    fn answer(&self, body: &[u8]) -> Vec<u8> {
        let start = u16::from_be_bytes([body[2], body[3]]);
        let at = usize::from(start);
        let count = usize::from(u16::from_be_bytes([body[4], body[5]]));
        let mut registers = self.registers.lock().expect("whole");
        if body[1] == 3 {
            (self.read)();
            let words = registers[at..at + count].iter().flat_map(|word| word.to_be_bytes());
            return [body[0], 3, 2 * count as u8].into_iter().chain(words).collect();
        }
        self.writes.lock().expect("whole").push(start);
        for (register, bytes) in registers[at..at + count].iter_mut().zip(body[7..].chunks_exact(2)) {
            *register = u16::from_be_bytes([bytes[0], bytes[1]]);
        }
        body[..6].to_vec()
    }

    /// The writes that came, and what stands in the registers.
    pub fn heard(&self) -> (Vec<u16>, [u16; 3]) {
        (self.writes.lock().expect("whole").clone(), *self.registers.lock().expect("whole"))
    }
}

/// A writer, with clocks that stand still.
async fn writer(device: &Arc<Device>, now: Time) -> Writer {
    let target = Target { address: device.listen().await, timeout: PATIENCE, ..target() };
    Writer::new(target, Arc::new(move || now))
}

#[tokio::test]
async fn a_device_that_closes_after_each_answer_gets_every_word_once() {
    let device = Arc::new(Device::new(1));
    let (order, made) = order(1.5);
    let mut writer = writer(&device, made).await;
    for exchanges in 1..4 {
        assert_eq!(writer.write(&order).await, Ok(()), "{}", writer.why());
        assert_eq!(device.heard(), ([0, 2].repeat(exchanges), [0x3FC0, 0, order.heartbeat()]));
    }
}

#[tokio::test]
async fn a_connection_that_idled_until_it_was_closed_is_opened_again() {
    let device = Arc::new(Device::new(3));
    let (order, made) = order(1.5);
    let mut writer = writer(&device, made).await;
    for _ in 1..4 {
        assert_eq!(writer.write(&order).await, Ok(()), "{}", writer.why());
        let began = std::time::Instant::now();
        while writer.link.as_ref().is_some_and(Link::is_open) {
            assert!(began.elapsed() < PATIENCE, "the device has not closed it");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
    assert_eq!(device.heard(), ([0, 2].repeat(3), [0x3FC0, 0, order.heartbeat()]));
    assert_eq!(*device.connections.lock().expect("whole"), 3, "one for each exchange");
}

#[tokio::test]
async fn a_write_that_was_not_answered_is_not_written_again() {
    let device = Arc::new(Device::new(0));
    let (order, made) = order(1.5);
    let mut writer = writer(&device, made).await;
    assert_eq!(writer.write(&order).await, Err(WriteFault::Failed));
    assert_eq!(device.heard().0, [0], "the term once, and no heartbeat");
}

/// As of a process that is frozen between the term and its heartbeat: the answer that it waited for is there when it goes on.
#[tokio::test]
async fn an_order_that_became_too_old_has_no_heartbeat() {
    let (early, made) = order(1.5);
    let time = Arc::new(Mutex::new(made));
    let frozen = time.clone();
    let read = move || *frozen.lock().expect("whole") = Time { mono: 60.0, wall: 60.0 };
    let device = Arc::new(Device { read: Box::new(read), ..Device::new(usize::MAX) });
    let target = Target { address: device.listen().await, timeout: PATIENCE, ..target() };
    let mut writer = Writer::new(target, Arc::new(move || *time.lock().expect("whole")));
    assert_eq!(writer.write(&early).await, Err(WriteFault::Withheld));
    assert_eq!(device.heard(), (vec![0], [0x3FC0, 0, 0]));
    // From the beginning it is too old for its term.
    assert_eq!(writer.write(&order(2.0).0).await, Err(WriteFault::Withheld));
    assert_eq!(device.heard(), (vec![0], [0x3FC0, 0, 0]));
}
