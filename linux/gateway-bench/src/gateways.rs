//! The role of gateways: those of some configurations, in one process.

use std::collections::BTreeMap;
use std::path::PathBuf;

use cosmic_core::Subject;
use cosmic_gateway::Gateway;
use cosmic_gateway::config::Config;
use cosmic_gateway::counters::{Counters, Direction, Outcome};
use cosmic_gateway::keys::Name;
use serde::{Deserialize, Serialize};

use crate::child::{self, Child};
use crate::cost::Cost;
use crate::failed::Failed;

/// How the gateways of a process are.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct State {
    /// What the process costs so far.
    pub cost: Cost,
    /// How many segments are spoken for.
    pub leading: usize,
    /// Of how many others the gateway knows the clock that knows the fewest.
    pub known: usize,
    /// What became of events, by direction and outcome, of all segments together.
    pub outcomes: BTreeMap<String, u64>,
}

impl State {
    /// What was counted since then, but for what was forwarded.
    pub fn lost_since<'a>(&'a self, before: &'a Self) -> impl Iterator<Item = (&'a str, u64)> {
        self.outcomes.iter().filter_map(|(what, count)| {
            // Counters of a node that has started anew begin anew.
            let more = count.saturating_sub(before.outcomes.get(what).copied().unwrap_or(0));
            (more > 0 && !what.contains(FORWARDED)).then_some((what.as_str(), more))
        })
    }
}

/// Starts a process with the gateways of these configurations, on one core if one is named.
///
/// # Errors
/// A gateway does not start.
pub fn start(files: &[PathBuf], core: Option<usize>) -> Result<Child, Failed> {
    let core = core.map_or_else(|| "any".to_owned(), |core| core.to_string());
    let files = files.iter().map(|file| file.display().to_string());
    Child::start(ROLE, &[core].into_iter().chain(files).collect::<Vec<_>>())
}

/// Asks such a process.
///
/// # Errors
/// It has ended.
pub fn state(child: &mut Child) -> Result<State, Failed> {
    child.ask("state")
}

/// Is such a process.
///
/// # Errors
/// A gateway does not start.
pub fn be(arguments: &[String]) -> Result<(), Failed> {
    let (core, files) = arguments.split_first().ok_or_else(|| Failed("no core is named".to_owned()))?;
    if let Ok(core) = core.parse() {
        pin(core)?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(Failed::at("no threads"))?;
    let mut gateways = Vec::new();
    for file in files {
        let config = Config::read(file.as_ref()).map_err(|problems| Failed(problems.to_string()))?;
        let gateway = runtime.block_on(Gateway::start(&config)).map_err(Failed::at(file))?;
        gateways.push(Running { gateway, config });
    }
    child::serve(|_| Ok(look(&gateways)))?;
    // In order would take its time, and nobody waits for it.
    std::process::exit(0)
}

/// All threads that come later stay on one core.
fn pin(core: usize) -> Result<(), Failed> {
    let mut cores = rustix::thread::CpuSet::new();
    cores.set(core);
    rustix::thread::sched_setaffinity(None, &cores).map_err(Failed::at(format_args!("core {core}")))
}

struct Running {
    gateway: Gateway,
    config: Config,
}

impl Running {
    fn segments(&self) -> impl Iterator<Item = &Name> {
        self.config.segments.iter().map(|segment| &segment.name)
    }

    fn subjects(&self) -> impl Iterator<Item = Subject> {
        self.config.channels.iter().map(|channel| channel.subject)
    }
}

fn look(all: &[Running]) -> State {
    let mut outcomes = BTreeMap::new();
    let mut leading = 0;
    for running in all {
        let Running { gateway, .. } = running;
        for segment in running.segments() {
            leading += usize::from(gateway.leads(segment));
            for (direction, word) in [(Direction::Out, "out"), (Direction::In, "in")] {
                add(&mut outcomes, word, gateway.counters(segment, direction));
            }
            let Some(node) = gateway.node(segment) else { continue };
            let counters = running.subjects().filter_map(|subject| node.channel_counters(subject));
            let expired = counters.map(|counters| u64::from(counters.discarded)).sum::<u64>();
            *outcomes.entry("in: node: expired".to_owned()).or_default() += expired;
        }
        add(&mut outcomes, "in", Some(gateway.unassigned()));
    }
    outcomes.retain(|_, count| *count > 0);
    let known = all.iter().map(|running| running.gateway.others().1).min().unwrap_or(0);
    State { cost: Cost::now(), leading, known, outcomes }
}

fn add(outcomes: &mut BTreeMap<String, u64>, direction: &str, counters: Option<&Counters>) {
    let Some(counters) = counters else { return };
    for outcome in Outcome::ALL {
        *outcomes.entry(format!("{direction}: {outcome:?}")).or_default() += counters.get(*outcome);
    }
}

/// What this process is started as.
pub const ROLE: &str = "gateways";
/// In the outcomes of events that crossed.
const FORWARDED: &str = "Forwarded";
/// In the outcomes of those that were left to another gateway, which had perhaps gone.
pub const PERHAPS_LOST: &str = "PerhapsLost";
