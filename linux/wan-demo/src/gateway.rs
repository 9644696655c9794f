//! A gateway in a process of its own, as in life: so it can stand in another network than the demo.
//!
//! The demo starts its own program again, with the configuration; on its standard output the gateway tells how it is, a
//! line of JSON each time. It ends when its standard input does: with the demo, however that ended.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration as Span;

use cosmic_core::can::Etag;
use cosmic_gateway::Gateway;
use cosmic_gateway::config::Config;
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_gateway::keys::Name;
use cosmic_page::{Crossing, Hub};
use serde::{Deserialize, Serialize};
use tokio::io::AsyncReadExt as _;

use crate::channels::TEMPERATURE;
use crate::failed::{Failed, name};

/// How a gateway is.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Status {
    /// How often it has told.
    pub told: u64,
    /// It speaks for its segment.
    pub leads: bool,
    /// Of how many others it knows the clock.
    pub known: usize,
    /// The etag of temperatures on its segment.
    pub temperature: Option<u16>,
    /// What became of events.
    pub outcomes: Vec<(String, u64)>,
    /// Events since it told last, if they are wanted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub crossed: Vec<Crossing>,
}

/// A gateway that runs. It ends when this is dropped.
pub struct Process {
    segment: &'static str,
    child: Child,
    status: Arc<Mutex<Status>>,
    /// Who is told what crosses.
    hub: Arc<OnceLock<Hub>>,
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Process {
    /// Starts the program that `command` runs as the gateway of a segment, and waits until it is there; it does nothing yet.
    ///
    /// # Errors
    /// It cannot be run, or ends.
    pub fn start(
        mut command: Command,
        segment: &'static str,
        config: &Path,
        watched: bool,
    ) -> Result<Self, Failed> {
        command.arg("--gateway").arg(config).arg("--segment").arg(segment);
        if watched {
            command.arg("--watched");
        }
        let started = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut child = started.map_err(|error| Failed(format!("a gateway cannot be started: {error}")))?;
        let status = Arc::new(Mutex::new(Status::default()));
        let output = child.stdout.take();
        let process = Self { segment, child, status, hub: Arc::default() };
        let mut lines = BufReader::new(output.ok_or_else(|| process.ended())?).lines().map_while(Result::ok);
        if lines.next().as_deref() != Some(HERE) {
            return Err(process.ended());
        }
        let (status, hub) = (Arc::clone(&process.status), Arc::clone(&process.hub));
        std::thread::spawn(move || {
            for mut told in lines.filter_map(|line| serde_json::from_str::<Status>(&line).ok()) {
                let crossed = std::mem::take(&mut told.crossed);
                if let Some(hub) = hub.get() {
                    crossed.into_iter().for_each(|crossing| hub.crossed(crossing));
                }
                *lock(&status) = told;
            }
        });
        Ok(process)
    }

    /// Tells a page what crosses, from now on, if it was started so.
    pub fn watch(&self, hub: &Hub) {
        // It is told once.
        let _ = self.hub.set(hub.clone());
    }

    /// Its number to the kernel.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Lets it begin: its configuration is there.
    ///
    /// # Errors
    /// It has ended.
    pub fn begin(&mut self) -> Result<(), Failed> {
        let told = self.child.stdin.as_mut().map(|input| input.write_all(b"\n"));
        if matches!(told, Some(Ok(()))) { Ok(()) } else { Err(self.ended()) }
    }

    /// How it was when it told last.
    ///
    /// # Errors
    /// It has ended.
    pub fn status(&mut self) -> Result<Status, Failed> {
        match self.child.try_wait() {
            Ok(None) => Ok(lock(&self.status).clone()),
            _ => Err(self.ended()),
        }
    }

    fn ended(&self) -> Failed {
        Failed(format!("the gateway of the {} has ended; see above", self.segment))
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Is a gateway: what the process does that was started so. Ends with its standard input.
///
/// # Errors
/// The configuration is wrong, or the gateway cannot start or go on.
pub async fn be(config: &Path, segment: &str, watched: bool) -> Result<(), Failed> {
    let tell = |line: &str| writeln!(std::io::stdout(), "{line}").is_ok();
    tell(HERE);
    let mut input = tokio::io::stdin();
    let mut byte = [0];
    if !matches!(input.read(&mut byte).await, Ok(1)) {
        return Ok(());
    }
    let segment = name(segment)?;
    let config = Config::read(config).map_err(|problems| Failed(problems.to_string()))?;
    let crossed = Arc::new(Mutex::new(Vec::new()));
    let started = if watched {
        let all = Arc::clone(&crossed);
        let watch = move |crossing: &cosmic_gateway::Crossing<'_>, outcome| {
            let mut all = lock(&all);
            if all.len() < MOST_CROSSED {
                all.push(cosmic_gateway::shown(crossing, outcome));
            }
        };
        Gateway::start_watched(&config, Box::new(watch)).await
    } else {
        Gateway::start(&config).await
    };
    let mut gateway = started.map_err(|error| Failed(error.to_string()))?;
    let mut ticks = tokio::time::interval(Span::from_millis(50));
    let mut told = 0;
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            // Who has started it is gone, or wants it to end.
            read = input.read(&mut byte) => if !matches!(read, Ok(1)) { break },
            error = gateway.ended() => return Err(Failed(error.to_string())),
        }
        told += 1;
        let crossed = std::mem::take(&mut *lock(&crossed));
        let line = serde_json::to_string(&Status { crossed, ..status(&gateway, &segment, told) });
        if !tell(&line.map_err(|error| Failed(error.to_string()))?) {
            break;
        }
    }
    gateway.stop().await;
    Ok(())
}

fn status(gateway: &Gateway, segment: &Name, told: u64) -> Status {
    let temperature = gateway.node(segment).and_then(|node| node.etag_of(TEMPERATURE)).map(Etag::get);
    Status {
        told,
        leads: gateway.leads(segment),
        known: gateway.others().1,
        temperature,
        outcomes: outcomes(gateway, segment),
        crossed: Vec::new(),
    }
}

/// What became of events; outcomes that did not happen are left out.
fn outcomes(gateway: &Gateway, segment: &Name) -> Vec<(String, u64)> {
    let mut all = Vec::new();
    let directions = [(Direction::Out, "out of"), (Direction::In, "into")];
    for (direction, word) in directions {
        let Some(counters) = gateway.counters(segment, direction) else { continue };
        all.extend(Outcome::ALL.iter().map(|it| (format!("{word} {segment}: {it:?}"), counters.get(*it))));
    }
    let of_ip = gateway.unassigned();
    all.extend(Outcome::ALL.iter().map(|it| (format!("from IP at {segment}: {it:?}"), of_ip.get(*it))));
    all.retain(|(_, count)| *count > 0);
    all
}

/// The first line: the process is there, in its network.
const HERE: &str = "here";
/// So many events are told at once, at most.
const MOST_CROSSED: usize = 1_000;
