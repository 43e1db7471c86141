//! Checks the log-ins of the configuration: a user name, and the file or the environment variable that has its password.

use std::path::PathBuf;

/// The message for an environment variable whose name is empty.
pub const NO_NAME: &str = "must name an environment variable";

/// Whether the name of an environment variable is given, but blank.
pub fn names_nothing(env: &Option<String>) -> bool {
    env.as_ref().is_some_and(|name| name.trim().is_empty())
}

/// What is wrong with `user`, `password_file` and `password_env` of a section: each field with a message. Empty if nothing is.
pub fn wrong(
    user: &Option<String>,
    file: &Option<PathBuf>,
    env: &Option<String>,
) -> Vec<(&'static str, &'static str)> {
    let mut wrong = Vec::new();
    if user.is_some() != (file.is_some() || env.is_some()) {
        wrong.push((
            "user",
            "a user name needs password_file or password_env, and each of these needs a user name",
        ));
    }
    if file.is_some() && env.is_some() {
        wrong.push(("password_env", "there is password_file too: leave one out"));
    }
    if names_nothing(env) {
        wrong.push(("password_env", NO_NAME));
    }
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_name_and_one_place_of_its_password_belong_together() {
        for (user, file, env, fields) in [
            (Some("u"), None, None, &["user"][..]),
            (None, None, None, &[]),
            (Some("u"), Some("f"), None, &[]),
            (Some("u"), None, Some("E"), &[]),
            (None, Some("f"), None, &["user"]),
            (None, None, Some("E"), &["user"]),
            (Some("u"), Some("f"), Some("E"), &["password_env"]),
            (Some("u"), None, Some(" "), &["password_env"]),
            (None, Some("f"), Some(""), &["user", "password_env", "password_env"]),
        ] {
            let (user, env) = (user.map(str::to_string), env.map(str::to_string));
            let found = wrong(&user, &file.map(PathBuf::from), &env);
            let found: Vec<&str> = found.into_iter().map(|(field, _)| field).collect();
            assert_eq!(found, fields, "{user:?} {file:?} {env:?}");
        }
    }
}
