//! Hosts: what this machine is called, where a program that we ask wants to know, and addresses as `host:port`.

use std::net::{Ipv4Addr, Ipv6Addr};

/// Longest name (bytes), as the domain name system has it.
const LONGEST: usize = 253;

/// The machine's own name, with nothing in it but letters, digits, `.` and `-`; `localhost` where it has none.
pub fn name() -> String {
    plain(&gethostname::gethostname().to_string_lossy())
}

fn plain(told: &str) -> String {
    let fits = |c: char| if c.is_ascii_alphanumeric() || c == '.' { c } else { '-' };
    let name: String = told.chars().take(LONGEST).map(fits).collect();
    let name = name.trim_matches(['-', '.']);
    if name.is_empty() { "localhost".into() } else { name.into() }
}

/// Host, without brackets, and port of `host:port`.
///
/// # Errors
/// What is wrong, as the rest of a sentence about the address.
pub fn host_and_port(address: &str) -> Result<(String, u16), &'static str> {
    if address.contains("://") {
        return Err("leave out the scheme, up to ://");
    }
    if is_placeholder(address) && !address.contains('@') {
        return Err("variables are not filled in: write the host itself");
    }
    if address.contains(char::is_whitespace) {
        return Err("there is a blank in it");
    }
    if address.contains('@') {
        return Err("a log-in stands in keys of its own, not in the address");
    }
    let Some((host, port)) = address.rsplit_once(':') else {
        let comma = address.contains([',', ';']);
        return Err(if comma {
            "a colon stands before the port, as in 10.0.0.5:502"
        } else {
            "the port is missing"
        });
    };
    let bracketed = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    if bracketed.is_none() && host.contains(':') {
        if host.contains([',', ';']) {
            return Err("one address only: another device is another section");
        }
        if host.contains('.') && host.parse::<Ipv6Addr>().is_err() {
            return Err("there is a second colon: only the port follows the host");
        }
        return Err("an IPv6 address stands in brackets, as in [fe80::1]:502");
    }
    let port = port.parse().ok().filter(|port| *port > 0).ok_or("the port must be 1 to 65535")?;
    match bracketed {
        Some(inner) => {
            let known = inner.parse::<Ipv6Addr>().map_err(|_| "what is in brackets is no IPv6 address")?;
            Ok((known.to_string(), port))
        }
        None => host_fault(host).map_or_else(|| Ok((host.to_string(), port)), Err),
    }
}

/// Whether a text stands for another one, which a program or a person fills in: `%PLC%`, `$PLC`, `<PLC-IP>`, `{{ plc }}`.
fn is_placeholder(text: &str) -> bool {
    let within =
        |open: char, close: char| text.split_once(open).is_some_and(|(_, behind)| behind.contains(close));
    text.contains('$') || within('%', '%') || within('<', '>') || within('{', '}')
}

/// An address as those of one machine and port have it, however they are written: in small letters, and `localhost` for this machine.
pub fn canonical(address: &str) -> String {
    let small = address.to_ascii_lowercase();
    match host_and_port(&small) {
        Ok((host, port)) => match host.strip_suffix('.').unwrap_or(&host) {
            "127.0.0.1" | "::1" => format!("localhost:{port}"),
            host => format!("{host}:{port}"),
        },
        Err(_) => small,
    }
}

/// An address as it may be shown: a log-in in it is a secret.
pub fn shown(address: &str) -> String {
    match address.rsplit_once('@') {
        Some((_, host)) => format!("…@{host}"),
        None => address.to_string(),
    }
}

