//! `[notify]` as a whole, of the parts that each receiver has beside itself. Nothing else in this folder knows it.

use super::{alertmanager, mqtt, smtp, webhook};
use serde::Deserialize;

/// `[notify]`: every part is off where it is left out.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the plant, where a receiver hears of several.
    #[serde(default)]
    pub site: Option<String>,
    /// Where people reach the dashboard, for links.
    #[serde(default)]
    pub public_url: Option<String>,
    /// `[notify.mqtt]`.
    #[serde(default)]
    pub mqtt: Option<mqtt::Config>,
    /// `[[notify.webhook]]`.
    #[serde(default)]
    pub webhook: Vec<webhook::Config>,
    /// `[[notify.alertmanager]]`.
    #[serde(default)]
    pub alertmanager: Vec<alertmanager::Config>,
    /// `[[notify.smtp]]`.
    #[serde(default)]
    pub smtp: Vec<smtp::Config>,
}

impl Config {
    /// Everything wrong with `[notify]` itself, by field; its parts are asked each for itself.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let plain =
            |text: &str| (1..=100).contains(&text.chars().count()) && !text.contains(char::is_control);
        if self.site.as_ref().is_some_and(|site| !plain(site)) {
            wrong.push(("site", "must be 1 to 100 characters".to_string()));
        }
        let is_url = |url: &String| {
            let rest = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"));
            rest.is_some_and(|rest| !rest.is_empty()) && url.parse::<hyper::Uri>().is_ok()
        };
        if let Some(url) = self.public_url.as_ref().filter(|url| !is_url(url)) {
            wrong.push((
                "public_url",
                format!("{url:?} is not an address that begins with http:// or https://"),
            ));
        }
        wrong
    }
}
