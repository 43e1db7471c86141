//! What is in deploy/, held against those who read it: schemas of Compose and Kubernetes, promtool, amtool, systemd, a
//! running nginx and a running Caddy; hadolint for the Dockerfile.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use stictiond::config;

fn deploy(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy").join(name)
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// Runs a tool of the peers: whether it went well, and everything it said.
fn run(tool: &Path, args: &[&str]) -> (bool, String) {
    let output = Command::new(tool).args(args).output();
    let output = output.unwrap_or_else(|_| panic!("{} is not there: run scripts/peers", tool.display()));
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.success(), said.into_owned())
}

fn passes(tool: &str, args: &[&str]) -> String {
    let (good, said) = run(Path::new(tool), args);
    assert!(good, "{tool} {args:?}: {said}");
    said
}

#[test]
fn compose_and_kubernetes_fit_their_schemas_and_are_closed() {
    let (root, out) = (Path::new(env!("CARGO_MANIFEST_DIR")), folder("deploy-check"));
    let schema = root.join("target/peers-compose/compose/config/compose_spec.json");
    let args =
        [&root.join("tests/deploy/check.py"), root, &schema, &out].map(|path| path.display().to_string());
    let args = args.each_ref().map(String::as_str);
    let (good, said) = run(&root.join("target/peers-venv/bin/python"), &args);
    assert!(good, "{said}");
    let told = fs::read_to_string(out.join("kubernetes.toml")).expect("written");
    assert!(config::parse("kubernetes.toml", &told).is_ok());
}

#[test]
fn prometheus_and_alertmanager_take_their_configuration() {
    let path = |name: &str| deploy(name).display().to_string();
    let said = passes("promtool", &["check", "config", &path("prometheus/prometheus.yml")]);
    assert!(said.contains("rules found"), "{said}");
    let said = passes("amtool", &["check-config", &path("alertmanager/alertmanager.yml")]);
    assert!(said.contains("1 receivers"), "{said}");
}

#[test]
fn hadolint_finds_nothing_in_the_dockerfile() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let hadolint = root.join("target/peers-venv/bin/hadolint");
    let lint = |file: &Path| run(&hadolint, &["--no-color", &file.display().to_string()]);
    assert_eq!(lint(&root.join("Dockerfile")), (true, String::new()));
    let bad = folder("deploy-dockerfile").join("Dockerfile");
    fs::write(&bad, "FROM debian\nRUN sudo make\nENTRYPOINT run\n").expect("written");
    let (good, said) = lint(&bad);
    assert!(!good && ["DL3006", "DL3004", "DL3025"].iter().all(|rule| said.contains(rule)), "{said}");
}

#[test]
fn what_the_dockerfile_copies_is_sent_to_the_builder_and_is_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |name: &str| fs::read_to_string(root.join(name)).expect(name);
    let (dockerfile, ignore) = (read("Dockerfile"), read(".dockerignore"));
    let sent: Vec<&str> = ignore.lines().filter_map(|line| line.strip_prefix('!')).collect();
    let copies = dockerfile
        .lines()
        .filter_map(|line| line.strip_prefix("COPY "))
        .filter(|line| !line.starts_with("--"));
    let mut copied = 0;
    for line in copies {
        let words: Vec<&str> = line.split_whitespace().collect();
        for source in &words[..words.len() - 1] {
            assert!(sent.contains(source), "{source} is copied and not sent: .dockerignore leaves it out");
            assert!(root.join(source).exists(), "{source} is not there");
            copied += 1;
        }
    }
    assert!(copied >= 8, "{copied}");
    // What the manifests name has to be there for a build.
    for member in ["numerics", "tables", "benches", ".cargo"] {
        assert!(sent.contains(&member), "{member}");
    }
}

