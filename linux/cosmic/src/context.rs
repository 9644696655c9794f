//! What all commands share.

use std::process::ExitCode;
use std::time::Duration;

use cosmic_core::can::{BitRate, Etag};
use cosmic_core::time::Instant;
use cosmic_linux::link::LinkAddress;
use cosmic_log::learn_bindings;
use cosmic_monitor::{Monitor, SegmentPlan};

use crate::arguments::Common;
use crate::choice::Choice;
use crate::failure::{FOUND, Failure};
use crate::output::Output;
use crate::source::Source;

/// What all commands share.
pub(crate) struct Context {
    pub(crate) common: Common,
    pub(crate) plan: Option<SegmentPlan>,
    pub(crate) output: Output,
}

impl Context {
    /// The link or log that was chosen.
    pub(crate) fn link(&self) -> Result<&LinkAddress, Failure> {
        match &self.common.link {
            Some(Choice::Bus(address)) => Ok(address),
            Some(Choice::Ip(_)) => {
                Err(Failure::input("this is not done across IP: give a link to a segment"))
            }
            None => Err(Failure::input(
                "no link was given: say --link sim:PATH, or another (see --help), or set COSMIC_LINK",
            )),
        }
    }

    /// How a command ends that was to show something: if there was nothing, it says so and where to look.
    pub(crate) fn ended(&self, any: bool, otherwise: &str) -> ExitCode {
        if any {
            return ExitCode::SUCCESS;
        }
        if !self.output.json() {
            eprintln!("cosmic: {otherwise}");
        }
        ExitCode::from(FOUND)
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

    /// The same; of a log it knows already what etags stand for.
    pub(crate) fn informed_monitor(&self, now: Instant) -> Monitor {
        let mut monitor = self.monitor(now);
        if let Some(Choice::Bus(LinkAddress::Log(file))) = &self.common.link {
            learn_bindings(&mut monitor, file);
        }
        monitor
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

/// Who listens only need not wait for long.
const PATIENCE: Duration = Duration::from_secs(1);
