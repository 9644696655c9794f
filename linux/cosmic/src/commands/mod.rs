//! One function for each command.

mod echo;
mod listen;
mod logs;
mod measure;
mod part;
mod served;

use std::process::ExitCode;
use std::time::Duration;

use clap::CommandFactory as _;
use cosmic_core::can::{BitRate, Etag};
use cosmic_core::time::Instant;
use cosmic_linux::{Tapped, What};
use cosmic_monitor::{Monitor, SegmentPlan};

use crate::arguments::{Arguments, Command, Common, LinkChoice};
use crate::failure::Failure;
use crate::output::Output;
use crate::source::{Source, feed};
use crate::top;

pub(crate) use listen::{last, role};

/// What all commands share.
pub(crate) struct Context {
    pub(crate) common: Common,
    pub(crate) plan: Option<SegmentPlan>,
    pub(crate) output: Output,
}

/// Runs a command.
pub(crate) async fn run(arguments: Arguments) -> Result<ExitCode, Failure> {
    let Arguments { common, command } = arguments;
    if let Command::Completions { shell } = command {
        clap_complete::generate(shell, &mut Arguments::command(), "cosmic", &mut std::io::stdout());
        return Ok(ExitCode::SUCCESS);
    }
    let plan = common.cluster.as_ref().map(SegmentPlan::read).transpose();
    let plan = plan.map_err(|refused| Failure::input(refused.to_string()))?;
    let output = Output::new(common.json);
    let mut context = Context { common, plan, output };
    let ended = match command {
        Command::Nodes(options) => listen::nodes(&mut context, &options).await,
        Command::Channels(options) => listen::channels(&mut context, &options).await,
        Command::Doctor(options) => listen::doctor(&mut context, &options).await,
        Command::Echo(options) => echo::echo(&mut context, &options).await,
        Command::Hz(options) => measure::hz(&mut context, &options).await,
        Command::Latency(options) => measure::latency(&mut context, &options).await,
        Command::Top(options) => top::run(&mut context, &options).await,
        Command::Record(options) => logs::record(&mut context, &options).await,
        Command::Replay(options) => logs::replay(&mut context, &options).await,
        Command::Decode { file } => logs::decode(&mut context, &file),
        Command::Sub(options) => part::subscribe(&mut context, &options).await,
        Command::Pub(options) => part::publish(&mut context, &options).await,
        Command::Broker(options) => part::broker(&mut context, &options).await,
        Command::Segment { path } => served::segment(&mut context, &path).await,
        Command::Completions { .. } => Ok(ExitCode::SUCCESS),
    };
    let flushed = context.output.flush();
    let code = ended?;
    flushed?;
    Ok(code)
}

impl Context {
    /// The link or log that was chosen.
    pub(crate) fn link(&self) -> Result<&LinkChoice, Failure> {
        self.common.link.as_ref().ok_or_else(|| {
            Failure::input(
                "no link was given: say --link sim:PATH, or another (see --help), or set COSMIC_LINK",
            )
        })
    }

    /// The bit rate of the segment.
    pub(crate) fn bit_rate(&self) -> BitRate {
        self.plan.as_ref().map_or(self.common.bit_rate, SegmentPlan::bit_rate)
    }

    /// Opens the link or log, and waits for the connection.
    pub(crate) async fn source(&self, span: Option<cosmic_core::time::Duration>) -> Result<Source, Failure> {
        let mut source = Source::open(self.link()?, self.bit_rate())?.for_span(span);
        source.connected(PATIENCE).await?;
        Ok(source)
    }

    /// A monitor that knows the plan.
    pub(crate) fn monitor(&self, now: Instant) -> Monitor {
        match &self.plan {
            Some(plan) => Monitor::with_plan(plan.clone(), now),
            None => Monitor::new(self.common.bit_rate, now),
        }
    }

    /// The channels that were named.
    ///
    /// # Errors
    /// One of the names can be none, whatever the segment says later.
    pub(crate) fn chosen(&self, names: &[String]) -> Result<Chosen, Failure> {
        for name in names {
            let planned = self.plan.as_ref().is_some_and(|plan| plan.channel_named(name).is_some());
            let is_name =
                crate::arguments::subject(name).is_some() || name.parse().ok().and_then(Etag::new).is_some();
            if !planned && !is_name {
                let remedy = match self.plan {
                    Some(_) => "names stand in the cluster file; or give a subject or an etag",
                    None => "give the cluster file by --cluster, or a subject or an etag",
                };
                return Err(Failure::input(format!("there is no channel {name:?}: {remedy}")));
            }
        }
        Ok(Chosen(names.to_vec()))
    }
}

/// The channels that a command looks at.
pub(crate) struct Chosen(Vec<String>);

impl Chosen {
    /// Returns whether this channel is one of them, as far as the monitor knows by now.
    pub(crate) fn has(&self, monitor: &Monitor, etag: Etag) -> bool {
        self.0.is_empty() || self.0.iter().any(|name| monitor.etag_called(name) == Some(etag))
    }
}

/// Feeds a monitor with all that comes, to the end.
async fn listen(source: &mut Source, monitor: &mut Monitor) -> Result<(), Failure> {
    while let Some(tapped) = source.next().await {
        let tapped = tapped?;
        warn(&tapped);
        feed(monitor, &tapped);
    }
    Ok(())
}

/// Says what a person should know of the link.
fn warn(tapped: &Tapped) {
    match &tapped.what {
        What::Disconnected { why, ends: false } => eprintln!("cosmic: {why}; trying again"),
        What::Disconnected { why, ends: true } => eprintln!("cosmic: {why}"),
        _ => {}
    }
}

/// Who listens only need not wait for long.
const PATIENCE: Duration = Duration::from_secs(1);
