//! The tables of a Modbus device, and how its registers become numbers.

use serde::Deserialize;
use std::fmt;
use std::str::FromStr;

/// The four tables of a Modbus device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Register {
    /// Holding registers, function 3.
    Holding,
    /// Input registers, function 4.
    Input,
    /// Coils, function 1.
    Coil,
    /// Discrete inputs, function 2.
    Discrete,
}

impl Register {
    /// True for the tables of single bits.
    pub fn is_bits(self) -> bool {
        matches!(self, Register::Coil | Register::Discrete)
    }

    /// The name as the configuration writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Register::Holding => "holding",
            Register::Input => "input",
            Register::Coil => "coil",
            Register::Discrete => "discrete",
        }
    }
}

impl FromStr for Register {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        [Register::Holding, Register::Input, Register::Coil, Register::Discrete]
            .into_iter()
            .find(|register| register.as_str() == text)
            .ok_or_else(|| format!("'{text}' is none of holding, input, coil, discrete"))
    }
}

impl fmt::Display for Register {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.as_str())
    }
}

/// How registers become a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ValueType {
    /// Unsigned, one register.
    U16,
    /// Two's complement, one register.
    I16,
    /// Unsigned, two registers.
    U32,
    /// Two's complement, two registers.
    I32,
    /// Unsigned, four registers; beyond 2^53 to the nearest double.
    U64,
    /// Two's complement, four registers; as `U64`.
    I64,
    /// IEEE 754 single precision, two registers.
    F32,
    /// IEEE 754 double precision, four registers.
    F64,
    /// One bit of a register, or a coil or discrete input.
    Bit,
}

impl ValueType {
    /// Registers (or, for a coil, bits) that a value takes.
    pub fn width(self) -> u16 {
        match self {
            ValueType::U16 | ValueType::I16 | ValueType::Bit => 1,
            ValueType::U32 | ValueType::I32 | ValueType::F32 => 2,
            ValueType::U64 | ValueType::I64 | ValueType::F64 => 4,
        }
    }

    /// The name as the configuration writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            ValueType::U16 => "u16",
            ValueType::I16 => "i16",
            ValueType::U32 => "u32",
            ValueType::I32 => "i32",
            ValueType::U64 => "u64",
            ValueType::I64 => "i64",
            ValueType::F32 => "f32",
            ValueType::F64 => "f64",
            ValueType::Bit => "bit",
        }
    }

    /// The least and the greatest raw number of a whole-number type or a bit; `None` of one with a fraction.
    pub fn raw_range(self) -> Option<[f64; 2]> {
        let bits = 16 * i32::from(self.width());
        match self {
            ValueType::U16 | ValueType::U32 | ValueType::U64 => Some([0.0, 2f64.powi(bits) - 1.0]),
            ValueType::I16 | ValueType::I32 | ValueType::I64 => {
                Some([-2f64.powi(bits - 1), 2f64.powi(bits - 1) - 1.0])
            }
            ValueType::Bit => Some([0.0, 1.0]),
            ValueType::F32 | ValueType::F64 => None,
        }
    }

    pub(super) fn is_integer(self) -> bool {
        !matches!(self, ValueType::F32 | ValueType::F64 | ValueType::Bit)
    }
}

/// The order in which the bytes of a value lie in ascending registers, each register's high byte first.
/// A is the most significant byte.
///
/// | order | 16 bits (AB) | 32 bits (ABCD) | 64 bits (ABCDEFGH) | in words |
/// |---|---|---|---|---|
/// | `ABCD` | AB | AB CD | AB CD EF GH | most significant register first |
/// | `CDAB` | AB | CD AB | GH EF CD AB | least significant register first |
/// | `BADC` | BA | BA DC | BA DC FE HG | as ABCD, the bytes of each register swapped |
/// | `DCBA` | BA | DC BA | HG FE DC BA | as CDAB, the bytes of each register swapped |
///
/// The bit of `type = "bit"` counts in the register as a `u16` of the same order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Deserialize)]
pub enum ByteOrder {
    /// Big-endian, as the protocol's own numbers.
    #[default]
    #[serde(rename = "ABCD")]
    Abcd,
    /// Words swapped.
    #[serde(rename = "CDAB")]
    Cdab,
    /// Bytes swapped in each word.
    #[serde(rename = "BADC")]
    Badc,
    /// Little-endian.
    #[serde(rename = "DCBA")]
    Dcba,
}

impl ByteOrder {
    /// All four.
    pub const ALL: [ByteOrder; 4] = [ByteOrder::Abcd, ByteOrder::Cdab, ByteOrder::Badc, ByteOrder::Dcba];

    /// The name as the configuration writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            ByteOrder::Abcd => "ABCD",
            ByteOrder::Cdab => "CDAB",
            ByteOrder::Badc => "BADC",
            ByteOrder::Dcba => "DCBA",
        }
    }
}
