//! The daemon as a process: its file, its signals, its end.

use super::{App, AppError, Role, Surroundings};
use crate::config::{self, Config};
use crate::schedule::Clock;
use std::path::Path;
use tokio::net::TcpListener;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// Listens where the configuration says.
///
/// # Errors
/// [`AppError::Bind`].
pub async fn listen(config: &Config) -> Result<TcpListener, AppError> {
    let address = config.server.listen;
    TcpListener::bind(address).await.map_err(|source| AppError::Bind { address, source })
}

/// The daemon as a command: loads the file, runs until SIGTERM or SIGINT, reloads the file on SIGHUP. A file that
/// cannot be used is refused at a reload, everything wrong with it in the log, and the old one stays in force.
///
/// # Errors
/// [`AppError`], when it cannot start or the API fails.
pub async fn daemon(path: &Path, role: Role) -> Result<(), AppError> {
    // Before anything that takes time: a SIGHUP that nobody listens to ends the process.
    let on = |kind| signal(kind).map_err(AppError::Signal);
    let (hup, term, int) =
        (on(SignalKind::hangup())?, on(SignalKind::terminate())?, on(SignalKind::interrupt())?);
    let config = config::load(path).map_err(AppError::Config)?;
    let listener = listen(&config).await?;
    let around = Surroundings::of_machine(Clock::wall());
    let app = App::build_as(role, around, config, App::diagnosis())?;
    if let Ok(address) = listener.local_addr() {
        tracing::info!(%address, "serving");
    }
    let (ran, ()) = tokio::join!(app.run(listener), obey(&app, path, hup, term, int, app.stop()));
    ran
}

async fn obey(
    app: &App,
    path: &Path,
    mut hup: Signal,
    mut term: Signal,
    mut int: Signal,
    stop: CancellationToken,
) {
    loop {
        tokio::select! {
            () = stop.cancelled() => return,
            _ = term.recv() => break,
            _ = int.recv() => break,
            _ = hup.recv() => {
                let told = async {
                    tokio::select! {
                        _ = term.recv() => {}
                        _ = int.recv() => {}
                    }
                };
                finish(reload(app, path), told, &stop).await;
            }
        }
    }
    end(&stop);
}

fn end(stop: &CancellationToken) {
    tracing::info!("stopping");
    stop.cancel();
}

/// Lets a reload come to its end: what it has taken apart nobody else puts together. A daemon that is told to stop meanwhile does
/// so at once, since a reload waits for terms that go to zero.
async fn finish(
    reloading: impl Future<Output = ()>,
    told: impl Future<Output = ()>,
    stop: &CancellationToken,
) {
    tokio::pin!(reloading);
    tokio::select! {
        biased;
        () = &mut reloading => return,
        () = told => {}
    }
    end(stop);
    reloading.await;
}

async fn reload(app: &App, path: &Path) {
    let loaded = config::load(path).map_err(AppError::Config);
    let taken = match loaded {
        Ok(config) => app.reload(config).await,
        Err(error) => Err(error),
    };
    if let Err(error) = taken {
        // One entry for each error: an entry of many lines is hard to find and harder to parse.
        for error in error.to_string().lines() {
            tracing::error!(error, "the configuration is refused, the old one stays in force");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;
    use tokio::sync::oneshot;

    #[test]
    fn a_daemon_that_is_told_to_stop_in_a_reload_stops_and_ends_the_reload() {
        let stop = CancellationToken::new();
        let ((ended, reloading), (tell, told)) = (oneshot::channel::<()>(), oneshot::channel::<()>());
        let finishing = finish(reloading.map(drop), told.map(drop), &stop);
        let mut finishing = Box::pin(finishing);
        assert!((&mut finishing).now_or_never().is_none() && !stop.is_cancelled());
        tell.send(()).expect("it listens");
        assert!((&mut finishing).now_or_never().is_none() && stop.is_cancelled(), "it stops at once");
        ended.send(()).expect("it waits");
        assert!((&mut finishing).now_or_never().is_some(), "and not before the reload is whole");
    }

    #[test]
    fn a_reload_that_ends_by_itself_stops_nothing() {
        let stop = CancellationToken::new();
        let done = finish(std::future::ready(()), std::future::pending(), &stop);
        assert!(done.now_or_never().is_some() && !stop.is_cancelled());
    }
}
