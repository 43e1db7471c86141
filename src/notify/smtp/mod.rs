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
use lettre::address::{Address, Envelope};
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
    /// Where it is noted who lacks a mail that others have.
    letters: Arc<Letters>,
}

/// The postman of a list of people.
pub fn postman(config: &Config, source: Source, letters: Arc<Letters>, state: Arc<State>) -> Postman<Mail> {
    let carrier = Mail { config: config.clone(), letters: letters.clone() };
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
        if letter.lacking.is_empty() {
            match self.send(&server, mail.envelope(), &mail).await? {
                Err(error) if is_answer(&error) && self.config.to.len() > 1 => {}
                sent => return sent.map_err(fault),
            }
        }
        self.carry_to_each(&server, &mail, letter).await
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

/// Whether the server said no to something other than the log-in: that may be one address, for which the library gives up all.
fn is_answer(error: &Unsent) -> bool {
    matches!(error, Unsent::Smtp(error) if error.status().is_some() && !is_login(error))
}

impl Mail {
    /// One conversation, by HELO where the server knows no EHLO; the outer error is that there was none.
    async fn send(
        &self,
        server: &Server,
        to: &Envelope,
        mail: &Message,
    ) -> Result<Result<(), Unsent>, Fault> {
        match self.talk(server, to, mail, true).await? {
            Err(error) if hello::is_unknown(&error) => {
                self.is_helo_enough(&error)?;
                self.talk(server, to, mail, false).await
            }
            sent => Ok(sent),
        }
    }

    /// One conversation, within its time; the outer error is that it took longer.
    async fn talk(
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
            Ok::<_, Unsent>((open, sent))
        };
        let late = |_| Fault::Later(format!("not sent within {} s", limit.as_secs_f64()), None);
        let (mut open, sent) = match timeout(limit, talking).await.map_err(late)? {
            Ok(talked) => talked,
            Err(error) => return Ok(Err(error)),
        };
        // A server that has taken the mail and does not say goodbye must not be sent it again.
        let _ = timeout(self.limit(), open.abort()).await;
        Ok(sent.map(drop).map_err(Unsent::from))
    }

    /// One address that is refused must not keep the mail from the others. Once somebody has it, who refused it for good is left
    /// out, and who may take it another time is noted as lacking it: sent to all again it would come twice.
    async fn carry_to_each(&self, server: &Server, mail: &Message, letter: &Letter) -> Result<(), Fault> {
        let (mut taken, mut refused, mut lacking) = (!letter.lacking.is_empty(), None, Vec::new());
        let to = mail.envelope().to();
        let wanted = |to: &&Address| letter.lacking.is_empty() || letter.lacking.contains(&to.to_string());
        let wanted: Vec<&Address> = to.iter().filter(wanted).collect();
        let names = |some: &[&Address]| some.iter().map(ToString::to_string).collect::<Vec<_>>();
        for (at, to) in wanted.iter().enumerate() {
            let Err((fault, answered)) = self.carry_to(server, mail, to).await else {
                taken = true;
                // Noted at once: an end of the daemon between two addresses sends it to nobody twice.
                let still = [lacking.clone(), names(&wanted[at + 1..])].concat();
                self.lack(letter, still).await?;
                continue;
            };
            let later = matches!(fault, Fault::Later(..));
            if letter.attempts == 0 || !later {
                warn!(receiver = self.config.name, to = %to, ?fault, "an address was refused");
            }
            lacking.extend(later.then(|| to.to_string()));
            // It is tried again as long as one address may take it.
            if later || refused.is_none() {
                refused = Some(fault);
            }
            if !answered {
                // Without an answer the others would wait as long, and everything behind this mail.
                lacking.extend(names(&wanted[at + 1..]));
                break;
            }
        }
        match refused {
            Some(fault) if !taken => Err(fault),
            Some(Fault::Later(why, pause)) => {
                let why = format!("not taken for {} of {} addresses: {why}", lacking.len(), to.len());
                self.lack(letter, lacking).await?;
                Err(Fault::Later(why, pause))
            }
            _ => Ok(()),
        }
    }

    /// Notes who does not have a letter yet, if anybody.
    async fn lack(&self, letter: &Letter, lacking: Vec<String>) -> Result<(), Fault> {
        if lacking.is_empty() {
            return Ok(());
        }
        let (letters, id) = (self.letters.clone(), letter.id.clone());
        let noted = spawn_blocking(move || letters.lack(&id, lacking)).await;
        noted.map_err(|error| Fault::Later(error.to_string(), None))
    }

    /// The mail for one address alone; an error comes with whether the server answered.
    async fn carry_to(&self, server: &Server, mail: &Message, to: &Address) -> Result<(), (Fault, bool)> {
        let own = Envelope::new(mail.envelope().from().cloned(), vec![to.clone()]);
        let own = own.map_err(|error| (Fault::Never(error.to_string()), true))?;
        let sent = self.send(server, &own, mail).await.map_err(|late| (late, false))?;
        sent.map_err(|error| {
            let answered = is_answer(&error);
            (fault(error), answered)
        })
    }

    /// A server that knows no EHLO has neither encryption nor a log-in to offer.
    fn is_helo_enough(&self, refused: &Unsent) -> Result<(), Fault> {
        if self.config.security == Security::None && self.config.login().is_none() {
            return Ok(());
        }
        let why = format!(
            "{refused}: a server that knows no EHLO can neither encrypt nor take a log-in; name another, or one on this \
             machine with security = \"none\" and without user"
        );
        Err(Fault::Later(why, None))
    }

    fn limit(&self) -> Duration {
        Duration::try_from_secs_f64(self.config.timeout_s).unwrap_or_default()
    }
}

