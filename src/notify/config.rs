//! What the configuration file says about telling others.

use super::mqtt;
use serde::Deserialize;

/// `[notify]`: every part is off where it is left out.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// `[notify.mqtt]`.
    #[serde(default)]
    pub mqtt: Option<mqtt::Config>,
}
