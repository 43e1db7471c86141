//! Peers that send without end, whatever is asked of them: no client of ours keeps what it cannot use. The daemon is a process
//! of its own, and its memory is what the system says of it.

/// What a NATS server says until our client is logged in, and something behind it.
macro_rules! logged_in {
    ($($behind:literal)?) => {
        concat!(
            "INFO {\"server_id\":\"x\",\"max_payload\":8388608,\"headers\":true,\"jetstream\":true}\r\nPONG\r\n"
            $(, $behind)?
        )
        .as_bytes()
    };
}

#[path = "endless/limits.rs"]
mod limits;
#[path = "endless/noise.rs"]
mod noise;
#[path = "../numerics/tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;
#[path = "endless/rig.rs"]
mod rig;
#[path = "endless/session.rs"]
mod session;

use rig::{Flood, Wire, flood, holds};

/// What a configuration says where the peer encrypts.
fn ca(wire: Wire) -> &'static str {
    if wire == Wire::Clear { "" } else { "ca_file = 'CERT'\n" }
}

/// Encrypted from the first byte on.
const TLS: Wire = Wire::Tls(0, b"");

fn control_loop(of_tag: impl Fn(usize) -> String) -> String {
    format!(
        "[[loop]]\nid = 'A'\n[loop.op]\ndevice = 'd'\n{}[loop.pv]\ndevice = 'd'\n{}",
        of_tag(0),
        of_tag(2)
    )
}

fn modbus(framing: &str) -> String {
    let tag = |at: usize| format!("register = 'input'\naddress = {at}\ntype = 'f32'\n");
    format!(
        "[[modbus]]\nname = 'd'\naddress = '127.0.0.1:PORT'\nframing = '{framing}'\ntimeout_ms = 1000\naddress_base = 0\n{}",
        control_loop(tag)
    )
}

/// A plant whose device is away.
fn plant() -> String {
    modbus("tcp").replace("PORT", "9")
}

const MODBUS: [Flood; 1] = [flood("heads of the longest", b"", &[0, 1, 0, 0, 0xff, 0xff, 1, 4])];

#[test]
fn modbus_over_tcp() {
    holds("modbus tcp", &modbus("tcp"), Wire::Clear, &MODBUS);
}

const RTU: [Flood; 1] = [flood("answers of 255 bytes", b"", &[1, 4, 255])];

#[test]
fn modbus_rtu_over_tcp() {
    holds("modbus rtu", &modbus("rtu"), Wire::Clear, &RTU);
}

