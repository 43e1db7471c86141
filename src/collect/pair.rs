//! Two numbers of a configuration, `[lowest, highest]`.

use serde::de::{Deserializer, Error, SeqAccess, Visitor};
use std::fmt;

/// Reads a pair as `[low, high]`: of more numbers the rest would be passed over.
///
/// # Errors
/// Not two numbers.
pub fn pair<'de, D: Deserializer<'de>>(from: D) -> Result<Option<[f64; 2]>, D::Error> {
    struct Pair;
    impl<'de> Visitor<'de> for Pair {
        type Value = [f64; 2];

        fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
            out.write_str("an array of length 2")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut numbers: A) -> Result<Self::Value, A::Error> {
            let mut all: Vec<f64> = Vec::new();
            while let Some(number) = numbers.next_element()? {
                all.push(number);
            }
            let count = all.len();
            all.try_into().map_err(|_| {
                A::Error::custom(format!("two numbers are needed, [lowest, highest], and here are {count}"))
            })
        }
    }
    from.deserialize_seq(Pair).map(Some)
}
