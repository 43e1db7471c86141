//! Users and tokens at the command line, and what a configuration is refused for.

use super::rig::{folder, text};
use std::fs;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};
use stictiond::access::file::load;
use stictiond::config;

/// Exit code, standard output and error; `given` on standard input.
fn stictiond(args: &[&str], given: &str) -> (Option<i32>, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("starts");
    // A command that does not want it has gone already.
    let _ = child.stdin.take().expect("piped").write_all(given.as_bytes());
    let output = child.wait_with_output().expect("ends");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn users_and_tokens_are_made_by_commands_and_kept_without_secrets() {
    let folder = folder("commands");
    let config = folder.join("stictiond.toml");
    fs::write(&config, text(&folder, "")).expect("written");
    let config = config.display().to_string();
    let run = |args: &[&str], given: &str| stictiond(&[args, &["--config", &config]].concat(), given);
    let says = |args: &[&str]| run(args, "").1;
    assert!(says(&["check"]).contains("is not there, so nobody can log in"));
    let (code, out, err) =
        run(&["user", "add", "m.keller", "--role", "operator,approver"], "ein langes Wort\n");
    assert_eq!((code, out.as_str(), err.as_str()), (Some(0), "m.keller: added as operator, approver\n", ""));
    for (given, why) in [("kurz\n", "at least 10"), ("xx m.weber xx\n", "user's name"), ("", "at least 10")] {
        let (code, _, err) = run(&["user", "add", "m.weber", "--role", "viewer"], given);
        assert!(code == Some(2) && err.contains(why) && err.lines().count() == 1, "{err}");
    }
    let (code, _, err) = run(&["user", "add", "M.Keller", "--role", "viewer"], "ein langes Wort\n");
    assert!(code == Some(2) && err.contains("already a user"), "{err}");
    assert_eq!(says(&["user", "list"]), format!("{:<24} operator, approver\n", "m.keller"));
    let token = says(&["token", "create", "prometheus", "--role", "viewer", "--days", "30"]);
    let token = token.trim();
    assert!(token.starts_with("stictiond_") && token.len() == 10 + 12 + 1 + 64, "{token}");
    let list = says(&["token", "list"]);
    assert!(
        list.contains("prometheus") && !list.contains(token.rsplit('_').next().expect("a secret")),
        "{list}"
    );
    let file = folder.join("access.json");
    assert_eq!(fs::metadata(&file).expect("there").permissions().mode() & 0o777, 0o600);
    let kept = fs::read_to_string(&file).expect("text");
    assert!(!kept.contains("ein langes Wort") && !kept.contains(token.rsplit('_').next().expect("a secret")));
    let now = super::rig::now();
    assert!(load(&file).expect("a book").token(token, now).is_ok());
    let other = says(&["token", "rotate", "prometheus"]);
    let book = load(&file).expect("a book");
    assert!(book.token(token, now + 5.0).is_err() && book.token(other.trim(), now + 5.0).is_ok());
    let check = says(&["check"]);
    assert!(
        check.contains("everything but /healthz and /readyz needs a log-in or token: 1 users, 2 tokens"),
        "{check}"
    );
    assert!(check.contains("nobody is engineer"), "{check}");
    assert_eq!(run(&["user", "passwd", "m.keller"], "ein anderes Wort\n").0, Some(0));
    assert!(load(&file).expect("a book").user("m.keller").expect("there").password.is("ein anderes Wort"));
    assert_eq!(run(&["user", "roles", "m.keller", "--role", "viewer"], "").0, Some(0));
    assert_eq!(run(&["token", "revoke", "prometheus"], "").0, Some(0));
    assert_eq!(run(&["user", "remove", "m.keller"], "").0, Some(0));
    let book = load(&file).expect("a book");
    assert!(book.users.is_empty() && book.tokens.is_empty());
    for args in [
        &["user", "remove", "nobody"][..],
        &["token", "revoke", "none"],
        &["user", "add", "x", "--role", "god"],
        &["user", "passwd", "nobody"],
    ] {
        let (code, _, err) = run(args, "ein langes Wort\n");
        assert!(code == Some(2) && !err.is_empty(), "{args:?}: {err}");
    }
    // Readable by others: refused, and check says that nobody gets in.
    fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).expect("set");
    let (code, out, err) = run(&["check"], "");
    assert_eq!(code, Some(2), "{err}");
    assert!(out.contains("NOBODY GETS IN") && !out.contains(": good"), "{out}");
    assert!(err.contains(": run will not start: [access] file: "), "{err}");
    assert_eq!(run(&["user", "list"], "").0, Some(2));
    // A certificate that cannot be read would stop the daemon too: check says so, and run does.
    let tls = "[server.tls]\ncert_file = 'not-there.pem'\nkey_file = 'not-there.key'\n[access]";
    fs::write(&config, text(&folder, "").replace("[access]", tls)).expect("written");
    let (code, out, err) = run(&["check"], "");
    let why = "[server.tls] cert_file = not-there.pem: ";
    assert!(code == Some(2) && out.contains(&format!("; BUT RUN WILL NOT START: {why}")), "{out}");
    let both = err.contains(why) && err.contains("; [access] file: ");
    assert!(both && err.lines().count() == 1, "both are told, in a line: {err}");
}