#[test]
fn systemd_takes_the_unit_and_finds_little_that_it_may() {
    let folder = folder("deploy-systemd");
    let unit = fs::read_to_string(deploy("systemd/stictiond.service")).expect("the unit");
    // Where the binary of this build is.
    let here = unit.replace("/usr/local/bin/stictiond", env!("CARGO_BIN_EXE_stictiond"));
    let file = folder.join("stictiond.service");
    fs::write(&file, here).expect("written");
    let file = file.display().to_string();
    let said = passes("systemd-analyze", &["verify", "--man=no", &file]);
    assert_eq!(said, "", "systemd warns");
    // Its exposure is 1.2 of 10; a unit without any of this has 9.6.
    passes("systemd-analyze", &["security", "--offline=true", "--threshold=15", &file]);
    let bare = folder.join("bare.service");
    fs::write(&bare, "[Service]\nExecStart=/bin/true\n").expect("written");
    let bare = bare.display().to_string();
    let (good, _) =
        run(Path::new("systemd-analyze"), &["security", "--offline=true", "--threshold=15", &bare]);
    assert!(!good, "a unit that may everything is refused");
}

/// A process that ends with the test.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A daemon without a reachable device, and its address.
fn daemon(folder: &Path) -> (Killed, String) {
    let tag =
        |address: u16| format!("{{ device = 'd', register = 'input', address = {address}, type = 'f32' }}");
    let text = format!(
        "[server]\nlisten = '127.0.0.1:0'\nhosts = ['stictiond.plant.example']\n[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n\
         [[loop]]\nid = 'A'\nop = {}\npv = {}\n",
        tag(0),
        tag(2)
    );
    let file = folder.join("stictiond.toml");
    fs::write(&file, text).expect("written");
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    command.args(["run", "--log-format", "json", "--config"]).arg(&file).env_remove("RUST_LOG");
    let mut child = command.stderr(Stdio::piped()).spawn().expect("starts");
    let log = BufReader::new(child.stderr.take().expect("piped"));
    let served =
        log.lines().map_while(Result::ok).find(|line| line.contains("\"serving\"")).expect("it serves");
    let line: serde_json::Value = serde_json::from_str(&served).expect("JSON");
    (Killed(child), line["address"].as_str().expect("an address").to_string())
}

/// A certificate for the samples' host, and its key.
fn certificate(folder: &Path) {
    let made = rcgen::generate_simple_self_signed(["stictiond.plant.example".to_string()]).expect("made");
    fs::write(folder.join("stictiond.pem"), made.cert.pem()).expect("written");
    fs::write(folder.join("stictiond.key"), made.signing_key.serialize_pem()).expect("written");
}

/// Starts a proxy and waits until it says this.
fn started(command: &mut Command, ready: &str) -> Killed {
    let mut child = command.stderr(Stdio::piped()).spawn().expect("starts");
    let mut log = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
    assert!(log.any(|line| line.contains(ready)), "{command:?} ended");
    std::thread::spawn(move || log.for_each(drop));
    Killed(child)
}

/// nginx with the sample, its port a socket in a folder, its backend the daemon.
fn nginx(folder: &Path, daemon: &str) -> Killed {
    let place = folder.display().to_string();
    let sample = fs::read_to_string(deploy("proxy/nginx.conf")).expect("the sample");
    let sample = sample
        .replace("listen 443 ssl", &format!("listen unix:{place}/socket ssl"))
        .replace("/etc/nginx/", &format!("{place}/"))
        .replace("127.0.0.1:8080", daemon);
    let paths: String = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"]
        .map(|name| format!("{name}_temp_path {place}/{name};\n"))
        .concat();
    let whole = format!(
        "daemon off;\nmaster_process off;\npid {place}/pid;\nerror_log stderr notice;\nevents {{}}\n\
         http {{\naccess_log off;\n{paths}{sample}}}\n"
    );
    let file = folder.join("nginx.conf");
    fs::write(&file, whole).expect("written");
    let file = file.display().to_string();
    passes("nginx", &["-t", "-q", "-p", &place, "-c", &file]);
    started(Command::new("nginx").args(["-p", &place, "-c", &file]), "event method")
}

