//! Somebody who takes webhooks.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};
use std::time::SystemTime;

/// Somebody who takes whatever is posted: where, and the bodies with when they came.
pub fn receiver() -> (SocketAddr, Receiver<(SystemTime, String)>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let (address, (tell, told)) = (listener.local_addr().expect("bound"), channel());
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(body) = stream.and_then(|stream| whole_body(&mut BufReader::new(stream))) else {
                continue;
            };
            if tell.send((SystemTime::now(), body)).is_err() {
                return;
            }
        }
    });
    (address, told)
}

/// The body of one request, which is answered; an error if its sender went away first, as one that is killed does.
fn whole_body(stream: &mut BufReader<TcpStream>) -> std::io::Result<String> {
    let mut length = 0;
    loop {
        let mut line = String::new();
        match stream.read_line(&mut line)? {
            0 => return Err(ErrorKind::UnexpectedEof.into()),
            1 | 2 => break,
            _ => (),
        }
        let lower = line.to_lowercase();
        length =
            lower.strip_prefix("content-length:").map_or(length, |n| n.trim().parse().expect("a number"));
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body)?;
    // A sender that is killed now has told all the same.
    let _ = stream.get_mut().write_all(b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n");
    Ok(String::from_utf8(body).expect("text"))
}
