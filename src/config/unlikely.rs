//! Settings that are allowed and hardly meant: alarms that always or never come, secrets in the clear, folders that hold too much.

use super::remarks::is_near;
use super::{Config, LoopConfig};
use crate::alarm::Kind;
use crate::collect::{modbus, opcua};
use crate::{diagnosis, host};
use std::net::IpAddr;
use std::path::Path;

/// No sticking valve has an f of so much (% of OP span).
const LARGEST_F: f64 = 10.0;
/// Evidence below this is no difference of AIC that anybody chooses; a probability may have been meant.
const LEAST_EVIDENCE: f64 = 1.0;
/// The free run of a model that misses by so many deviations of PV is worse than none.
const WORST_SHARE: f64 = 2.0;
/// No device answers faster over a network of a plant (ms).
const SHORTEST_ANSWER_MS: u64 = 20;
/// A device that is polled faster is told of by that (ms).
const SHORTEST_POLL_MS: u64 = 50;
/// A shorter pause between attempts to connect keeps a dead device's network busy (ms).
const SHORTEST_PAUSE_MS: u64 = 1000;
/// The largest number of a unit on a line; 255 means the device itself.
const LAST_UNIT: u8 = 247;
/// Ports of other protocols, and theirs.
const OTHERS: [(u16, &str); 4] =
    [(102, "Siemens' S7"), (1883, "MQTT"), (4840, "OPC UA"), (44_818, "EtherNet/IP")];

impl Config {
    /// Each with its section and key.
    pub(super) fn unlikely(&self) -> Vec<String> {
        let mut out = Vec::new();
        out.extend(self.thresholds());
        out.extend(self.suppressed());
        out.extend(self.loops.iter().filter_map(set_point));
        out.extend(self.modbus.iter().flat_map(unlikely_device));
        out.extend(self.opcua.iter().filter_map(bare_password));
        out.extend(self.links());
        out.extend(self.folders());
        out
    }

    /// Thresholds that nothing, or everything, passes.
    fn thresholds(&self) -> Vec<String> {
        let mut out = Vec::new();
        let own = &self.diagnosis;
        if own.f_threshold_percent > LARGEST_F {
            out.push(format!(
                "[diagnosis] f_threshold_percent = {}: sticking valves have an f of 0.1 to 5 % of OP's span, so none would be \
                 found",
                own.f_threshold_percent
            ));
        }
        if own.evidence_threshold > 0.0 && own.evidence_threshold < LEAST_EVIDENCE {
            out.push(format!(
                "[diagnosis] evidence_threshold = {}: it is a difference of AIC and no probability; the default is {}",
                own.evidence_threshold,
                diagnosis::Config::default().evidence_threshold
            ));
        }
        let rest = &self.alarm.unexplained_residual;
        if rest.enabled && (rest.share == 0.0 || rest.share > WORST_SHARE) {
            let when = if rest.share == 0.0 { "always" } else { "never" };
            out.push(format!(
                "[alarm.unexplained_residual] share = {}: the alarm is {when} raised; it is a share of PV's deviation, such as 0.8",
                rest.share
            ));
        }
        out
    }

    /// What is said of no loop.
    fn suppressed(&self) -> Vec<String> {
        let all = self.alarm.suppressed.iter().filter_map(|text| text.strip_prefix("*/"));
        let kinds = all.filter_map(Kind::named);
        let serious = kinds
            .filter(|kind| matches!(kind, Kind::Stiction | Kind::CollectorDown | Kind::CompensationTripped));
        let told =
            |kind: Kind| format!("[alarm] suppressed: nobody is told of any {}: \"*/{0}\"", kind.as_str());
        serious.map(told).collect()
    }

    /// Links in messages that lead nowhere.
    fn links(&self) -> Option<String> {
        let url = self.notify.public_url.as_ref()?;
        let uri: hyper::Uri = url.parse().ok()?;
        let (authority, asked) = (uri.authority()?.as_str(), uri.host()?);
        let receivers = self.notify.webhook.len() + self.notify.alertmanager.len() + self.notify.smtp.len();
        if is_near(authority) {
            return (receivers > 0).then(|| {
                format!(
                    "[notify] public_url = {url:?} is the reader's own machine: write the name by which others reach this one"
                )
            });
        }
        let name = |own: &'_ String| own.rsplit_once(':').map_or(own.as_str(), |(name, _)| name).to_string();
        let mut known = self.server.hosts.iter().map(name).chain([host::name()]);
        let is_known = asked.trim_matches(['[', ']']).parse::<IpAddr>().is_ok()
            || known.any(|own| own.eq_ignore_ascii_case(asked));
        // A certificate carries names, too.
        (!is_known && self.server.tls.is_none()).then(|| {
            format!(
                "[notify] public_url = {url:?}: the daemon refuses to be asked by that name: write hosts = [{asked:?}] in [server]"
            )
        })
    }

