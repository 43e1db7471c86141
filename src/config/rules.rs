//! What no single field can be wrong about: ranges, names that refer to each other, registers that contradict.

use super::diagnostic::Report;
use super::section::{Parts, ROLES};
use super::source::{Source, Step, texts, variable};
use super::wording::close;
use super::{LoopConfig, TagConfig, plant, tag};
use crate::collect::{Issue, modbus};
use crate::schedule;
use crate::signal::{Role, Scale};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Longest name of a loop, device or tag (characters).
const MAX_NAME: usize = 100;

/// A path into the file.
macro_rules! path {
    ($($step:expr),+) => { [$(Step::from($step)),+] };
}

mod candidates;
mod clients;
mod door;
mod plantwide;
mod ports;
mod sampling;
mod telling;
mod writing;

/// Checks everything that could be read.
pub fn check(source: &Source, parts: &Parts, report: &mut Report) {
    let mut devices = HashMap::new();
    let modbus = (0..parts.modbus.len()).map(|at| ("modbus", at, Device::Modbus(at)));
    let opcua = (0..parts.opcua.len()).map(|at| ("opcua", at, Device::Opcua));
    let mqtt = (0..parts.mqtt.len()).map(|at| ("mqtt", at, Device::Mqtt(at)));
    for (section, at, device) in modbus.chain(opcua).chain(mqtt) {
        if let Some(name) = source.text(&path![section, at, "name"]) {
            devices.entry(name).or_insert(device);
        }
    }
    let blamed = report.places();
    let mut rules = Rules { source, report, devices, blamed, unknown: BTreeMap::new() };
    rules.variables();
    rules.ports();
    rules.sections(parts);
    rules.devices(parts);
    rules.clients(parts);
    rules.loops(parts);
    rules.unknown_devices();
    rules.registers(parts);
    rules.writing(parts);
}

/// Which section of its kind a device is.
#[derive(Clone, Copy)]
enum Device {
    Modbus(usize),
    Opcua,
    Mqtt(usize),
}

impl Device {
    /// What it is, and how a tag of its says where it is found.
    fn wants(self) -> (&'static str, &'static str) {
        match self {
            Device::Modbus(_) => ("a Modbus device", "register and address"),
            Device::Opcua => ("an OPC UA server", "node or path"),
            Device::Mqtt(_) => ("an MQTT broker", "topic, or sparkplug and metric"),
        }
    }
}

struct Rules<'r, 'a, 't> {
    source: &'r Source<'a>,
    report: &'r mut Report<'t>,
    /// Positions of the devices by name, also of those that could not be read: what is wrong with a device is no
    /// fault of its tags.
    devices: HashMap<&'r str, Device>,
    /// Values that could not be read: what stands in for them is not the file's fault.
    blamed: HashSet<usize>,
    /// Names of devices that there are not, with the tags that name them.
    unknown: BTreeMap<String, Vec<Vec<Step>>>,
}

