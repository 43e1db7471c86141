//! Where the plant's loops lie in its four devices: the register map, the values in it, and the configuration that
//! reads them. The encoding here is written from the protocol, not from the collector, so that one checks the other.

use super::dcs;
use crate::collect::modbus::{ByteOrder, Register, ValueType};
use crate::sim::{Class, DemoLoop, Point};
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;

/// First address of the first loop, counted from 0.
const FIRST: u16 = 100;
/// Addresses beyond the last loop that still answer, with 0.
const SPARE: u16 = 20;

/// How a device tells whether a loop is in automatic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ModeAs {
    /// A word after the set point: 1 automatic, 0 manual.
    Word,
    /// Bit 3 of a status word after the set point.
    StatusBit,
    /// A bit of another table.
    Bit(Register),
}

const STATUS_BIT: u8 = 3;

/// One device: a unit behind the plant's listener.
#[derive(Clone, Debug)]
pub(super) struct Device {
    name: &'static str,
    /// Its unit identifier.
    pub(super) unit_id: u8,
    table: Register,
    value_type: ValueType,
    order: ByteOrder,
    address_base: u16,
    /// value = scale * raw; 1 for floating point.
    scale: f64,
    mode: ModeAs,
    /// Its loops' places in the plant.
    loops: Vec<usize>,
}

/// The four devices, one per class, each with other habits.
pub(super) fn devices(plant: &[DemoLoop]) -> Vec<Device> {
    let device = |class, name, unit_id, table, value_type, order, address_base, mode| Device {
        name,
        unit_id,
        table,
        value_type,
        order,
        address_base,
        scale: if value_type == ValueType::I32 { 1e-4 } else { 1.0 },
        mode,
        loops: (0..plant.len()).filter(|&at| plant[at].class == class).collect(),
    };
    use ByteOrder::{Abcd, Badc, Cdab, Dcba};
    use Register::{Coil, Discrete, Holding, Input};
    use ValueType::{F32, F64, I32};
    vec![
        device(Class::Flow, "flow-dcs", 1, Holding, F32, Abcd, 0, ModeAs::Word),
        device(Class::Level, "level-plc", 2, Input, F32, Cdab, 1, ModeAs::Bit(Discrete)),
        device(Class::Pressure, "pressure-rtu", 3, Holding, I32, Badc, 0, ModeAs::StatusBit),
        device(Class::Temperature, "temperature-plc", 4, Input, F64, Dcba, 1, ModeAs::Bit(Coil)),
    ]
}

impl Device {
    /// Addresses from one loop to the next.
    fn stride(&self) -> u16 {
        3 * self.value_type.width() + u16::from(!matches!(self.mode, ModeAs::Bit(_)))
    }

    /// The table from address 0 on, at this moment; `None` for a table the device does not have.
    pub(super) fn image(&self, table: Register, plant: &[DemoLoop], points: &[Point]) -> Option<Vec<u16>> {
        let rows = self.loops.iter().map(|&at| (&plant[at], &points[at]));
        let mut image = vec![0; usize::from(FIRST)];
        if table == self.table {
            for (demo, point) in rows {
                for value in [point.op, point.pv, point.sp] {
                    image.extend(self.words(value));
                }
                match self.mode {
                    ModeAs::Word => image.extend(self.ordered(&[0, u8::from(demo.in_automatic())])),
                    ModeAs::StatusBit => {
                        image.extend(self.ordered(&[0, u8::from(demo.in_automatic()) << STATUS_BIT]));
                    }
                    ModeAs::Bit(_) => {}
                }
            }
        } else if self.mode == ModeAs::Bit(table) {
            image.extend(rows.map(|(demo, _)| u16::from(demo.in_automatic())));
        } else {
            return None;
        }
        image.resize(image.len() + usize::from(SPARE), 0);
        Some(image)
    }

