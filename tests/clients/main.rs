//! What is documented for who uses the API, against a running demo: every curl line of docs/api.md, a client that is
//! generated from the description, and the notebook.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};
use tokio::time::timeout;

/// Far longer than anything here takes even on a busy machine; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(180);
/// How the documents name the daemon.
const BASE: &str = "http://127.0.0.1:8080";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn peer(name: &str) -> PathBuf {
    let path = root().join("target/peers-venv/bin").join(name);
    assert!(path.exists(), "{name} is not installed: run scripts/peers once, then the tests again");
    path
}

/// The demo as a process, killed when dropped.
struct Demo {
    _child: Child,
    base: String,
    folder: PathBuf,
}

impl Demo {
    /// Starts it and waits until it has something to show: an alarm of a frozen tag, and a valve that sticks.
    async fn start() -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("clients");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        // Every call says its status on standard error, and none hangs.
        let rc = "silent\nshow-error\nmax-time = 90\nwrite-out = \"%{stderr}status %{http_code}\\n\"\n";
        std::fs::write(folder.join(".curlrc"), rc).expect("written");
        let mut child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args(["demo", "--listen", "127.0.0.1:0"])
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let base = until(&mut lines, |line| {
            let (_, rest) = line.split_once("dashboard ")?;
            Some(rest.split_once("/,")?.0.to_string())
        });
        let base = timeout(PATIENCE, base).await.expect("an address in time");
        // Its table is drawn over and over: somebody has to take it.
        tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
        let demo = Self { _child: child, base, folder };
        timeout(PATIENCE, demo.has_something_to_show()).await.expect("an alarm and a verdict in time");
        demo
    }

    async fn has_something_to_show(&self) {
        let mut events = Command::new("curl")
            .args(["--silent", "--no-buffer", &format!("{}/api/v1/events", self.base)])
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .expect("curl is there");
        let mut lines = BufReader::new(events.stdout.take().expect("piped")).lines();
        let (mut alarm, mut verdict) = (false, false);
        until(&mut lines, |line| {
            alarm |= line.contains("\"PIC302/tag_bad\"") && line.contains("\"to\":\"unacknowledged\"");
            verdict |= line.contains("\"outcome\":\"stiction\"");
            (alarm && verdict).then_some(())
        })
        .await;
    }

    /// What a documented line is answered with. The demo looks at its plant by itself too, and refuses to look twice at a
    /// time; so a line that asks for a look is asked again until that one has ended.
    async fn answer(&self, line: &str) -> (Option<u16>, String, String) {
        let answered = async {
            loop {
                let (_, output, errors) = self.run("sh", &["-c", &line.replace(BASE, &self.base)]).await;
                if !output.contains("urn:stictiond:problem:looking") {
                    let status = errors.lines().find_map(|line| line.strip_prefix("status ")?.parse().ok());
                    return (status, output, errors);
                }
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        };
        timeout(PATIENCE, answered).await.expect("a look ends in time")
    }

    /// Runs a command in the demo's folder: whether it went well, what it said, and what it said of errors.
    async fn run(&self, program: impl AsRef<std::ffi::OsStr>, args: &[&str]) -> (bool, String, String) {
        let mut command = Command::new(program);
        command.args(args).env("CURL_HOME", &self.folder).env("TOKEN", "none").env("PYTHONUNBUFFERED", "1");
        let output = command.current_dir(&self.folder).kill_on_drop(true).output();
        let output = timeout(PATIENCE, output).await.expect("ends in time").expect("runs");
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        (output.status.success(), text(&output.stdout), text(&output.stderr))
    }
}

async fn until<T>(lines: &mut Lines<BufReader<ChildStdout>>, mut found: impl FnMut(&str) -> Option<T>) -> T {
    loop {
        let line = lines.next_line().await.expect("text").expect("it goes on");
        if let Some(value) = found(&line) {
            return value;
        }
    }
}

/// The curl lines of a document's blocks of shell, and the status that each says it is answered with.
fn curls(document: &str) -> Vec<(String, Option<u16>)> {
    let text = std::fs::read_to_string(root().join(document)).expect("the document is there");
    let blocks = text.split("```sh\n").skip(1).filter_map(|rest| Some(rest.split_once("```")?.0.to_string()));
    let lines = blocks.flat_map(|block| block.lines().map(str::to_string).collect::<Vec<_>>());
    let lines = lines.filter(|line| line.starts_with("curl "));
    let status = |line: &str| line.rsplit_once("  # ")?.1.get(..3)?.parse().ok();
    lines.map(|line| (line.clone(), status(&line))).collect()
}

async fn documented_lines(demo: &Demo) {
    let lines = curls("docs/api.md");
    assert!(lines.len() > 35, "only {} lines", lines.len());
    for (line, said) in lines {
        assert!(line.contains(BASE), "{line}");
        let (status, output, errors) = demo.answer(&line).await;
        let right = match (said, status) {
            (None, Some(status)) => (200..300).contains(&status),
            (said, status) => said == status,
        };
        assert!(right, "{line}\nstatus {status:?}, documented {said:?}\n{output}{errors}");
        if status.is_some_and(|status| status >= 400) {
            assert!(output.contains("urn:stictiond:problem:"), "{line}\n{output}");
        }
    }
    let tag = std::fs::read_to_string(demo.folder.join("loops.etag")).expect("curl has kept the validator");
    assert!(tag.starts_with("W/\""), "{tag}");
    let page = std::fs::read_to_string(demo.folder.join("PIC303.html")).expect("the report was written");
    assert!(page.contains("PIC303"));
}

async fn generated_client(demo: &Demo) {
    let url = format!("{}/openapi.json", demo.base);
    let config = root().join("tests/clients/generator.yml").display().to_string();
    let made = ["generate", "--url", &url, "--config", &config, "--meta", "none", "--fail-on-warning"];
    let made = [&made[..], &["--output-path", "stictiond_client", "--overwrite"]].concat();
    let (good, output, errors) = demo.run(peer("openapi-python-client"), &made).await;
    assert!(good, "{output}{errors}");
    let script = root().join("tests/clients/generated.py").display().to_string();
    let (good, output, errors) = demo.run(peer("python"), &[&script, ".", &demo.base]).await;
    assert!(good && output.contains("the generated client works"), "{output}{errors}");
}

async fn notebook(demo: &Demo) {
    let script = root().join("examples/pandas_f.py").display().to_string();
    let (good, output, errors) = demo.run(peer("python"), &[&script, &demo.base]).await;
    assert!(good, "{output}{errors}");
    println!("{output}");
    // Every loop of the plant stands in the first table, with f where there is one.
    for loop_id in ["FIC101", "LIC204", "PIC303", "TIC403"] {
        assert!(output.contains(loop_id), "{loop_id} in {output}");
    }
    assert!(output.contains("stiction") && output.contains("pv"), "{output}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_documented_of_the_api_works_against_a_running_demo() {
    let demo = Demo::start().await;
    documented_lines(&demo).await;
    generated_client(&demo).await;
    notebook(&demo).await;
}
