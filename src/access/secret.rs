//! Secrets: random ones as SHA-256, passwords by Argon2id. What is kept cannot be turned back.

use argon2::{Algorithm, Argon2, Params, Version};
use sha2::{Digest, Sha256};
use std::fmt;

/// Shortest and longest password (characters, bytes).
pub const PASSWORD_LENGTH: (usize, usize) = (10, 1024);

/// `N` bytes of the operating system's randomness; `None` where it has none.
pub fn random<const N: usize>() -> Option<[u8; N]> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).ok().map(|()| bytes)
}

/// SHA-256 of a random secret: of 256 random bits no salt and no slow hash is needed.
pub fn digest(secret: &str) -> [u8; 32] {
    Sha256::digest(secret.as_bytes()).into()
}

/// Whether two digests are the same, in a time that does not tell where they differ.
pub fn same(a: &[u8; 32], b: &[u8; 32]) -> bool {
    a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
}

/// Whether two words are the same, likewise.
pub fn same_word(a: &str, b: &str) -> bool {
    same(&digest(a), &digest(b))
}

/// Lower-case hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The bytes of lower- or upper-case hexadecimal, when there are `N`.
pub fn unhex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digits = text.as_bytes();
    if digits.len() != 2 * N || !digits.iter().all(u8::is_ascii_hexdigit) {
        return None;
    }
    let mut bytes = [0; N];
    for (byte, pair) in bytes.iter_mut().zip(digits.chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    Some(bytes)
}

/// What one hash of a password costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Memory (KiB).
    pub memory_kib: u32,
    /// Passes over it.
    pub passes: u32,
}

impl Default for Cost {
    /// OWASP's first choice for Argon2id.
    fn default() -> Self {
        Self { memory_kib: 19_456, passes: 2 }
    }
}

/// A password that can be recognised and not be read.
#[derive(Clone, PartialEq, Eq)]
pub struct PasswordHash {
    /// What one trial costs.
    pub cost: Cost,
    /// Random, so that the same password does not look the same.
    pub salt: [u8; 16],
    /// Argon2id of both.
    pub hash: [u8; 32],
}

impl PasswordHash {
    /// Argon2id, version 19, one lane. `None` where the cost is none that the algorithm takes.
    pub fn of(password: &str, salt: [u8; 16], cost: Cost) -> Option<Self> {
        let params = Params::new(cost.memory_kib, cost.passes, 1, Some(32)).ok()?;
        let mut hash = [0; 32];
        let argon = Argon2::new(Algorithm::Argon2id, Version::V0x13, params);
        argon.hash_password_into(password.as_bytes(), &salt, &mut hash).ok()?;
        Some(Self { cost, salt, hash })
    }

    /// Whether this is the password; takes as long as [`PasswordHash::of`].
    pub fn is(&self, password: &str) -> bool {
        Self::of(password, self.salt, self.cost).is_some_and(|other| same(&self.hash, &other.hash))
    }
}

impl fmt::Debug for PasswordHash {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("PasswordHash(…)")
    }
}

/// What is wrong with a new password of a user, for people.
pub fn wrong_password(user: &str, password: &str) -> Option<String> {
    let (least, most) = PASSWORD_LENGTH;
    if password.chars().count() < least {
        return Some(format!("a password has at least {least} characters"));
    }
    if password.len() > most {
        return Some(format!("a password has at most {most} bytes"));
    }
    if password.to_lowercase().contains(&user.to_lowercase()) {
        return Some("a password does not contain the user's name".to_string());
    }
    let first = password.chars().next();
    password
        .chars()
        .all(|c| Some(c) == first)
        .then(|| "one character over and over is no password".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHEAP: Cost = Cost { memory_kib: 8, passes: 1 };

    #[test]
    fn a_password_is_recognised_and_not_shown() {
        let hash = PasswordHash::of("correct horse", [7; 16], CHEAP).expect("a cost");
        assert!(hash.is("correct horse") && !hash.is("correct horsf") && !hash.is(""));
        let salted = PasswordHash::of("correct horse", [8; 16], CHEAP).expect("a cost");
        assert_ne!(hash.hash, salted.hash);
        assert_eq!(format!("{hash:?}"), "PasswordHash(…)");
        assert_eq!(PasswordHash::of("x", [0; 16], Cost { memory_kib: 1, passes: 1 }), None);
    }

    /// By another implementation (OpenSSL's): 2 passes over 64 KiB, one lane.
    #[test]
    fn the_hash_is_that_of_others() {
        let hash = PasswordHash::of("password", *b"saltsaltsaltsalt", Cost { memory_kib: 64, passes: 2 });
        let theirs = "8ba3fa702bd2c08fc6a7830ede5f30be3a1751ed492f31cd7d76a0a480725b5a";
        assert_eq!(hex(&hash.expect("a cost").hash), theirs);
    }

    #[test]
    fn hexadecimal_is_read_as_it_is_written() {
        assert_eq!(unhex::<3>(&hex(&[0, 171, 255])), Some([0, 171, 255]));
        for wrong in ["", "00ab", "00abfg", "00abff0", "+0abff", "00abffff"] {
            assert_eq!(unhex::<3>(wrong), None, "{wrong}");
        }
        assert!(same(&digest("a"), &digest("a")) && !same(&digest("a"), &digest("b")));
    }

    #[test]
    fn a_password_that_is_none_is_refused() {
        for wrong in ["short", "aaaaaaaaaaaa", "KellerKeller1", &"x1".repeat(600)] {
            assert!(wrong_password("keller", wrong).is_some(), "{wrong}");
        }
        assert_eq!(wrong_password("keller", "vier Ventile 4"), None);
    }
}
