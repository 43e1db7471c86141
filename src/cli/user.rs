//! `stictiond user`: who may log in. A password is asked for, or read from standard input, and never an argument: those
//! stand in lists of processes and in histories.

use super::book::{Place, Wrong, roles, secret};
use super::{Failure, print};
use std::io::{self, BufRead, IsTerminal, Read};
use stictiond::access::{Cost, PasswordHash, Role, wrong_password};

/// More of standard input than a password may have.
const MOST_BYTES: u64 = 4096;

#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    place: Place,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Add a user; the password is asked for, or read from standard input
    Add {
        /// What they log in with, and what stands in the audit log
        name: String,
        /// viewer, operator, engineer or approver; several are possible
        #[arg(long = "role", required = true, value_delimiter = ',')]
        roles: Vec<Role>,
    },
    /// Change a user's password; their sessions end
    Passwd {
        /// Which user
        name: String,
    },
    /// Change what a user may do; their sessions end
    Roles {
        /// Which user
        name: String,
        /// All their roles from now on
        #[arg(long = "role", required = true, value_delimiter = ',')]
        roles: Vec<Role>,
    },
    /// Remove a user; their sessions end
    Remove {
        /// Which user
        name: String,
    },
    /// List the users and their roles
    List,
}

/// Does it; a running daemon follows within a second.
pub fn run(args: &Args) -> Result<(), Failure> {
    let place = &args.place;
    match &args.command {
        Command::Add { name, roles: named } => {
            let password = password(name)?;
            place.add(|book| Ok(book.add_user(name, roles(named), hashed(&password)?)?))?;
            print(&format!("{name}: added as {}\n", roles(named)))
        }
        Command::Passwd { name } => {
            if place.read()?.user(name).is_none() {
                return Err(Failure::BadInput(format!("there is no user {name:?}")));
            }
            let password = password(name)?;
            place.change(|book| Ok(book.change_user(name, None, Some(hashed(&password)?))?))?;
            print(&format!("{name}: another password; their sessions end\n"))
        }
        Command::Roles { name, roles: named } => {
            place.change(|book| Ok(book.change_user(name, Some(roles(named)), None)?))?;
            print(&format!("{name}: is now {}; their sessions end\n", roles(named)))
        }
        Command::Remove { name } => {
            place.change(|book| Ok(book.remove_user(name)?))?;
            print(&format!("{name}: removed; their sessions end\n"))
        }
        Command::List => {
            let users = place.read()?.users;
            print(&users.iter().map(|user| format!("{:<24} {}\n", user.name, user.roles)).collect::<String>())
        }
    }
}

fn hashed(password: &str) -> Result<PasswordHash, Wrong> {
    let hash = PasswordHash::of(password, secret()?, Cost::default());
    hash.ok_or_else(|| Wrong::Asked("the password cannot be hashed".to_string()))
}

/// A password that is one: typed twice at a terminal, else the first line of standard input.
fn password(name: &str) -> Result<String, Failure> {
    let unreadable = |error: io::Error| Failure::Failed(format!("the password cannot be read: {error}"));
    let given = if io::stdin().is_terminal() {
        let first = rpassword::prompt_password(format!("Password of {name}: ")).map_err(unreadable)?;
        let again = rpassword::prompt_password("Again: ").map_err(unreadable)?;
        if first != again {
            return Err(Failure::BadInput("the two are not the same; nothing was changed".into()));
        }
        first
    } else {
        let mut line = String::new();
        io::stdin().lock().take(MOST_BYTES).read_line(&mut line).map_err(unreadable)?;
        line.trim_end_matches(['\r', '\n']).to_string()
    };
    match wrong_password(name, &given) {
        Some(wrong) => Err(Failure::BadInput(format!("{wrong}; nothing was changed"))),
        None => Ok(given),
    }
}
