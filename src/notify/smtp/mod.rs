//! Mails: plain text, several alarms in one, by a server of the plant.

mod config;
mod hello;
mod text;

pub use config::{Config, Security};

use super::batch::Digest;
use super::letters::{Letter, Letters};
use super::notice::Source;
use super::postman::{Carrier, Fault, Postman};
use super::state::State;
use super::{http, secret};
use hello::{Server, Unsent};
use lettre::Message;
use lettre::address::Envelope;
use lettre::message::{Mailbox, header::ContentType};
use lettre::transport::smtp::authentication::Credentials;
use lettre::transport::smtp::client::{Certificate, CertificateStore, TlsParameters};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::spawn_blocking;
use tokio::time::timeout;
use tracing::warn;

/// Steps of a conversation with a server: each may take the whole time, all together this many times it.
const STEPS: u32 = 4;

/// Brings mails to one server.
pub struct Mail {
    config: Config,
}

/// The postman of a list of people.
pub fn postman(config: &Config, source: Source, letters: Arc<Letters>, state: Arc<State>) -> Postman<Mail> {
    let carrier = Mail { config: config.clone() };
    let postman = Postman::new(&config.name, carrier, source, letters, state);
    postman.with(&config.events, &config.filter, &config.pace, &config.retry)
}

impl Carrier for Mail {
    /// The subject, an empty line, the text.
    fn compose(&self, digest: &Digest, source: &Source, _now: f64) -> String {
        format!("{}\n\n{}", text::subject(digest, source), text::body(digest, source))
    }

    async fn carry(&self, letter: &Letter) -> Result<(), Fault> {
        let mail = message(&self.config, letter).map_err(Fault::Never)?;
        let config = self.config.clone();
        let later = |why: String| Fault::Later(why, None);
        let made = spawn_blocking(move || server(&config)).await.map_err(|error| later(error.to_string()))?;
        let server = made.map_err(later)?;
        match self.send(&server, mail.envelope(), &mail, true).await? {
            Err(error) if hello::is_unknown(&error) => self.carry_by_helo(&server, &mail, &error).await,
            Err(error) if is_for_good(&error) && self.config.to.len() > 1 => {
                self.carry_to_each(&server, &mail).await
            }
            sent => sent.map_err(fault),
        }
    }
}

/// What is refused for good stays refused.
fn fault(error: Unsent) -> Fault {
    if is_for_good(&error) { Fault::Never(error.to_string()) } else { Fault::Later(error.to_string(), None) }
}

/// A password may be set right without a restart.
fn is_for_good(error: &Unsent) -> bool {
    matches!(error, Unsent::Smtp(error) if error.is_permanent() && !is_login(error))
}

impl Mail {
    /// One conversation, within its time; the outer error is that it took longer.
    async fn send(
        &self,
        server: &Server,
        to: &Envelope,
        mail: &Message,
        knows_ehlo: bool,
    ) -> Result<Result<(), Unsent>, Fault> {
        let limit = STEPS * self.limit();
        let talking = async {
            let mut open = server.connect(knows_ehlo).await?;
            let sent = open.send(to, &mail.formatted()).await;
            open.abort().await;
            sent.map(drop).map_err(Unsent::from)
        };
        let late = |_| Fault::Later(format!("not sent within {} s", limit.as_secs_f64()), None);
        timeout(limit, talking).await.map_err(late)
    }

    /// One address that is refused must not keep the mail from the others.
    async fn carry_to_each(&self, server: &Server, mail: &Message) -> Result<(), Fault> {
        let (mut taken, mut refused) = (false, None);
        for to in mail.envelope().to() {
            let own = Envelope::new(mail.envelope().from().cloned(), vec![to.clone()]);
            let own = own.map_err(|error| Fault::Never(error.to_string()))?;
            match self.send(server, &own, mail, true).await {
                Ok(Ok(())) => taken = true,
                Ok(Err(error)) => {
                    warn!(receiver = self.config.name, to = %to, %error, "an address was refused");
                    refused = Some(fault(error));
                }
                Err(late) => refused = Some(late),
            }
        }
        // Sent again it would come twice to those who have it.
        refused.filter(|_| !taken).map_or(Ok(()), Err)
    }

    /// A server that knows no EHLO has neither encryption nor a log-in to offer.
    async fn carry_by_helo(&self, server: &Server, mail: &Message, refused: &Unsent) -> Result<(), Fault> {
        if self.config.security != Security::None || self.config.login().is_some() {
            let why = format!(
                "{refused}: a server that knows no EHLO can neither encrypt nor take a log-in; name another, or one on this \
                 machine with security = \"none\" and without user"
            );
            return Err(Fault::Later(why, None));
        }
        self.send(server, mail.envelope(), mail, false).await?.map_err(fault)
    }

    fn limit(&self) -> Duration {
        Duration::try_from_secs_f64(self.config.timeout_s).unwrap_or_default()
    }
}

/// Whether it was the log-in that was refused.
fn is_login(error: &lettre::transport::smtp::Error) -> bool {
    error.status().is_some_and(|code| ["530", "534", "535", "538"].contains(&code.to_string().as_str()))
}

fn message(config: &Config, letter: &Letter) -> Result<Message, String> {
    let (subject, text) = letter.body.split_once("\n\n").unwrap_or(("stictiond", &letter.body));
    let mailbox = |text: &String| text.parse::<Mailbox>().map_err(|error| format!("{text:?}: {error}"));
    let mut mail = Message::builder()
        .from(mailbox(&config.from)?)
        .subject(subject)
        .message_id(Some(format!("<{}@stictiond>", letter.id)))
        .header(ContentType::TEXT_PLAIN);
    for to in &config.to {
        mail = mail.to(mailbox(to)?);
    }
    mail.body(text.to_string()).map_err(|error| error.to_string())
}

/// What a conversation needs; reads the secrets.
fn server(config: &Config) -> Result<Server, String> {
    let (host, _) = config.host_and_port()?;
    let starttls = config.security == Security::Starttls;
    let tls = starttls.then(|| parameters(config, &host)).transpose()?;
    let login = match config.login() {
        None => None,
        Some((user, password)) => {
            let password = secret::lines(&password)?.into_iter().next().unwrap_or_default();
            Some(Credentials::new(user, password))
        }
    };
    Ok(Server { config: config.clone(), login, tls })
}

fn parameters(config: &Config, host: &str) -> Result<TlsParameters, String> {
    let mut tls = TlsParameters::builder(host.to_string());
    if config.ca_file.is_some() {
        tls = tls.certificate_store(CertificateStore::None);
        for certificate in http::trusted(config.ca_file.clone())? {
            let certificate =
                Certificate::from_der(certificate.to_vec()).map_err(|error| error.to_string())?;
            tls = tls.add_root_certificate(certificate);
        }
    }
    tls.build().map_err(|error| error.to_string())
}