/// What is wrong with a host's name or IPv4 address.
fn host_fault(host: &str) -> Option<&'static str> {
    let plain = |c: char| c.is_alphanumeric() || matches!(c, '.' | '-' | '_');
    if host.is_empty() {
        return Some("the host is missing");
    }
    if host.contains(',') && host.replace(',', ".").parse::<Ipv4Addr>().is_ok() {
        return Some("\",\" cannot stand in a host: write points");
    }
    if !host.chars().all(plain) {
        return Some("the host has a sign that no name has");
    }
    // A dot at the end says that the name is whole.
    if host.strip_suffix('.').unwrap_or(host).split('.').any(str::is_empty) || host.len() > LONGEST {
        return Some("no host is called so");
    }
    let numbers = host.chars().all(|c| c.is_ascii_digit() || c == '.');
    match host.parse::<Ipv4Addr>() {
        Ok(known) if known.is_unspecified() => Some("0.0.0.0 is no machine's address"),
        Err(_) if numbers => Some("an IPv4 address is four numbers from 0 to 255"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_that_protocols_take() {
        for (told, name) in [
            ("plant-pc", "plant-pc"),
            ("pc.plant.example", "pc.plant.example"),
            ("Leitstand PC_1\n", "Leitstand-PC-1"),
            ("", "localhost"),
            ("--", "localhost"),
        ] {
            assert_eq!(plain(told), name, "{told:?}");
        }
        assert!(plain(&"x".repeat(1000)).len() <= LONGEST);
        assert_eq!(plain(&name()), name());
    }

    #[test]
    fn one_machine_and_port_have_one_address() {
        for (address, own) in [
            ("127.0.0.1:1883", "localhost:1883"),
            ("[::1]:1883", "localhost:1883"),
            ("LocalHost:1883", "localhost:1883"),
            ("Broker.plant.:1883", "broker.plant:1883"),
            ("10.0.0.5:1883", "10.0.0.5:1883"),
            ("No address", "no address"),
        ] {
            assert_eq!(canonical(address), own, "{address}");
        }
    }

    #[test]
    fn addresses_are_taken_apart_or_refused_with_the_reason() {
        for (address, host, port) in [
            ("10.0.0.5:502", "10.0.0.5", 502),
            ("[fe80::1]:502", "fe80::1", 502),
            ("[::ffff:10.0.0.5]:502", "::ffff:10.0.0.5", 502),
            ("localhost:65535", "localhost", 65_535),
            ("plc_1.plant.:1883", "plc_1.plant.", 1883),
            ("leitstand-ä:1", "leitstand-ä", 1),
        ] {
            assert_eq!(host_and_port(address), Ok((host.to_string(), port)), "{address}");
        }
        for (address, why) in [
            ("tcp://10.0.0.5:502", "scheme"),
            ("10.0.0.5", "port is missing"),
            ("10.0.0.5:0", "1 to 65535"),
            ("10.0.0.5:70000", "1 to 65535"),
            ("10.0.0.5 :502", "blank"),
            ("fe80::1:502", "brackets"),
            ("[10.0.0.5]:502", "no IPv6"),
            ("10.0.0.256:502", "IPv4"),
            ("10.0.0.5.1:502", "IPv4"),
            ("10,0,0,5:502", "write points"),
            ("10.0.0.5,502", "a colon"),
            ("u:p@plc:502", "log-in"),
            ("10.0.0.5:5020:1", "a second colon"),
            ("::ffff:10.0.0.5:502", "brackets"),
            ("10.0.0.5:502,10.0.0.6:502", "one address"),
            ("plc?:502", "sign"),
            ("%PLC%:502", "variables are not filled in"),
            ("$PLC:502", "variables are not filled in"),
            ("<PLC-IP>:502", "variables are not filled in"),
            ("{{ plc }}:502", "variables are not filled in"),
            ("plc%1:502", "sign"),
            ("u:$p@plc:502", "log-in"),
            ("plc..plant:502", "no host"),
            ("0.0.0.0:502", "no machine"),
            (":502", "missing"),
            ("", "port is missing"),
            ("h:", "1 to 65535"),
            ("[fd00::5]", "brackets"),
        ] {
            let told = host_and_port(address).expect_err(address);
            assert!(told.contains(why), "{address}: {told}");
        }
    }
}
