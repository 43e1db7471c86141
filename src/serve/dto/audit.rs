//! The audit log as JSON.

use crate::audit::{Line, Page};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::{IntoParams, ToSchema};

/// Query of the audit log.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct AuditQuery {
    /// Entries a page; default 100.
    #[param(minimum = 1, maximum = 1000)]
    pub limit: Option<usize>,
    /// Only entries with a smaller number: `next` of the page before.
    pub before: Option<u64>,
}

/// A page of the audit log, newest first.
#[derive(Debug, Serialize, ToSchema)]
pub struct AuditList {
    /// The entries.
    pub items: Vec<AuditItem>,
    /// `before` of the next page; null on the last.
    pub next: Option<u64>,
}

/// An entry.
#[derive(Debug, Serialize, ToSchema)]
pub struct AuditItem {
    /// Number, from 1.
    pub n: u64,
    /// When.
    pub time: String,
    /// What kind: `change`, `refused`, `log_in`, `log_in_failed`, `log_out`, and those of write-back.
    pub event: String,
    /// Who, from where, what, and the result, by name.
    pub fields: BTreeMap<String, String>,
    /// SHA-256 over the hash before and this entry.
    pub hash: String,
}

impl From<Page> for AuditList {
    fn from(page: Page) -> Self {
        Self { items: page.lines.into_iter().map(AuditItem::from).collect(), next: page.next }
    }
}

impl From<Line> for AuditItem {
    fn from(line: Line) -> Self {
        let Line { n, at, event, fields, hash } = line;
        Self { n, time: at, event, fields: fields.into_iter().collect(), hash }
    }
}
