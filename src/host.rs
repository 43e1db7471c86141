//! What this machine is called, where a program that we ask wants to know.

/// Longest name (bytes), as the domain name system has it.
const LONGEST: usize = 253;

/// The machine's own name, with nothing in it but letters, digits, `.` and `-`; `localhost` where it has none.
pub fn name() -> String {
    plain(&gethostname::gethostname().to_string_lossy())
}

fn plain(told: &str) -> String {
    let fits = |c: char| if c.is_ascii_alphanumeric() || c == '.' { c } else { '-' };
    let name: String = told.chars().take(LONGEST).map(fits).collect();
    let name = name.trim_matches(['-', '.']);
    if name.is_empty() { "localhost".into() } else { name.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_that_protocols_take() {
        for (told, name) in [
            ("plant-pc", "plant-pc"),
            ("pc.plant.example", "pc.plant.example"),
            ("Leitstand PC_1\n", "Leitstand-PC-1"),
            ("", "localhost"),
            ("--", "localhost"),
        ] {
            assert_eq!(plain(told), name, "{told:?}");
        }
        assert!(plain(&"x".repeat(1000)).len() <= LONGEST);
        assert_eq!(plain(&name()), name());
    }
}
