//! Why the daemon does not run, each with what helps.

use crate::access::FileError;
use crate::audit::AuditError;
use crate::collect::Issue;
use crate::config::Diagnostic;
use crate::serve::{ServeError, TlsError};
use std::io;
use std::net::SocketAddr;

/// Why the daemon does not run.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// The configuration cannot be used; everything wrong with it.
    #[error("{}", lines(.0))]
    Config(Vec<Diagnostic>),
    /// A device cannot be polled as configured.
    #[error("{}", .0.iter().map(|issue| format!("{}: {}", issue.field, issue.message)).collect::<Vec<_>>().join("\n"))]
    Plan(Vec<Issue>),
    /// The address is taken, or not this machine's.
    #[error("cannot listen on {address}: {source}{}", hint(source))]
    Bind {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// Write-back, or what people change, cannot be put on record.
    #[error(transparent)]
    Audit(#[from] AuditError),
    /// Users and tokens cannot be read.
    #[error("[access] file: {0}")]
    Access(#[from] FileError),
    /// There are no certificates.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// This machine cannot take its part in the fleet.
    #[error("{0}")]
    Fleet(String),
    /// The API failed.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// Signals cannot be received.
    #[error("cannot listen to signals: {0}")]
    Signal(io::Error),
}

fn hint(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::AddrInUse => {
            "; another program, perhaps another stictiond, listens there: choose another port"
        }
        _ => "",
    }
}

fn lines(diagnostics: &[Diagnostic]) -> String {
    diagnostics.iter().map(Diagnostic::to_string).collect::<Vec<_>>().join("\n")
}
