//! Whether the room that the store may take holds what it is to keep, by what the plant sends at most.

use crate::config::{Config, TagConfig, tags};
use crate::store;

/// Bytes of a sample as measured in `docs/store.md`, in the folder and in PostgreSQL.
const SAMPLE_BYTES: [f64; 2] = [3.6, 90.0];
const DAY_S: f64 = 86_400.0;

/// Samples that the configured devices bring (1/s), at most; a broker's are not known before they come.
fn samples_per_s(config: &Config) -> f64 {
    let every_ms = |tag: &TagConfig| match tag {
        TagConfig::Modbus(tag) => {
            config.modbus.iter().find(|own| own.name == tag.device).map(|own| own.poll_ms)
        }
        TagConfig::Opcua(tag) => {
            let server = config.opcua.iter().find(|own| own.name == tag.device);
            tag.sampling_ms.or(server.map(|own| own.sampling_ms))
        }
        TagConfig::Mqtt(_) | TagConfig::Forwarded(_) => None,
    };
    let all = config.loops.iter().flat_map(tags);
    all.filter_map(|(_, tag)| every_ms(tag)).map(|ms| 1000.0 / ms.max(1) as f64).sum()
}

/// What is to be said where `max_mb` cuts `samples_days` short.
pub(super) fn too_little(config: &Config, own: &store::Config) -> Option<String> {
    let bytes = SAMPLE_BYTES[usize::from(own.url.is_some())];
    let mb_a_day = samples_per_s(config) * bytes * DAY_S / 1e6;
    let days = own.max_mb as f64 / mb_a_day;
    (mb_a_day > 0.0 && days < own.samples_days).then(|| {
        format!(
            "[store] max_mb = {} holds about {days:.1} days of samples as fast as they are configured, not samples_days = {}: \
             that takes {:.0} MB; see docs/store.md",
            own.max_mb,
            own.samples_days,
            mb_a_day * own.samples_days
        )
    })
}

impl Config {
    /// What `run` logs where `max_mb` of `[store]` cuts `samples_days` short; `None` where it does not.
    pub fn too_little_room(&self) -> Option<String> {
        too_little(self, self.store.as_ref()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::parse;

    #[test]
    fn a_store_that_is_too_small_for_its_plant_is_told() {
        let plant = |url: &str, max_mb: u64| {
            let mut text = format!("[store]\nfolder = 's'\n{url}max_mb = {max_mb}\n");
            for (name, every) in [("a", 1000), ("b", 500)] {
                text += &format!(
                    "[[modbus]]\nname = '{name}'\naddress = '10.0.0.5:502'\naddress_base = 0\npoll_ms = {every}\n\
                     [[loop]]\nid = '{name}'\n[loop.op]\ndevice = '{name}'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
                     [loop.pv]\ndevice = '{name}'\nregister = 'input'\naddress = 2\ntype = 'f32'\n"
                );
            }
            parse("plant.toml", &text).expect("sound")
        };
        let told = |config: Config| config.too_little_room();
        // Two tags once a second and two twice.
        assert_eq!(samples_per_s(&plant("", 100)), 6.0);
        // 6 of 3.6 bytes are 1.87 MB a day, 56 MB in 30 days.
        assert_eq!(told(plant("", 60)), None);
        let text = told(plant("", 40)).expect("too little");
        assert!(text.contains("about 21.4 days") && text.contains("takes 56 MB"), "{text}");
        // 47 MB a day.
        let url = "url = 'postgres://stictiond@localhost:5432/history'\n";
        assert!(told(plant(url, 1000)).is_some_and(|text| text.contains("about 21.4 days")));
        assert_eq!(told(plant(url, 2000)), None);
    }
}
