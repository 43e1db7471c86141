//! Slows down who tries passwords: by user and address, by address, and a little by user. Bounded: what it forgets first
//! is what was tried longest ago.
//!
//! A stranger must not be able to lock a user out, so the wait of a user alone stays short; the wait of an address grows.

use std::collections::HashMap;
use std::net::IpAddr;

/// Keys remembered.
const MOST: usize = 4096;
/// Quiet time after which everything is forgotten (s).
const FORGET_S: f64 = 3600.0;

/// Trials without a wait, and the longest wait (s).
#[derive(Clone, Copy)]
struct Patience {
    free: u32,
    longest_s: f64,
}

const PAIR: Patience = Patience { free: 5, longest_s: 900.0 };
const ADDRESS: Patience = Patience { free: 20, longest_s: 900.0 };
const USER: Patience = Patience { free: 30, longest_s: 30.0 };

#[derive(Clone, PartialEq, Eq, Hash)]
enum Key {
    Pair(String, IpAddr),
    Address(IpAddr),
    User(String),
}

impl Key {
    fn patience(&self) -> Patience {
        match self {
            Key::Pair(..) => PAIR,
            Key::Address(_) => ADDRESS,
            Key::User(_) => USER,
        }
    }
}

#[derive(Clone, Copy)]
struct Trials {
    count: u32,
    last: f64,
    /// No trial before this (s).
    until: f64,
}

/// What was tried lately.
#[derive(Default)]
pub struct Throttle {
    trials: HashMap<Key, Trials>,
}

impl Throttle {
    /// Counts a trial at `now` (s, of a steady clock) as a failure; it is taken back by [`Throttle::succeeded`].
    ///
    /// # Errors
    /// How long to wait (s), when it is too early; then it does not count.
    pub fn attempt(&mut self, user: &str, address: IpAddr, now: f64) -> Result<(), f64> {
        let keys = keys(user, address);
        let waits = keys.iter().filter_map(|key| self.trials.get(key)).map(|trials| trials.until - now);
        let wait = waits.fold(0.0, f64::max);
        if wait > 0.0 {
            return Err(wait);
        }
        for key in keys {
            let patience = key.patience();
            self.make_room(&key, now);
            let trials = self.trials.entry(key).or_insert(Trials { count: 0, last: now, until: now });
            trials.count = if now - trials.last > FORGET_S { 1 } else { trials.count.saturating_add(1) };
            trials.last = now;
            if trials.count >= patience.free {
                // 1 s after the last free trial, then doubled.
                let doubled = 2f64.powi((trials.count - patience.free).min(30) as i32);
                trials.until = now + doubled.min(patience.longest_s);
            }
        }
        Ok(())
    }

    /// The last trial was right: the user, and the user from there, start anew. The address does not, or somebody with
    /// one account could try others without end.
    pub fn succeeded(&mut self, user: &str, address: IpAddr) {
        let [pair, of_address, of_user] = keys(user, address);
        self.trials.remove(&pair);
        self.trials.remove(&of_user);
        if let Some(trials) = self.trials.get_mut(&of_address) {
            trials.count = trials.count.saturating_sub(1);
            if trials.count < ADDRESS.free {
                trials.until = trials.last;
            }
        }
    }

    fn make_room(&mut self, key: &Key, now: f64) {
        if self.trials.len() < MOST || self.trials.contains_key(key) {
            return;
        }
        self.trials.retain(|_, trials| now - trials.last <= FORGET_S);
        if self.trials.len() >= MOST {
            let oldest = self.trials.iter().min_by(|a, b| a.1.last.total_cmp(&b.1.last));
            if let Some(oldest) = oldest.map(|(key, _)| key.clone()) {
                self.trials.remove(&oldest);
            }
        }
    }
}

fn keys(user: &str, address: IpAddr) -> [Key; 3] {
    // What no user can be called shares one key: it costs no memory and tells nothing.
    let user = if super::is_name(user) { user.to_lowercase() } else { String::new() };
    // A household has a whole /64: its addresses are one.
    let address = match address.to_canonical() {
        IpAddr::V6(v6) => IpAddr::V6((v6.to_bits() >> 64 << 64).into()),
        v4 => v4,
    };
    [Key::Pair(user.clone(), address), Key::Address(address), Key::User(user)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(n: u32) -> IpAddr {
        IpAddr::from(n.to_be_bytes())
    }

    #[test]
    fn after_five_trials_the_wait_doubles_and_a_success_ends_it() {
        let mut throttle = Throttle::default();
        for _ in 0..5 {
            assert_eq!(throttle.attempt("jw", at(1), 0.0), Ok(()));
        }
        assert_eq!(throttle.attempt("JW", at(1), 0.5), Err(0.5));
        assert_eq!(throttle.attempt("jw", at(1), 1.0), Ok(()));
        assert_eq!(throttle.attempt("jw", at(1), 2.0), Err(1.0));
        assert_eq!(throttle.attempt("jw", at(1), 3.0), Ok(()));
        // From elsewhere the user is not locked out.
        assert_eq!(throttle.attempt("jw", at(2), 3.0), Ok(()));
        throttle.succeeded("jw", at(1));
        assert_eq!(throttle.attempt("jw", at(1), 3.0), Ok(()));
    }

    #[test]
    fn an_address_that_tries_many_users_waits_and_a_user_never_long() {
        let mut throttle = Throttle::default();
        let passed = (0..100).filter(|k| throttle.attempt(&format!("u{k}"), at(1), 0.0).is_ok()).count();
        assert_eq!(passed, 20);
        let mut now = 0.0;
        let mut longest: f64 = 0.0;
        for k in 0..500 {
            if let Err(wait) = throttle.attempt("jw", at(1000 + k), now) {
                longest = longest.max(wait);
                now += wait;
            }
        }
        assert!(longest > 1.0 && longest <= 30.0, "{longest}");
    }

    #[test]
    fn addresses_of_one_household_are_one() {
        let mut throttle = Throttle::default();
        let v6 = |n: u128| IpAddr::V6((0x2001_0db8_u128 << 96 | n).into());
        assert_eq!((0..100).filter(|k| throttle.attempt("jw", v6(*k), 0.0).is_ok()).count(), 5);
    }

    #[test]
    fn its_memory_is_bounded() {
        let mut throttle = Throttle::default();
        for k in 0..2 * MOST as u32 {
            let _ = throttle.attempt(&format!("u{k}"), at(k), f64::from(k));
            assert!(throttle.trials.len() <= MOST);
        }
        assert!(throttle.trials.len() > MOST / 2);
    }

    proptest! {
        #[test]
        fn no_wait_is_longer_than_it_says(
            tries in prop::collection::vec((0u32..4, 0u32..4, 0.0..10.0f64), 1..200)
        ) {
            let mut throttle = Throttle::default();
            let mut now = 0.0;
            for (user, address, pause) in tries {
                now += pause;
                if let Err(wait) = throttle.attempt(&format!("u{user}"), at(address), now) {
                    prop_assert!(wait > 0.0 && wait <= PAIR.longest_s);
                    now += wait + 1e-6;
                    prop_assert_eq!(throttle.attempt(&format!("u{user}"), at(address), now), Ok(()));
                }
            }
        }
    }
}