impl Rules<'_, '_, '_> {
    fn wrong(&mut self, path: &[Step], message: String) {
        let (place, message) = match self.beside(path, &message) {
            Some((place, key)) => (place, left_out(key, message)),
            None => (self.source.place(path), message),
        };
        if !self.blamed.contains(&place) && !self.misspelt(path) {
            self.report.at(place, message);
        }
    }

    /// The place of a key in the file that a message names beside one which is not in it, and the latter.
    fn beside<'p>(&self, path: &'p [Step], message: &str) -> Option<(usize, &'p str)> {
        let (Step::Key(key), table) = path.split_last()? else { return None };
        let is_default = !self.source.has(path) && message.starts_with(&format!("{key}: "));
        let words: Vec<&str> = message.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
        let mut keys = self.source.keys(table).into_iter();
        let named = keys.find(|(own, _)| own != key && own.contains('_') && words.contains(own));
        named.filter(|_| is_default).map(|(_, place)| (place, key.as_str()))
    }

    /// Whether a key is not there because it is misspelt, which was told.
    fn misspelt(&self, path: &[Step]) -> bool {
        let Some((Step::Key(key), table)) = path.split_last() else { return false };
        let close = |(own, place): (&str, usize)| self.blamed.contains(&place) && close(own, key);
        !self.source.has(path) && self.source.keys(table).into_iter().any(close)
    }

    fn unless(&mut self, ok: bool, path: &[Step], message: impl FnOnce() -> String) {
        if !ok {
            self.wrong(path, message());
        }
    }

    fn section(&mut self, section: &str, issues: Option<Vec<(&'static str, String)>>) {
        for (field, message) in issues.into_iter().flatten() {
            self.wrong(&path![section, field], format!("{field}: {message}"));
        }
    }

    /// Variables are not filled in, so that a text which waits for one would be taken as it is.
    fn variables(&mut self) {
        let mut found = Vec::new();
        for value in self.source.root().values() {
            texts(value, &mut |place, text| found.extend(variable(text).map(|name| (place, name))));
        }
        for (place, name) in found {
            self.blamed.insert(place);
            let message = format!(
                "variables are not filled in, ${{{name}}} neither: write the value itself, and of a password the name of \
                 the variable in its password_env"
            );
            self.report.at(place, message);
        }
    }

    fn sections(&mut self, parts: &Parts) {
        self.section("server", parts.server.as_ref().map(|c| c.validate()));
        self.door(parts);
        self.section("history", parts.history.as_ref().map(|c| c.validate()));
        self.section("store", parts.store.as_ref().and_then(|c| c.as_ref()).map(|c| c.validate()));
        for (field, message) in parts.tables.as_ref().map(|c| c.validate()).into_iter().flatten() {
            self.wrong(&path!["tables", "defaults", field], message);
        }
        self.section("schedule", parts.schedule.as_ref().map(|c| c.validate()));
        self.section("diagnosis", parts.diagnosis.as_ref().map(|c| c.validate()));
        let alarm = parts.alarm.as_ref().map(|c| c.validate()).into_iter().flatten();
        for (table, field, message) in alarm.filter(|(_, field, _)| *field != "suppressed") {
            let message = format!("{field}: {message}");
            match table {
                "" => self.wrong(&path!["alarm", field], message),
                table => self.wrong(&path!["alarm", table, field], message),
            }
        }
        self.suppressed(parts);
        self.ignored(parts);
        self.clearing(parts);
        self.section("plantwide", parts.plantwide.as_ref().map(|c| c.validate()));
        self.section("fleet", parts.fleet.as_ref().and_then(|c| c.as_ref()).map(|c| c.validate()));
        self.section("writeback", parts.writeback.as_ref().map(|c| c.validate()));
        self.notify(parts);
        self.history(parts);
    }

    fn devices(&mut self, parts: &Parts) {
        let mut seen = HashMap::new();
        let modbus = parts.modbus.iter().map(|device| device.as_ref().map(|device| device.validate()));
        let opcua = parts.opcua.iter().map(|server| server.as_ref().map(|server| server.validate()));
        let modbus = modbus.enumerate().map(|(at, issues)| ("modbus", at, issues));
        let opcua = opcua.enumerate().map(|(at, issues)| ("opcua", at, issues));
        let mqtt = parts.mqtt.iter().map(|broker| broker.as_ref().map(|broker| broker.validate()));
        let mqtt = mqtt.enumerate().map(|(at, issues)| ("mqtt", at, issues));
        for (section, at, issues) in modbus.chain(opcua).chain(mqtt) {
            let here = path![section, at, "name"];
            if let Some(name) = self.source.text(&here) {
                if !name.is_empty() {
                    self.name(name, &here, "name");
                }
                self.first(&mut seen, name, &here, "device");
            }
            // What follows from the policy cannot be judged where the policy could not be read.
            let unread = self.blamed.contains(&self.source.place(&path![section, at, "security_policy"]));
            let follows = |issue: &Issue| unread && ["pki_dir", "security_mode"].contains(&issue.field);
            for issue in issues.into_iter().flatten().filter(|issue| !follows(issue)) {
                let message = format!("{}: {}", issue.field, issue.message);
                self.wrong(&path![section, at, issue.field], message);
            }
        }
    }

    /// Whether a device has no name that tags could refer to.
    fn some_are_nameless(&self, parts: &Parts) -> bool {
        let all = [("modbus", parts.modbus.len()), ("opcua", parts.opcua.len()), ("mqtt", parts.mqtt.len())];
        let nameless = |section: &str, at: usize| !self.source.has(&path![section, at, "name"]);
        all.into_iter().any(|(section, count)| (0..count).any(|at| nameless(section, at)))
    }

    /// Refuses a name that was seen before.
    fn first<'n>(&mut self, seen: &mut HashMap<&'n str, usize>, name: &'n str, path: &[Step], what: &str) {
        let line = self.report.line(self.source.place(path));
        if let Some(first) = seen.get(name) {
            let message =
                format!("{what} {name:?} is already on line {first}; every {what} needs a name of its own");
            self.wrong(path, message);
        } else {
            seen.insert(name, line);
        }
    }

    fn loops(&mut self, parts: &Parts) {
        let misspelt = self.source.root().keys().any(|key| close(key.get_ref(), "loop"));
        let none = self.source.root().get("loop").is_none() && !misspelt;
        let site = path!["fleet", "site"];
        if none && self.source.has(&site) {
            let message = "site: only an edge has one, and an edge needs a [[loop]]; for a worker or a centre, take site \
                           out";
            self.wrong(&site, message.into());
        } else if none && !self.of_fleet() {
            self.report.at(0, "no [[loop]]: name at least one control loop to watch".into());
        }
        let mut seen = HashMap::new();
        for (at, control_loop) in parts.loops.iter().enumerate() {
            let here = path!["loop", at, "id"];
            if let Some(id) = self.source.text(&here) {
                self.name(id, &here, "id");
                self.first(&mut seen, id, &here, "loop");
            }
            if let Some(control_loop) = control_loop {
                self.numbers(at, control_loop);
                self.frozen(at, control_loop, parts);
                self.tags(at, control_loop, parts);
                self.candidates(at, control_loop, parts);
                self.upstream(at, control_loop, parts);
                self.cost(at, control_loop, parts);
            }
        }
    }

    /// A worker and a centre have no loops of their own, and belong to no site.
    fn of_fleet(&self) -> bool {
        let is_edge = self.source.has(&path!["fleet", "site"]) && self.source.has(&path!["loop"]);
        self.source.has(&path!["fleet"]) && !is_edge
    }

    /// Names stand in addresses of the API and in labels of metrics.
    fn name(&mut self, name: &str, path: &[Step], field: &str) {
        let fits = (1..=MAX_NAME).contains(&name.chars().count());
        let plain = !name.contains(|c: char| c.is_control() || "/\\?#%\"".contains(c));
        let ok = fits && plain && name.trim() == name && name != "." && name != "..";
        self.unless(ok, path, || {
            format!(
                "{field}: {name:?} must be 1 to {MAX_NAME} characters, none of them / \\ ? # % \" or control, \
                 no blanks around it"
            )
        });
    }

    fn numbers(&mut self, at: usize, control_loop: &LoopConfig) {
        if let Some(period_s) = control_loop.period_s {
            let own = schedule::Config { period_s, ..schedule::Config::default() };
            for (_, message) in own.validate().into_iter().filter(|(field, _)| *field == "period_s") {
                self.wrong(&path!["loop", at, "period_s"], format!("period_s: {message}"));
            }
        }
        let positive = [("op_span", control_loop.op_span), ("frozen_pv_s", control_loop.frozen_pv_s)];
        for (field, value) in positive {
            let ok = value.is_none_or(|value| value.is_finite() && value > 0.0);
            self.unless(ok, &path!["loop", at, field], || {
                format!("{field}: {} must be a number above 0", value.unwrap_or_default())
            });
        }
        if let Some([low, high]) = control_loop.op_limits {
            let ok = low.is_finite() && high.is_finite() && low < high;
            self.unless(ok, &path!["loop", at, "op_limits"], || {
                format!("op_limits: [{low}, {high}] must be the lower, then the upper limit")
            });
        }
        let limits = control_loop.op_limits.map(|[low, high]| (low, high));
        let scale = Scale { given: control_loop.op_span, limits, unit: control_loop.op.unit() };
        if let Some(why) = scale.contradiction(&[]) {
            let key = if scale.given.is_some() { "op_span" } else { "op_limits" };
            self.wrong(&path!["loop", at, key], why);
        }
    }

    fn tags(&mut self, at: usize, control_loop: &LoopConfig, parts: &Parts) {
        let mut seen = HashMap::new();
        let tags: Vec<_> = plant::tags(control_loop).collect();
        for (tag_at, (role, tag)) in tags.iter().enumerate() {
            let here = tag_path(at, tag_at, &tags);
            let field = |name: &str| [&here[..], &path![name]].concat();
            match (role, tag.name()) {
                (Some(role), Some(_)) => {
                    let role = role.as_str();
                    self.wrong(&field("name"), format!("name: only a [[loop.tag]] has one, this is {role}"));
                }
                (None, None) => self.wrong(&here, "missing key \"name\" in [[loop.tag]]".into()),
                (None, Some(name)) => {
                    self.name(name, &field("name"), "name");
                    let taken = ROLES.contains(&name);
                    self.unless(!taken, &field("name"), || {
                        format!("name: write it as [loop.{name}], or give the tag another name")
                    });
                    let kept = name == Role::Term.as_str();
                    self.unless(!kept, &field("name"), || {
                        format!("name: {name} is what write-back adds to OP, give the tag another name")
                    });
                    self.first(&mut seen, name, &field("name"), "tag");
                }
                (Some(_), None) => {}
            }
            self.tag(*role, tag, &here, parts);
            let same = tags[..tag_at]
                .iter()
                .find(|(other, earlier)| other.is_some() && earlier.source() == tag.source());
            if let (Some(role), Some((Some(other), _))) = (role, same) {
                let (role, other) = (role.as_str(), other.as_str());
                let key = tag.place_key();
                let what = if key == "address" { "register" } else { "node" };
                self.wrong(&field(key), format!("{key}: {role} reads the same {what} as {other}"));
            }
        }
    }

    fn tag(&mut self, role: Option<Role>, tag: &TagConfig, here: &[Step], parts: &Parts) {
        let field = |name: &str| [here, &path![name]].concat();
        let Some(&device) = self.devices.get(tag.device()) else {
            // Their section was not understood, or has no name, which is told there.
            if self.devices.is_empty() && self.report.has_section_errors() || self.some_are_nameless(parts) {
                return;
            }
            let place = field("device");
            if !self.blamed.contains(&self.source.place(&place)) && !self.misspelt(&place) {
                self.unknown.entry(tag.device().into()).or_default().push(place);
            }
            return;
        };
        let strange = |keys: &[&'static str], message: &str| {
            let set = keys.iter().filter(|key| self.source.has(&field(key)));
            set.map(|key| Issue { field: key, message: message.into() }).collect::<Vec<_>>()
        };
        let issues = match (device, tag) {
            (Device::Modbus(at), TagConfig::Modbus(tag)) => {
                let keys = [&tag::OPCUA_KEYS[..], &tag::MQTT_KEYS, &tag::TEXT_KEYS].concat();
                let own = parts.modbus[at].as_ref().map(|device| tag.validate(device, role));
                [strange(&keys, "a tag with a register has none"), own.unwrap_or_default()].concat()
            }
            (Device::Opcua, TagConfig::Opcua(tag)) => {
                let keys = [&tag::MODBUS_KEYS[..], &tag::MQTT_KEYS].concat();
                [strange(&keys, "a tag with a node has none"), tag.validate(role)].concat()
            }
            (Device::Mqtt(at), TagConfig::Mqtt(tag)) => {
                let keys = [&tag::MODBUS_KEYS[..], &tag::OPCUA_KEYS, &["node"]].concat();
                let own = parts.mqtt[at].as_ref().map(|broker| tag.validate(broker, role));
                [strange(&keys, "a tag at a broker has none"), own.unwrap_or_default()].concat()
            }
            (Device::Modbus(_), TagConfig::Opcua(own)) if own.node.is_none() && own.path.is_none() => {
                for key in ["register", "address"] {
                    let section = super::wording::section(here);
                    self.wrong(here, format!("missing key {key:?} in {section}"));
                }
                return;
            }
            (device, _) => {
                let (what, how) = device.wants();
                let key = match tag.as_modbus() {
                    Some(_) => "register",
                    None => tag.place_key(),
                };
                let message = format!("{:?} is {what}: write {how}", tag.device());
                vec![Issue { field: key, message }]
            }
        };
        for issue in issues {
            self.wrong(&field(issue.field), format!("{}: {}", issue.field, issue.message));
        }
    }

    /// Unknown devices: each is told once, at its first tag, with the number of the others.
    fn unknown_devices(&mut self) {
        let mut names: Vec<&str> = self.devices.keys().copied().collect();
        names.sort_unstable();
        for (device, places) in std::mem::take(&mut self.unknown) {
            let Some((first, others)) = places.split_first() else { continue };
            let hint = match names.is_empty() {
                true => {
                    format!(": write the section of the device, such as [[modbus]] with name = {device:?}")
                }
                false => super::wording::hint(&device, &names),
            };
            let others = match others.len() {
                0 => String::new(),
                1 => " (1 more tag names it)".into(),
                more => format!(" ({more} more tags name it)"),
            };
            let message =
                format!("device: no [[modbus]], [[opcua]] or [[mqtt]] is called {device:?}{hint}{others}");
            self.wrong(first, message);
        }
    }

    /// Registers read as two different things, over all loops of a device.
    fn registers(&mut self, parts: &Parts) {
        let mut by_device: HashMap<&str, (Vec<Vec<Step>>, Vec<&modbus::TagConfig>)> = HashMap::new();
        for (at, control_loop) in parts.loops.iter().enumerate() {
            let tags: Vec<_> = control_loop.iter().flat_map(plant::tags).collect();
            for (tag_at, (_, tag)) in tags.iter().enumerate() {
                let Some(tag) = tag.as_modbus() else { continue };
                let (places, configs) = by_device.entry(&tag.device).or_default();
                places.push([&tag_path(at, tag_at, &tags)[..], &path!["address"]].concat());
                configs.push(tag);
            }
        }
        for device in parts.modbus.iter().flatten() {
            let Some((places, configs)) = by_device.remove(device.name.as_str()) else {
                continue;
            };
            for pair in modbus::contradictions(device, &configs) {
                let first = self.report.line(self.source.place(&places[pair.first]));
                let message = format!("address: {} (the other is on line {first})", pair.message);
                self.wrong(&places[pair.second], message);
            }
        }
    }
}

/// What is said of a key that is not in the file: where a number is wrong, it is the default.
fn left_out(key: &str, message: String) -> String {
    let own = message.strip_prefix(key).and_then(|rest| rest.strip_prefix(": "));
    match own.filter(|own| own.starts_with(|c: char| c.is_ascii_digit())) {
        Some(own) => format!("{key} is left out, and its default {own}: write {key} too"),
        None => message,
    }
}

/// The path of the `tag_at`-th of a loop's tags.
fn tag_path(at: usize, tag_at: usize, tags: &[(Option<Role>, &TagConfig)]) -> Vec<Step> {
    let roles = tags.iter().filter(|(role, _)| role.is_some()).count();
    match tags[tag_at].0 {
        Some(role) => path!["loop", at, role.as_str()].to_vec(),
        None => path!["loop", at, "tag", tag_at - roles].to_vec(),
    }
}