    /// A value as the device stores it.
    fn words(&self, value: f64) -> Vec<u16> {
        match self.value_type {
            ValueType::F64 => self.ordered(&value.to_be_bytes()),
            ValueType::F32 => self.ordered(&(value as f32).to_be_bytes()),
            // A float-to-integer cast saturates: what does not fit becomes the limit.
            _ => self.ordered(&((value / self.scale).round() as i32).to_be_bytes()),
        }
    }

    /// A value of one or more words in the device's order; one that swaps bytes swaps them in every word it holds.
    fn ordered(&self, big_endian: &[u8]) -> Vec<u16> {
        let mut words: Vec<u16> =
            big_endian.chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        if matches!(self.order, ByteOrder::Cdab | ByteOrder::Dcba) {
            words.reverse();
        }
        if matches!(self.order, ByteOrder::Badc | ByteOrder::Dcba) {
            words.iter_mut().for_each(|word| *word = word.swap_bytes());
        }
        words
    }
}

/// Bounds of write-back in the demo. Plant time, but for `write_ms` and `timeout_ms`, which pass on the wall.
const WRITEBACK: &str = "  term_type = \"f32\"
  term_byte_order = \"ABCD\"
  term_scale_percent = 1.0
  write_ms = 25
  timeout_ms = 400
  clamp_percent = 4.0
  rate_percent_per_s = 20.0
  withdraw_percent_per_s = 2.0
  withdraw_limit_s = 30.0
  dead_band_percent = 0.05
  rest_ms = 1200
  max_step_ms = 10000
  clock_tolerance_ms = 1000
  max_sample_age_ms = 10000
  max_missed_polls_per_minute = 60
  op_margin_percent = 5.0
  sp_rate_per_s = 0.1
  sp_settle_s = 10.0
  evidence_max_age_s = 3600.0
  f_margin_percent = 0.5
  grant_max_s = 36000.0
  measure_s = 240.0
  prove_s = 720.0
  ise_gain = 1.5
  ise_limit = 3.0
  travel_limit = 40.0
  reversal_band_percent = 0.2
";
/// A heartbeat that stands still for longer drops the term (s of plant time).
pub(super) const HEARTBEAT_S: f64 = 20.0;

/// How fast the demo goes, for the configuration that polls it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pace {
    /// Poll period [ms on the wall clock].
    pub(super) poll_ms: u64,
    /// Time between two diagnoses of a loop (s of plant time).
    pub(super) period_s: f64,
    /// Where write-back is put on record; `None` without it.
    pub(super) audit: Option<PathBuf>,
}

/// Plant time between two looks at the plant as a whole, and how long a suspicion has to last (s): hours would be days here.
const LOOK_S: f64 = 600.0;
const PERSIST_S: f64 = 3600.0;

/// The configuration file that `run` would need to watch the plant at `address`.
pub(super) fn config(plant: &[DemoLoop], listen: SocketAddr, address: SocketAddr, pace: &Pace) -> String {
    let Pace { poll_ms, period_s, audit } = pace;
    let mut text = format!(
        "[server]\nlisten = \"{listen}\"\nshutdown_s = 0.5\n\n[schedule]\nperiod_s = {period_s:?}\nparallelism = 1\n\
         \n[plantwide]\nperiod_s = {LOOK_S:?}\npersist_s = {PERSIST_S:?}\n"
    );
    // Writing to a String cannot fail.
    for device in devices(plant) {
        let _ = write!(
            text,
            "\n[[modbus]]\nname = \"{}\"\naddress = \"{address}\"\nunit_id = {}\npoll_ms = {poll_ms}\n\
             timeout_ms = {poll_ms}\nreconnect_max_ms = 1000\naddress_base = {}\nbyte_order = \"{}\"\n",
            device.name,
            device.unit_id,
            device.address_base,
            device.order.as_str(),
        );
    }
    if let Some(audit) = audit {
        let _ = write!(text, "\n[writeback]\naudit_file = {:?}\n", audit.display().to_string());
    }
    for device in devices(plant) {
        for (row, &at) in device.loops.iter().enumerate() {
            let _ = write!(text, "\n{}", loop_text(&device, row as u16, &plant[at]));
            if audit.is_some() && plant[at].truth.sticky {
                text += &writeback_text(&device, at as u16);
            }
        }
    }
    text
}

