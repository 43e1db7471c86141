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
        if let Some(why) = self.public_url.as_deref().and_then(wrong_url) {
            wrong.push(("public_url", why.to_string()));
        }
        wrong
    }
}

/// What is wrong with an address that links begin with. It may hold a password, so it is never quoted.
fn wrong_url(url: &str) -> Option<&'static str> {
    let rest = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"));
    let Some(rest) = rest.filter(|rest| !rest.is_empty() && url.parse::<hyper::Uri>().is_ok()) else {
        return Some("write an address that begins with http:// or https://");
    };
    let authority = rest.split(['/', '?', '#']).next().unwrap_or_default();
    if authority.contains('@') {
        return Some("must not hold a user or a password: it stands in every message");
    }
    rest.contains(['?', '#']).then_some("must end before ? or #: links go on from it with /#/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_begin_with_an_address_that_holds_no_password() {
        let wrong = |url: &str| {
            let own = Config { public_url: Some(url.to_string()), ..Config::default() };
            own.validate().pop().map(|(field, why)| format!("{field}: {why}"))
        };
        for good in ["https://plant", "http://plant:8080/valves/", "https://plant/@home"] {
            assert_eq!(wrong(good), None, "{good}");
        }
        for (bad, why) in [
            ("plant", "begins with http:// or https://"),
            ("https://", "begins with http:// or https://"),
            ("https://op:secret@plant/", "must not hold a user or a password"),
            ("https://op@plant", "must not hold a user or a password"),
            ("https://plant/?key=secret", "must end before ? or #"),
            ("https://plant/#/alarms", "must end before ? or #"),
        ] {
            let told = wrong(bad).unwrap();
            assert!(
                told.starts_with("public_url: ") && told.contains(why) && !told.contains("secret"),
                "{told}"
            );
        }
    }
}