/// Caddy with the sample, the same way, and with a certificate of the test's own: there is nobody here to get one from.
fn caddy(folder: &Path, daemon: &str) -> Killed {
    let place = folder.display().to_string();
    let sample = fs::read_to_string(deploy("proxy/Caddyfile")).expect("the sample");
    let here = format!(
        "stictiond.plant.example {{\n\tbind unix/{place}/socket\n\ttls {place}/stictiond.pem {place}/stictiond.key\n"
    );
    let own = sample.replace("stictiond.plant.example {\n", &here).replace("127.0.0.1:8080", daemon);
    assert!(own.contains(&here) && own.contains(daemon), "{own}");
    let global = "{\n\tadmin off\n\tauto_https disable_redirects\n\tservers {\n\t\tprotocols h1 h2\n\t}\n}\n";
    let file = folder.join("Caddyfile");
    fs::write(&file, format!("{global}{own}")).expect("written");
    let file = file.display().to_string();
    // The sample itself, and what is made of it here.
    passes("caddy", &["validate", "--adapter", "caddyfile", "--config", &file]);
    let sample = deploy("proxy/Caddyfile").display().to_string();
    passes("caddy", &["validate", "--adapter", "caddyfile", "--config", &sample]);
    let mut command = Command::new("caddy");
    command.args(["run", "--adapter", "caddyfile", "--config", &file]).env("HOME", folder);
    started(
        command.env("XDG_DATA_HOME", folder).env("XDG_CONFIG_HOME", folder),
        "serving initial configuration",
    )
}

/// Asks as a browser far away would; what came, the head first where `more` has `-i`, and the status.
fn ask(folder: &Path, path: &str, more: &[&str]) -> String {
    let socket = folder.join("socket").display().to_string();
    let roots = folder.join("stictiond.pem").display().to_string();
    let url = format!("https://stictiond.plant.example{path}");
    let common = ["-sS", "--unix-socket", &socket, "--cacert", &roots, "-w", "\nstatus %{http_code}"];
    run(Path::new("curl"), &[&common[..], more, &[&url]].concat()).1
}

/// What must work behind either.
fn pages_changes_and_streams_work(folder: &Path) {
    let page = ask(folder, "/", &["-i"]).to_lowercase();
    assert!(page.contains("<!doctype html>") && page.contains("\nstatus 200"), "{page}");
    for header in [
        "strict-transport-security: max-age=",
        "content-security-policy: default-src 'none'",
        "x-content-type-options: nosniff",
    ] {
        assert!(page.contains(header), "{header} is missing: {page}");
    }
    assert!(ask(folder, "/api/v1/loops", &[]).contains("\"total\":1"));
    // A page of this host may act, one of another may not.
    let act = |origin: &str| {
        ask(folder, "/api/v1/alarms/A/ack", &["-X", "POST", "-H", &format!("origin: {origin}")])
    };
    assert!(act("https://stictiond.plant.example").contains("status 409"), "there is nothing to acknowledge");
    assert!(act("https://evil.example").contains("status 403"));
    // A name with a slash in it arrives as it was sent.
    let halves = |name: &str| ask(folder, &format!("/api/v1/alarms/{name}/ack"), &["-X", "POST"]);
    for name in ["A%2Fstiction", "A/stiction"] {
        assert!(halves(name).contains("status 409"), "{name}");
    }
    // What comes is passed on at once: a proxy that buffers has nothing to show in two seconds.
    for path in ["/api/v1/events", "/api/v1/loops/A/live"] {
        for more in [&["-N", "--max-time", "2"][..], &["-N", "--max-time", "2", "--compressed"]] {
            let said = ask(folder, path, more);
            assert!(said.contains("event: hello"), "{path} {more:?}: {said}");
        }
    }
    let large = folder.join("large");
    fs::write(&large, vec![b'x'; 20_000]).expect("written");
    let body = format!("@{}", large.display());
    let said = ask(folder, "/api/v1/alarms/A/ack", &["--data-binary", &body]);
    assert!(said.contains("status 413"), "{said}");
}

#[test]
fn behind_nginx_by_the_sample_pages_changes_and_streams_work() {
    let folder = folder("deploy-nginx");
    certificate(&folder);
    let (_daemon, address) = daemon(&folder);
    let _proxy = nginx(&folder, &address);
    pages_changes_and_streams_work(&folder);
    // Ten log-ins at once and no more.
    let tries: Vec<String> = (0..15)
        .map(|_| ask(&folder, "/api/v1/session", &["-H", "content-type: application/json", "-d", "{}"]))
        .collect();
    assert!(tries.last().expect("some").contains("status 503"), "{tries:?}");
}

#[test]
fn behind_caddy_by_the_sample_pages_changes_and_streams_work() {
    let folder = folder("deploy-caddy");
    certificate(&folder);
    let (_daemon, address) = daemon(&folder);
    let _proxy = caddy(&folder, &address);
    pages_changes_and_streams_work(&folder);
}
