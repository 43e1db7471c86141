//! Who one is, as JSON.

use super::super::guard::Actor;
use crate::access::Role;
use serde::{Deserialize, Serialize};
use std::fmt;
use utoipa::ToSchema;

/// Body of a log-in.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LogIn {
    /// The user's name.
    #[schema(max_length = 200)]
    pub user: String,
    /// Their password.
    #[schema(max_length = 1024)]
    pub password: String,
}

impl fmt::Debug for LogIn {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("LogIn(…)")
    }
}

/// Who asks, and what they may do.
#[derive(Debug, Serialize, ToSchema)]
pub struct SessionView {
    /// Whether there is a log-in here at all; without one everybody on this machine may do everything.
    pub log_in: bool,
    /// Whether changes are put on record.
    pub audited: bool,
    /// The user's or token's name.
    pub name: Option<String>,
    /// `session` or `token`.
    pub by: Option<String>,
    /// Their roles.
    pub roles: Vec<&'static str>,
    /// Every role whose work they may do.
    pub may: Vec<&'static str>,
    /// What changes by this session carry as `x-csrf-token`.
    pub csrf: Option<String>,
}

impl SessionView {
    /// As it is for who asks.
    pub fn of(actor: &Actor, audited: bool) -> Self {
        let identity = actor.identity.as_ref();
        Self {
            log_in: !actor.unguarded,
            audited,
            name: identity.map(|identity| identity.name.clone()),
            by: identity.map(|identity| identity.by.to_string()),
            roles: identity
                .into_iter()
                .flat_map(|identity| identity.roles.iter())
                .map(Role::as_str)
                .collect(),
            may: Role::ALL.into_iter().filter(|role| actor.may(*role)).map(Role::as_str).collect(),
            csrf: actor.csrf.clone(),
        }
    }
}
