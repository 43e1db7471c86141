//! Roles, and which includes which.

use std::fmt;
use std::str::FromStr;

/// What somebody may do. Each includes what stands before it on its line:
///
/// ```text
/// viewer - operator - engineer
///                   \ approver
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Reads.
    Viewer,
    /// Acknowledges and shelves alarms, asks for a diagnosis.
    Operator,
    /// Takes alarms out of service, takes data away, reads the audit log.
    Engineer,
    /// Grants, approves and resets write-back.
    Approver,
}

impl Role {
    /// Every role.
    pub const ALL: [Role; 4] = [Role::Viewer, Role::Operator, Role::Engineer, Role::Approver];

    /// Its name, as it is written everywhere.
    pub fn as_str(self) -> &'static str {
        match self {
            Role::Viewer => "viewer",
            Role::Operator => "operator",
            Role::Engineer => "engineer",
            Role::Approver => "approver",
        }
    }

    /// Whether who has this role may do what `needed` may.
    pub fn includes(self, needed: Role) -> bool {
        self == needed || needed == Role::Viewer || needed == Role::Operator && self != Role::Viewer
    }
}

impl fmt::Display for Role {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.as_str())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Role::ALL.into_iter().find(|role| role.as_str() == text);
        found.ok_or_else(|| format!("{text:?} is none of viewer, operator, engineer, approver"))
    }
}

/// The roles that somebody has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Roles(Vec<Role>);

impl Roles {
    /// These, each once.
    pub fn of(roles: &[Role]) -> Self {
        let mut roles = roles.to_vec();
        roles.sort_unstable();
        roles.dedup();
        Self(roles)
    }

    /// Whether one of them includes `needed`.
    pub fn may(&self, needed: Role) -> bool {
        self.0.iter().any(|role| role.includes(needed))
    }

    /// Each of them.
    pub fn iter(&self) -> impl Iterator<Item = Role> + '_ {
        self.0.iter().copied()
    }

    /// What both of two may do.
    pub fn common(&self, other: &Self) -> Self {
        if self.iter().all(|role| other.may(role)) {
            return self.clone();
        }
        if other.iter().all(|role| self.may(role)) {
            return other.clone();
        }
        Self(Role::ALL.into_iter().filter(|&role| self.may(role) && other.may(role)).collect())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl fmt::Display for Roles {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.iter().map(Role::as_str).collect();
        out.write_str(&names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_may_what_is_this_table() {
        use Role::*;
        let may = |role: Role| Role::ALL.map(|needed| role.includes(needed));
        assert_eq!(may(Viewer), [true, false, false, false]);
        assert_eq!(may(Operator), [true, true, false, false]);
        assert_eq!(may(Engineer), [true, true, true, false]);
        assert_eq!(may(Approver), [true, true, false, true]);
        let both = Roles::of(&[Approver, Engineer, Approver]);
        assert_eq!(both.to_string(), "engineer, approver");
        assert!(Role::ALL.into_iter().all(|needed| both.may(needed)));
        assert!(!Roles::default().may(Viewer));
        assert_eq!("engineer".parse(), Ok(Engineer));
        assert!("Engineer".parse::<Role>().is_err());
    }
}