const ACK: &[u8] =
    &[b'A', b'C', b'K', b'F', 28, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
const OPC_UA: [Flood; 4] = [
    flood("a length of 4 GB", b"ACKF\xf0\xff\xff\xff", &[7]),
    flood("a chunk of 4 GB after the greeting", ACK, b"MSGF\xf0\xff\xff\xff"),
    flood("chunks that never end", ACK, b"MSGC\x10\0\0\0\0\0\0\0\0\0\0\0"),
    flood("acknowledgements", ACK, ACK),
];

fn opcua() -> String {
    format!(
        "[[opcua]]\nname = 'd'\nurl = 'opc.tcp://127.0.0.1:PORT/'\nsecurity_policy = 'None'\ntimeout_ms = 4000\n\
         reconnect_max_ms = 100\n{}",
        control_loop(|at| format!("node = 'ns=2;i={at}'\n"))
    )
}

#[test]
fn opc_ua() {
    holds("opc ua", &opcua(), Wire::Clear, &OPC_UA);
}

const MQTT: [Flood; 3] = [
    flood("a packet of 268 MB", &[0x20, 2, 0, 0, 0x30, 0xff, 0xff, 0xff, 0x7f], &[0, 1, b'a']),
    flood("messages", &[0x20, 2, 0, 0], &[0x30, 5, 0, 1, b'a', b'1', b'2']),
    flood("a length that never ends", b"", &[0x30, 0x80]),
];

fn mqtt(wire: Wire) -> String {
    format!(
        "[[mqtt]]\nname = 'd'\naddress = '127.0.0.1:PORT'\ntimeout_s = 4\nreconnect_max_ms = 500\n{}{}",
        ca(wire),
        control_loop(|at| format!("topic = 'a/{at}'\n"))
    )
}

#[test]
fn mqtt_brokers() {
    holds("mqtt", &mqtt(Wire::Clear), Wire::Clear, &MQTT);
}

#[test]
fn mqtt_brokers_by_tls() {
    holds("mqtt, TLS", &mqtt(TLS), TLS, &MQTT);
}

const LET_IN: &[u8] = b"R\0\0\0\x08\0\0\0\0Z\0\0\0\x05I";
const POSTGRESQL: [Flood; 5] = [
    flood("a message of 2 GB before log-in", b"R\x7f\xff\xff\xf0", &[0]),
    flood("settings without end", b"R\0\0\0\x08\0\0\0\0", b"S\0\0\0\x0ca\0b\0c\0d\0"),
    flood("notices without end", LET_IN, b"N\0\0\0\x0cSFATAL\0\0"),
    flood("rows without end", LET_IN, b"D\0\0\0\x06\0\0"),
    flood("a row of 2 GB", LET_IN, b"D\x7f\xff\xff\xf0\0\0"),
];

fn postgresql(wire: Wire) -> String {
    format!("[store]\nfolder = 'FOLDER'\nurl = 'postgres://stictiond@127.0.0.1:PORT/history'\n{}", ca(wire))
}

#[test]
fn postgresql_servers() {
    holds("postgresql", &(postgresql(Wire::Clear) + &plant()), Wire::Clear, &POSTGRESQL);
}

#[test]
fn postgresql_servers_by_tls() {
    // It is asked in eight bytes whether it encrypts.
    let wire = Wire::Tls(8, b"S");
    holds("postgresql, TLS", &(postgresql(wire) + &plant()), wire, &POSTGRESQL);
}

/// What is told at once: that the device is away.
const TOLD: &str = "[alarm.collector_down]\nafter_s = 1.0\n";
const PACE: &str =
    "pace = { wait_s = 0.05, interval_s = 0.0 }\nretry = { first_s = 0.05, longest_s = 0.1 }\n";

const MAIL: [Flood; 3] = [
    flood("a greeting without a line end", b"220 ", b"a"),
    flood("lines without end", b"", b"220-still\r\n"),
    flood("an answer without end", b"220 here\r\n", b"250-more\r\n"),
];

fn mail(wire: Wire) -> String {
    let security = if wire == Wire::Clear { "none" } else { "tls" };
    format!(
        "[[notify.smtp]]\nname = 'm'\naddress = '127.0.0.1:PORT'\nsecurity = '{security}'\ntimeout_s = 12.0\n{}\
         from = 's@plant.example'\nto = ['a@plant.example']\n{PACE}",
        ca(wire)
    )
}

#[test]
fn mail_servers() {
    holds("mail", &[TOLD, &mail(Wire::Clear), &plant()].concat(), Wire::Clear, &MAIL);
}

#[test]
fn mail_servers_by_tls() {
    holds("mail, TLS", &[TOLD, &mail(TLS), &plant()].concat(), TLS, &MAIL);
}

const WEB: [Flood; 5] = [
    flood("a status line without end", b"HTTP/1.1 ", b"2"),
    flood("a head without end", b"HTTP/1.1 200 OK\r\n", b"x-a: b\r\n"),
    flood("a body without end", b"HTTP/1.1 500 No\r\n\r\n", b"a"),
    flood("chunks without end", b"HTTP/1.1 500 No\r\ntransfer-encoding: chunked\r\n\r\n", b"1\r\na\r\n"),
    flood("preliminary answers", b"", b"HTTP/1.1 103 Early Hints\r\nx: y\r\n\r\n"),
];

fn web(wire: Wire) -> String {
    let scheme = if wire == Wire::Clear { "http" } else { "https" };
    format!(
        "[[notify.webhook]]\nname = 'w'\nurl = '{scheme}://127.0.0.1:PORT/'\nsecret_file = 'SECRET'\n\
         timeout_s = 3.0\n{}{PACE}",
        ca(wire)
    )
}

#[test]
fn web_servers() {
    holds("webhook", &[TOLD, &web(Wire::Clear), &plant()].concat(), Wire::Clear, &WEB);
}

#[test]
fn web_servers_by_tls() {
    holds("webhook, TLS", &[TOLD, &web(TLS), &plant()].concat(), TLS, &WEB);
}

const NATS: [Flood; 8] = [
    flood("a greeting without end", b"INFO {\"server_id\":\"", b"x"),
    flood("a message of 4 GB", logged_in!("MSG a 1 4000000000\r\n"), b"x"),
    flood("a message of 4 GB with a head", logged_in!("HMSG a 1 12 4000000000\r\nNATS/1.0\r\n\r\n"), b"x"),
    flood("a message of 8 MB and no end", logged_in!("MSG a 1 8323072\r\n"), b"x"),
    flood("a line without end", logged_in!(), b"MSG "),
    flood("messages", logged_in!(), b"MSG a 1 5\r\nhello\r\n"),
    flood("questions", logged_in!(), b"PING\r\n"),
    // The library panics at it, and never connects again.
    flood("errors without a word", logged_in!(), b"-ERR\r\n"),
];
const NATS_BY_TLS: [Flood; 4] = [
    flood("a message of 4 GB", b"PONG\r\nMSG a 1 4000000000\r\n", b"x"),
    flood("a line without end", b"PONG\r\n", b"MSG "),
    flood("messages", b"PONG\r\n", b"MSG a 1 5\r\nhello\r\n"),
    flood("questions", b"PONG\r\n", b"PING\r\n"),
];

fn nats(wire: Wire) -> String {
    let scheme = if wire == Wire::Clear { "nats" } else { "tls" };
    format!("[fleet]\nservers = ['{scheme}://127.0.0.1:PORT']\n{}", ca(wire))
}

#[test]
fn nats_servers() {
    holds("nats", &nats(Wire::Clear), Wire::Clear, &NATS);
}

#[test]
fn nats_servers_by_tls() {
    // It says so in the clear.
    let wire = Wire::Tls(0, b"INFO {\"server_id\":\"x\",\"max_payload\":8388608,\"tls_required\":true}\r\n");
    holds("nats, TLS", &nats(wire), wire, &NATS_BY_TLS);
}