    /// Folders that do not outlive a restart, or hold what nobody should read.
    fn folders(&self) -> Vec<String> {
        let mut out = Vec::new();
        if let Some(store) = &self.store {
            let gone =
                ["/tmp", "/dev/shm", "/run", "/var/run"].iter().find(|own| store.folder.starts_with(own));
            out.extend(gone.map(|own| {
                format!(
                    "[store] folder = {:?}: {own} is emptied when the machine starts: nothing would outlive it",
                    store.folder.display().to_string()
                )
            }));
        }
        let Some(tables) = &self.tables.folder else { return out };
        let store = self.store.as_ref().map(|own| own.folder.as_path());
        let users = self.access.as_ref().map(|own| own.file.as_path());
        let holds = |path: Option<&Path>| path.is_some_and(|path| path.starts_with(tables));
        let what = match () {
            () if tables == Path::new("/") => Some("the whole machine"),
            () if tables == Path::new("/etc") => Some("what the machine is set up by"),
            () if holds(store) => Some("the store"),
            () if holds(users) => Some("the file of [access]"),
            () => None,
        };
        out.extend(what.map(|what| {
            format!(
                "[tables] folder = {:?} holds {what}, and who may ask for a backfill may name each of its files: give the tables a \
                 folder of their own",
                tables.display().to_string()
            )
        }));
        out
    }
}

/// A set point in another unit than PV's, or in another scale of the same register type.
fn set_point(own: &LoopConfig) -> Option<String> {
    let sp = own.sp.as_ref()?;
    let (of_sp, of_pv) = (sp.unit()?.trim(), own.pv.unit()?.trim());
    let plain = |unit: &str| {
        unit.to_lowercase().replace('³', "3").replace('²', "2").replace("deg", "").replace('°', "")
    };
    if plain(of_sp) != plain(of_pv) {
        return Some(format!(
            "{}: sp is in {of_sp:?} and pv in {of_pv:?}: their difference means nothing",
            own.id
        ));
    }
    let (sp, pv) = (sp.as_modbus()?, own.pv.as_modbus()?);
    let same = sp.effective_type() == pv.effective_type() && sp.device == pv.device;
    (same && (sp.scale, sp.offset) != (pv.scale, pv.offset)).then(|| {
        format!(
            "{}: sp and pv are in {of_pv:?} and of one type, and sp has scale = {} and offset = {}, pv {} and {}",
            own.id, sp.scale, sp.offset, pv.scale, pv.offset
        )
    })
}

/// Times, units and ports of a Modbus device that hardly are its.
fn unlikely_device(own: &modbus::Config) -> Vec<String> {
    let mut out = Vec::new();
    let name = &own.name;
    if own.timeout_ms < SHORTEST_ANSWER_MS && own.poll_ms >= SHORTEST_POLL_MS {
        out.push(format!(
            "{name}: timeout_ms = {} is in milliseconds: hardly any device answers so fast",
            own.timeout_ms
        ));
    }
    if own.reconnect_max_ms < SHORTEST_PAUSE_MS {
        out.push(format!(
            "{name}: reconnect_max_ms = {} is in milliseconds: a device that is off would be called every {0} ms",
            own.reconnect_max_ms
        ));
    }
    if (LAST_UNIT + 1..u8::MAX).contains(&own.unit_id) {
        out.push(format!("{name}: unit_id = {}: units have numbers up to {LAST_UNIT}", own.unit_id));
    }
    let port = own.address.rsplit_once(':').and_then(|(_, port)| port.parse::<u16>().ok());
    let other = OTHERS.iter().find(|(other, _)| Some(*other) == port);
    out.extend(
        other.map(|(port, what)| format!("{name}: {port} is the port of {what}: that of Modbus is 502")),
    );
    out
}

/// A log-in at an OPC UA server without encryption of its own: the server may ask for the password encrypted.
fn bare_password(own: &opcua::Config) -> Option<String> {
    let far = !is_near(own.url.strip_prefix("opc.tcp://").unwrap_or(&own.url));
    let bare = own.security_policy == opcua::SecurityPolicy::None && own.user.is_some();
    (bare && far).then(|| {
        format!(
            "{}: security_policy = \"None\" leaves it to {} whether the password is encrypted on its way",
            own.name, own.url
        )
    })
}

#[cfg(test)]
mod tests {
    use crate::config::parse;