#[test]
fn the_network_is_refused_without_tls_and_log_in() {
    let folder = folder("network");
    let errors = |text: &str| match config::parse("f", text) {
        Ok(_) => Vec::new(),
        Err(errors) => errors.iter().map(ToString::to_string).collect::<Vec<_>>(),
    };
    let open = text(&folder, "listen = '0.0.0.0:8080'");
    assert!(
        matches!(&errors(&open)[..], [one] if one.contains("passwords and tokens can be read on the way"))
    );
    let (head, rest) = open.split_once("[access]").expect("a log-in");
    let (_, rest) = rest.split_once("[[modbus]]").expect("a device");
    let without = format!("{head}[[modbus]]{rest}");
    assert!(
        matches!(&errors(&without)[..], [one] if one.contains("there is no log-in")),
        "{:?}",
        errors(&without)
    );
    let proxied = text(&folder, "listen = '0.0.0.0:8080'\nallow_plain_http_on_network = true");
    assert_eq!(errors(&proxied), [""; 0]);
    let tls = text(&folder, "listen = '0.0.0.0:8080'\n[server.tls]\ncert_file = 'c'\nkey_file = 'k'");
    assert_eq!(errors(&tls), [""; 0]);
    let unrecorded = text(&folder, "").replace("[audit]\nfile", "[history]\nfile");
    assert!(
        errors(&unrecorded).iter().any(|error| error.contains("[access] needs [audit]")),
        "{:?}",
        errors(&unrecorded)
    );
}

#[test]
fn a_name_from_the_plant_is_never_a_formula() {
    let folder = folder("formula");
    let place = |name: &str| folder.join(name).display().to_string();
    let table = "loop,tag,t,value,unit\n'=1+cmd|x,@op,1763700000,-2,-\n'-2+3,op,1763700000,3,%\n";
    fs::write(place("in.csv"), table).expect("written");
    let run = |args: &[&str]| stictiond(&[&["store"], args].concat(), "");
    let (code, _, err) = run(&["import", &place("store"), &place("in.csv")]);
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = run(&["export", &place("store"), &place("out.csv")]);
    assert_eq!(code, Some(0), "{err}");
    let out = fs::read_to_string(place("out.csv")).expect("text");
    for cell in out.lines().flat_map(|line| line.split(',')) {
        let number = cell.parse::<f64>().is_ok();
        assert!(number || !cell.starts_with(['=', '+', '-', '@', '\t', '\r']), "{cell:?} in {out}");
    }
    assert!(out.contains("'=1+cmd|x") && out.contains("'@op") && out.contains("'-2+3"), "{out}");
    // Twice through it is the same.
    assert_eq!(run(&["import", &place("again"), &place("out.csv")]).0, Some(0));
    assert_eq!(run(&["export", &place("again"), &place("twice.csv")]).0, Some(0));
    assert_eq!(fs::read_to_string(place("twice.csv")).expect("text"), out);
}
