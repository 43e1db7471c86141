//! `stictiond token`: which programs may ask. A token is printed once; what is kept of it does not open the door.

use super::book::{Place, day, now, roles, secret};
use super::{Failure, print};
use std::fmt::Write as _;
use stictiond::access::{NewToken, Role};

const DAY_S: f64 = 86_400.0;

#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    place: Place,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Create a token and print it, once
    Create {
        /// What it is for; stands in the audit log
        name: String,
        /// viewer, operator, engineer or approver; several are possible
        #[arg(long = "role", required = true, value_delimiter = ',')]
        roles: Vec<Role>,
        /// Days until it runs out
        #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
        days: u32,
    },
    /// Print a new token of the same name and roles; the old one runs out
    Rotate {
        /// Which token
        name: String,
        /// Days until the new one runs out
        #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
        days: u32,
        /// Minutes that the old one is good for yet
        #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=10_080))]
        overlap_minutes: u32,
    },
    /// Revoke a token
    Revoke {
        /// Its name, or its id where several have the name
        which: String,
    },
    /// List the tokens: id, name, roles, end
    List,
}

/// Does it; a running daemon follows within a second.
pub fn run(args: &Args) -> Result<(), Failure> {
    let (place, now) = (&args.place, now());
    let ends = |days: u32| (now, now + f64::from(days) * DAY_S);
    let shown = |made: NewToken| print(&format!("{}\n", made.text));
    match &args.command {
        Command::Create { name, roles: named, days } => {
            shown(place.add(|book| Ok(book.create_token(name, roles(named), ends(*days), secret()?)?))?)
        }
        Command::Rotate { name, days, overlap_minutes } => {
            let until = now + 60.0 * f64::from(*overlap_minutes);
            shown(place.change(|book| Ok(book.rotate_token(name, ends(*days), until, secret()?)?))?)
        }
        Command::Revoke { which } => {
            place.change(|book| Ok(book.revoke_token(which)?))?;
            print(&format!("{which}: revoked\n"))
        }
        Command::List => {
            let mut out = String::new();
            for token in &place.read()?.tokens {
                let over = if token.expires <= now { ", run out" } else { "" };
                // Writing into a String cannot fail.
                let _ = writeln!(
                    out,
                    "{}  {:<24} {}; until {}{over}",
                    token.id,
                    token.name,
                    token.roles,
                    day(token.expires)
                );
            }
            print(&out)
        }
    }
}