fn loop_text(device: &Device, row: u16, demo: &DemoLoop) -> String {
    let first = FIRST + device.address_base + row * device.stride();
    let width = device.value_type.width();
    let tag = |role: &str, place: u16| {
        let mut tag = format!(
            "  [loop.{role}]\n  device = \"{}\"\n  register = \"{}\"\n  address = {}\n  type = \"{}\"\n  unit = \"%\"\n",
            device.name,
            device.table,
            first + place * width,
            device.value_type.as_str(),
        );
        if device.scale != 1.0 {
            let _ = writeln!(tag, "  scale = {:?}", device.scale);
        }
        tag
    };
    let (table, address, how) = match device.mode {
        ModeAs::Word => {
            (device.table, first + 3 * width, "  type = \"u16\"\n  auto_values = [1]\n".to_owned())
        }
        ModeAs::StatusBit => {
            (device.table, first + 3 * width, format!("  type = \"bit\"\n  bit = {STATUS_BIT}\n"))
        }
        ModeAs::Bit(table) => (table, FIRST + device.address_base + row, String::new()),
    };
    format!(
        "[[loop]]\nid = \"{}\"\ndescription = \"{} ({})\"\ngroup = \"{}\"\nop_span = 100.0\nop_limits = [0.0, 100.0]\n\
         frozen_pv_s = 120.0\n{}{}{}  [loop.mode]\n  device = \"{}\"\n  register = \"{table}\"\n  address = {address}\n{how}",
        demo.id,
        demo.class.as_str(),
        demo.truth.kind,
        demo.class.as_str(),
        tag("op", 0),
        tag("pv", 1),
        tag("sp", 2),
        device.name,
    )
}

fn writeback_text(device: &Device, at: u16) -> String {
    let first = dcs::FIRST + dcs::STRIDE * at + device.address_base;
    format!(
        "  [loop.writeback]\n  enabled = true\n  device = \"{}\"\n  term_address = {first}\n  heartbeat_address = {}\n\
         \x20 heartbeat_timeout_ms = {:.0}\n{WRITEBACK}",
        device.name,
        first + 2,
        1000.0 * HEARTBEAT_S,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::demo_plant;

    /// 1.5 is 3FC0_0000 as f32 and 3FF8_0000_0000_0000 as f64; -1.5 at 1e-4 is -15000 = FFFF_C568.
    #[test]
    fn words_by_hand() {
        let devices = devices(&demo_plant(1));
        assert_eq!(devices[0].words(1.5), [0x3FC0, 0]);
        assert_eq!(devices[1].words(1.5), [0, 0x3FC0]);
        assert_eq!(devices[2].words(-1.5), [0xFFFF, 0x68C5]);
        assert_eq!(devices[3].words(1.5), [0, 0, 0, 0xF83F]);
    }

    #[test]
    fn values_and_modes_lie_where_the_configuration_says() {
        let plant = demo_plant(1);
        let points: Vec<Point> =
            (0..plant.len()).map(|at| Point { pv: at as f64, ..Point::default() }).collect();
        let devices = devices(&plant);
        // The second flow loop's PV: 100 + 7 (three floats and a mode) + 2; its mode word 4 later.
        let flow = devices[0].image(Register::Holding, &plant, &points).expect("has it");
        let first = (1.0_f32).to_bits();
        assert_eq!(flow[109..111], [(first >> 16) as u16, first as u16]);
        assert_eq!(flow[113], 1);
        assert_eq!(devices[0].image(Register::Input, &plant, &points), None);
        // The first pressure loop's status word follows three integers; bit 3, its bytes swapped.
        let pressure = devices[2].image(Register::Holding, &plant, &points).expect("has it");
        assert_eq!(pressure[106], 0x0800);
        // The fourth level loop is in manual.
        let modes = devices[1].image(Register::Discrete, &plant, &points).expect("has it");
        assert_eq!(modes[100..104], [1, 1, 1, 0]);
    }
}
