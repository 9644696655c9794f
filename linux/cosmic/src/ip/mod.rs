//! Commands across IP: what crosses between segments, at a gateway or a router of zenoh.
//!
//! Whoever listens here is a subscriber to the gateways: they forward what is listened to, while it is. There is no bus, so
//! what looks at frames is refused.

mod events;
mod flows;
mod lists;
mod measure;
mod part;
mod top;
mod words;

use std::process::ExitCode;
use std::time::Duration;

use cosmic_core::Subject;
use cosmic_core::time;
use cosmic_gateway::config::{Ip, Mode, Tls};
use cosmic_gateway::ip::{Heard, Listener};
use cosmic_gateway::keys::Name;

use crate::arguments::{self, Command};
use crate::choice::Endpoint;
use crate::context::Context;
use crate::failure::Failure;
use crate::source::{end_of, sleep_until};

/// Runs a command that takes `--link`.
pub(crate) async fn run(context: &mut Context, at: &Endpoint, command: Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Nodes(options) => lists::nodes(context, at, &options).await,
        Command::Channels(options) => lists::channels(context, at, &options).await,
        Command::Echo(options) => events::echo(context, at, &options).await,
        Command::Hz(options) => measure::hz(context, at, &options).await,
        Command::Latency(options) => measure::latency(context, at, &options).await,
        Command::Top(options) => top::run(context, at, &options).await,
        Command::Sub(options) => part::subscribe(context, at, &options).await,
        Command::Pub(options) => part::publish(context, at, &options).await,
        Command::Serve(_) => Err(Failure::input(
            "`serve` shows a bus: give a link to a segment, or add [page] to the configuration of a gateway, whose page shows \
             what crosses, too",
        )),
        _ => Err(Failure::input(
            "this command looks at the frames of a bus, and IP has none: give a link to a segment, such as --link sim:PATH",
        )),
    }
}

/// What crosses, as it comes.
struct Crossing {
    listener: Listener,
    until: Option<tokio::time::Instant>,
    began: time::Instant,
}

impl Crossing {
    /// Listens to these subjects, or to all, for this span from when it is connected and clocks are known.
    async fn listen(
        context: &Context,
        at: &Endpoint,
        subjects: Option<&[Subject]>,
        span: Option<time::Duration>,
    ) -> Result<Self, Failure> {
        let (ip, network) = network(context, at)?;
        let listener = Listener::start(&ip, &network, subjects).await;
        let mut listener = listener.map_err(|error| Failure::link(error.to_string()))?;
        let connected = tokio::time::timeout(PATIENCE, listener.connected()).await;
        connected.map_err(|_| unreachable_at(at))?;
        // What is left of an event's time is known as soon as its sender's clock is; what came before is not shown.
        let _ = tokio::time::timeout(CLOCKS, clocks(&listener)).await;
        listener.forget();
        let until = end_of(span);
        let began = listener.now();
        Ok(Self { listener, until, began })
    }

    /// The next event; `None` at the end of the span, or when the user interrupts.
    async fn next(&mut self) -> Option<Heard> {
        tokio::select! {
            biased;
            _ = tokio::signal::ctrl_c() => None,
            () = sleep_until(self.until) => None,
            heard = self.listener.next() => Some(heard),
        }
    }

    /// Nanoseconds since the start.
    fn since_start(&self, at: time::Instant) -> u64 {
        at.saturating_since(self.began).as_ticks()
    }

    /// Ends in order. Says what was lost.
    async fn end(self) {
        let lost = self.listener.lost();
        if lost > 0 {
            eprintln!("cosmic: {lost} events came too fast, and are not shown");
        }
        let _ = tokio::time::timeout(PATIENCE, self.listener.stop()).await;
    }
}

async fn clocks(listener: &Listener) {
    loop {
        let participants = listener.participants();
        if !participants.is_empty() && participants.iter().all(|it| it.uncertainty.is_some()) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

fn unreachable_at(at: &Endpoint) -> Failure {
    let how = if at.is_secure() { ", or does not take these certificates" } else { "" };
    Failure::link(format!(
        "nobody answers at {}{how}; look at the option --link, and at `listen` of the gateway",
        at.as_str()
    ))
}

/// How to reach the network, and its name.
fn network(context: &Context, at: &Endpoint) -> Result<(Ip, Name), Failure> {
    let options = &context.common.ip;
    let text = options.network.as_deref().ok_or_else(|| {
        Failure::input("which network? say --network NAME: `network` in the configuration of the gateways")
    })?;
    let network = name(text, "--network")?;
    let given = (&options.authority, &options.certificate, &options.key);
    let tls = match given {
        (Some(authority), Some(certificate), Some(key)) => {
            Some(Tls { authority: authority.clone(), certificate: certificate.clone(), key: key.clone() })
        }
        (None, None, None) => None,
        _ => {
            return Err(Failure::input("certificates are three files: --authority, --certificate and --key"));
        }
    };
    if at.is_secure() && tls.is_none() {
        return Err(Failure::input("\"tls/\" needs certificates: give --authority, --certificate and --key"));
    }
    let connect = vec![at.as_str().to_owned()];
    Ok((Ip { mode: Mode::Peer, connect, tls, ..Ip::default() }, network))
}

fn name(text: &str, option: &str) -> Result<Name, Failure> {
    Name::new(text).ok_or_else(|| {
        Failure::input(format!("{option}: {text:?} is none: write 1 to 32 of a-z, 0-9, '-' and '_'"))
    })
}

/// The subjects of channels that were named; `None` for all.
fn subjects(context: &Context, names: &[String]) -> Result<Option<Vec<Subject>>, Failure> {
    let subject = |name: &String| {
        let plan = context.plan.as_ref();
        let named = plan.and_then(|plan| Subject::new(plan.channel(plan.channel_named(name)?).subject));
        named.or_else(|| arguments::subject(name)).ok_or_else(|| {
            Failure::input(format!(
                "there is no channel {name:?}: give a name of the cluster file by --cluster, or the 16 digits of a subject; \
                 etags do not leave their segment"
            ))
        })
    };
    let all = names.iter().map(subject).collect::<Result<Vec<_>, _>>()?;
    Ok((!all.is_empty()).then_some(all))
}

/// For somebody to answer.
const PATIENCE: Duration = Duration::from_secs(3);
/// For the clocks of all who are there.
const CLOCKS: Duration = Duration::from_secs(1);