/// Whether it was the log-in that was refused, for now or for good.
fn is_login(error: &lettre::transport::smtp::Error) -> bool {
    error
        .status()
        .is_some_and(|code| ["454", "530", "534", "535", "538"].contains(&code.to_string().as_str()))
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

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
    use tokio::net::{TcpListener, TcpStream};

    /// A server that takes one mail and does not answer the farewell; what it was sent as the text.
    async fn takes_and_is_silent(stream: TcpStream) -> Vec<String> {
        let (read, mut write) = stream.into_split();
        let mut lines = BufReader::new(read).lines();
        write.write_all(b"220 mail\r\n").await.unwrap();
        let (mut text, mut is_text) = (Vec::new(), false);
        while let Ok(Some(line)) = lines.next_line().await {
            let said = match line.as_str() {
                "." => "250 taken\r\n",
                "DATA" => "354 go on\r\n",
                "QUIT" => continue,
                _ if is_text => {
                    text.push(line);
                    continue;
                }
                _ => "250 well\r\n",
            };
            is_text = line == "DATA";
            write.write_all(said.as_bytes()).await.unwrap();
        }
        text
    }

    #[tokio::test]
    async fn a_mail_that_was_taken_is_sent_though_nobody_says_goodbye() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let config = format!(
            "name = 'm'\naddress = '{}'\nsecurity = 'none'\nfrom = 'a@plant.example'\nto = ['b@plant.example']\n\
             timeout_s = 1.0\n",
            listener.local_addr().unwrap()
        );
        let config = toml::from_str(&config).unwrap();
        let mail = Mail { config, letters: Arc::new(Letters::open(None, 5)) };
        let letter = Letter::new("a valve sticks\n\nFIC101".into(), 0.0).unwrap();
        let answering = tokio::spawn(async move {
            let (stream, _) = listener.accept().await.unwrap();
            takes_and_is_silent(stream).await
        });
        assert_eq!(mail.carry(&letter).await, Ok(()));
        assert!(answering.await.unwrap().contains(&"FIC101".to_string()));
    }
}
