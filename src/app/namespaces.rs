//! Which namespaces the numbers of OPC UA tags meant at first, shared by all who ask a server and kept beside the store: a server
//! may number its namespaces anew while the daemon does not run.
//!
//! It is looked once a second whether there are new ones. No collector waits for the disk by that.

use crate::collect::opcua::Pinned;
use crate::config::Config;
use std::io;
use std::path::PathBuf;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// The file in the store's folder.
const FILE: &str = "namespaces";
/// How often it is looked whether there are new ones.
const TICK: Duration = Duration::from_secs(1);

/// The namespaces of all servers.
pub(super) struct Namespaces {
    pinned: Pinned,
    /// `None` where there is no store: then a restart begins anew.
    file: Option<PathBuf>,
    /// What the file has.
    kept: String,
}

impl Namespaces {
    /// Those that were kept. A file that is damaged is an entry in the log, and the daemon starts without it.
    pub(super) fn new(config: &Config) -> Self {
        let file = config.store.as_ref().map(|store| store.folder.join(FILE));
        let pinned = file.as_deref().map(Pinned::read).unwrap_or_else(|| Ok(Pinned::default()));
        let pinned = pinned.unwrap_or_else(|error| {
            let file = file.as_deref().map(|file| file.display().to_string()).unwrap_or_default();
            tracing::warn!(
                file,
                %error,
                "which namespaces the numbers of OPC UA tags meant cannot be read, so they mean what the servers say now"
            );
            Pinned::default()
        });
        let kept = pinned.to_text();
        Self { pinned, file, kept }
    }

    /// For all who ask a server.
    pub(super) fn pinned(&self) -> &Pinned {
        &self.pinned
    }

    /// Keeps what is new until `stop` is cancelled, and once more after that.
    pub(super) async fn run(&self, stop: CancellationToken) {
        let Some(file) = &self.file else { return };
        let (mut kept, mut failed) = (self.kept.clone(), false);
        loop {
            let stopped = stop.run_until_cancelled(tokio::time::sleep(TICK)).await.is_none();
            let text = self.pinned.to_text();
            if text != kept {
                match keep(file.clone(), text.clone()).await {
                    Ok(()) => (kept, failed) = (text, false),
                    Err(error) if !failed => {
                        let file = file.display().to_string();
                        tracing::warn!(
                            file,
                            %error,
                            "which namespaces the numbers of OPC UA tags mean is not kept over a restart"
                        );
                        failed = true;
                    }
                    // It was said.
                    Err(_) => {}
                }
            }
            if stopped {
                return;
            }
        }
    }
}

/// Writes the file on a thread that may wait for the disk.
async fn keep(file: PathBuf, text: String) -> io::Result<()> {
    let kept = tokio::task::spawn_blocking(move || Pinned::keep(&text, &file)).await;
    kept.unwrap_or_else(|error| Err(io::Error::other(error)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store;

    const URL: &str = "opc.tcp://plant:4840/";

    #[tokio::test]
    async fn what_a_number_meant_is_known_after_a_restart() {
        let folder = std::env::temp_dir().join(format!("stictiond-namespaces-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("writable");
        let config = Config { store: Some(store::Config::new(&folder)), ..Config::default() };
        let stop = CancellationToken::new();
        stop.cancel();
        let first = Namespaces::new(&config);
        first.run(stop.clone()).await;
        assert!(!folder.join(FILE).exists(), "nothing is new");
        first.pinned().pin(URL, 2, "urn:a");
        first.run(stop.clone()).await;
        let second = Namespaces::new(&config);
        assert_eq!(second.pinned().to_text(), first.pinned().to_text());
        assert!(second.pinned().to_text().contains("urn:a"));
        // What is damaged is not believed, and no reason not to start.
        std::fs::write(folder.join(FILE), second.pinned().to_text().replace("urn:a", "urn:b"))
            .expect("writable");
        let third = Namespaces::new(&config);
        assert_eq!(third.pinned().to_text(), Pinned::default().to_text());
        // Without a store nothing is written anywhere.
        let none = Namespaces::new(&Config::default());
        none.pinned().pin(URL, 2, "urn:a");
        none.run(stop).await;
        std::fs::remove_dir_all(&folder).expect("it was made");
    }
}