    const DEVICE: &str = "[[modbus]]\nname = 'd'\naddress = 'plc1:502'\naddress_base = 0\n";
    const LOOP: &str = "[[loop]]\nid = 'A'\n[loop.op]\ndevice = 'd'\nregister = 'holding'\naddress = 0\ntype = 'f32'\n\
        [loop.pv]\ndevice = 'd'\nregister = 'holding'\naddress = 2\ntype = 'f32'\nunit = 'bar'\n";

    fn remarks(text: &str) -> Vec<String> {
        parse("f", text).unwrap_or_else(|errors| panic!("{text}\n{errors:?}")).remarks()
    }

    #[test]
    fn what_is_hardly_meant_is_remarked_and_what_is_usual_is_not() {
        let mail =
            "[[notify.smtp]]\nname = 'm'\naddress = 'mail.plant:587'\nfrom = 'a@b.c'\nto = ['d@e.f']\n";
        let linked = |url: &str| format!("[notify]\npublic_url = '{url}'\n{mail}");
        for (section, said) in [
            ("[diagnosis]\nf_threshold_percent = 50.0\n".to_string(), "f_threshold_percent = 50"),
            ("[diagnosis]\nevidence_threshold = 0.95\n".into(), "no probability; the default is"),
            ("[alarm.unexplained_residual]\nshare = 0.0\n".into(), "the alarm is always raised"),
            ("[alarm.unexplained_residual]\nshare = 8.0\n".into(), "the alarm is never raised"),
            (
                "[alarm]\nsuppressed = ['*/stiction']\n".into(),
                "nobody is told of any stiction: \"*/stiction\"",
            ),
            (linked("http://127.0.0.1:8080"), "is the reader's own machine"),
            (linked("http://stiction.plant.example:8080"), "write hosts = [\"stiction.plant.example\"]"),
            ("[store]\nfolder = '/tmp/st'\n".into(), "/tmp is emptied when the machine starts"),
            ("[tables]\nfolder = '/etc'\n".into(), "what the machine is set up by"),
            ("[store]\nfolder = '/x/y/store'\n[tables]\nfolder = '/x/y'\n".into(), "holds the store"),
            ("[notify.mqtt]\naddress = 'broker:8883'\n".into(), "8883 is the port of brokers that speak TLS"),
        ] {
            let found = remarks(&format!("{section}{DEVICE}{LOOP}"));
            assert!(found.len() == 1 && found[0].contains(said), "{section}: {found:#?}");
        }
        for section in [
            "[diagnosis]\nevidence_threshold = 0.0\n",
            "[alarm]\nsuppressed = ['A/stiction', '*/f_rising']\n",
            "[notify]\npublic_url = 'http://10.1.2.3:8080'\n",
            "[notify]\npublic_url = 'http://[fd00::5]'\n",
            "[server]\nhosts = ['stiction.plant:8080']\n[notify]\npublic_url = 'http://stiction.plant'\n",
            "[store]\nfolder = '/var/lib/stictiond'\n[tables]\nfolder = '/srv/tables'\n",
        ] {
            let found = remarks(&format!("{section}{DEVICE}{LOOP}"));
            assert!(found.is_empty(), "{section}: {found:#?}");
        }
    }

    #[test]
    fn a_device_and_a_set_point_that_hardly_fit_are_remarked() {
        for (own, said) in [
            ("timeout_ms = 5\n", "d: timeout_ms = 5 is in milliseconds"),
            ("reconnect_max_ms = 30\n", "would be called every 30 ms"),
            ("unit_id = 248\n", "units have numbers up to 247"),
        ] {
            let found = remarks(&format!("{DEVICE}{own}{LOOP}"));
            assert!(found.len() == 1 && found[0].contains(said), "{own}: {found:#?}");
        }
        let found = remarks(&format!("{}{LOOP}", DEVICE.replace(":502", ":4840")));
        assert!(found.len() == 1 && found[0].contains("4840 is the port of OPC UA"), "{found:#?}");
        let sp = |more: &str| {
            format!(
                "{DEVICE}{LOOP}[loop.sp]\ndevice = 'd'\nregister = 'holding'\naddress = 4\ntype = 'f32'\n{more}"
            )
        };
        assert!(remarks(&sp("unit = 'mbar'\n"))[0].contains("sp is in \"mbar\" and pv in \"bar\""));
        assert!(remarks(&sp("unit = 'bar'\nscale = 10.0\n"))[0].contains("sp has scale = 10"));
        assert_eq!(remarks(&sp("unit = 'bar'\n")), [""; 0]);
    }
}
