//! Commands from west to east, all the time, while the way between is open, cut, and open again.

use std::cell::RefCell;
use std::time::{Duration as Span, Instant};

use cosmic_core::can::Etag;
use cosmic_core::event_layer::{Channel, Policy, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_linux::What;
use serde::Serialize;

use crate::bed::Bed;
use crate::channels::{COMMAND_ETAG, SUBJECTS};
use crate::failed::{Failed, PATIENCE};

/// How long a command is of use.
pub const VALIDITY: Span = Span::from_millis(300);

/// A command: when it was published, and when its frame was on the far bus, in seconds.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Command {
    /// When it was published.
    pub published: f64,
    /// When its frame was on the far bus.
    pub arrived: Option<f64>,
}

/// What became of the commands.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Story {
    /// When the way was cut, and when it healed, in seconds.
    pub cut: (f64, f64),
    /// All commands.
    pub commands: Vec<Command>,
    /// Frames on the far bus beyond one for each command.
    pub twice: usize,
    /// Frames of temperatures that were on the far bus before the cut, and after it: from an emulated sensor to an
    /// emulated brake.
    pub temperatures: (usize, usize),
}

impl Story {
    /// Commands that were stale when the way healed, and reached the far bus all the same.
    pub fn stale(&self) -> Vec<usize> {
        let limit = self.cut.1 - VALIDITY.as_secs_f64();
        let is_stale = |command: &Command| {
            command.published > self.cut.0 + MARGIN && command.published < limit && command.arrived.is_some()
        };
        self.commands.iter().enumerate().filter(|(_, it)| is_stale(it)).map(|(at, _)| at).collect()
    }

    /// Commands that arrived, of those published before the cut, during it, after it.
    pub fn arrived(&self) -> [(usize, usize); 3] {
        let mut parts = [(0, 0); 3];
        for command in &self.commands {
            let part =
                usize::from(command.published >= self.cut.0) + usize::from(command.published >= self.cut.1);
            parts[part].0 += usize::from(command.arrived.is_some());
            parts[part].1 += 1;
        }
        parts
    }

    /// How long after the way had healed the first command arrived, in seconds.
    pub fn back_after(&self) -> Option<f64> {
        let arrivals = self.commands.iter().filter_map(|command| command.arrived);
        arrivals.filter(|at| *at > self.cut.1).min_by(f64::total_cmp).map(|at| at - self.cut.1)
    }
}

/// What was published just before the cut may be under way.
const MARGIN: f64 = 0.1;

fn channel() -> Result<(Channel<u32>, Etag), Failed> {
    let wrong = || Failed("the demo's channels are wrong".to_owned());
    let quality =
        SoftAttributes { deadline: Duration::from_millis(100), validity: Duration::from_millis(300) };
    let etag = Etag::new(COMMAND_ETAG).ok_or_else(wrong)?;
    Ok((Channel::soft(SUBJECTS[0], quality).with_etag(etag), etag))
}

/// What was heard on the far bus.
#[derive(Default)]
struct Heard {
    commands: Vec<Command>,
    twice: usize,
    /// Temperatures before the cut, and since it.
    temperatures: [usize; 2],
    is_after: bool,
}

impl Heard {
    fn command(&mut self, number: u32, at: f64) {
        if let Some(command) = self.commands.get_mut(number as usize) {
            self.twice += usize::from(command.arrived.is_some());
            command.arrived.get_or_insert(at);
        }
    }

    /// A command that was published since then has arrived, and a temperature.
    fn has_come_since(&self, at: f64) -> bool {
        let mut since = self.commands.iter().rev().take_while(|command| command.published >= at);
        since.any(|command| command.arrived.is_some()) && self.temperatures[usize::from(self.is_after)] > 0
    }
}

/// Publishes every 20 ms. The way between is open until something has crossed and for `around` more, is cut, and is open
/// again, as long.
///
/// # Errors
/// A channel is refused, or the way cannot be cut.
pub async fn tell(bed: &mut Bed, around: Span, cut: Span) -> Result<Story, Failed> {
    let (channel, etag) = channel()?;
    let temperature = bed.status_of_east()?.temperature;
    let far = bed.east.node(71)?;
    let _subscriber = far.subscribe(&channel, Policy::Latest).map_err(|error| Failed(error.to_string()))?;
    let near = bed.west.node(72)?;
    let publisher = near.announce(&channel).map_err(|error| Failed(error.to_string()))?;
    publisher.bound().await;
    let tap = bed.east.tap();
    let begun = Instant::now();
    let now = move || begun.elapsed().as_secs_f64();
    let heard = RefCell::new(Heard::default());
    let listen = async {
        loop {
            let What::Frame(frame) = tap.next().await.what else { continue };
            if frame.id.tx_node().get() != GATEWAY {
                continue;
            }
            let mut heard = heard.borrow_mut();
            if frame.id.etag() == etag {
                if let Ok(number) = frame.payload.as_slice().try_into() {
                    heard.command(u32::from_be_bytes(number), now());
                }
            } else if temperature == Some(frame.id.etag().get()) {
                let part = usize::from(heard.is_after);
                heard.temperatures[part] += 1;
            }
        }
    };
    let publish = async {
        loop {
            let number = heard.borrow().commands.len() as u32;
            heard.borrow_mut().commands.push(Command { published: now(), arrived: None });
            // One that is refused does not arrive.
            let _ = publisher.publish(number);
            tokio::time::sleep(Span::from_millis(20)).await;
        }
    };
    // If nothing comes, the judge says so.
    let open = async |since: f64| {
        while !heard.borrow().has_come_since(since) && now() < since + PATIENCE.as_secs_f64() {
            tokio::time::sleep(Span::from_millis(10)).await;
        }
        tokio::time::sleep(around).await;
    };
    let act = async {
        open(0.0).await;
        let from = now();
        bed.between.set_cut(true)?;
        tokio::time::sleep(cut).await;
        let until = now();
        heard.borrow_mut().is_after = true;
        bed.between.set_cut(false)?;
        open(until).await;
        Ok((from, until))
    };
    let cut = tokio::select! {
        () = listen => Err(Failed("nobody listens any more".to_owned())),
        () = publish => Err(Failed("nobody publishes any more".to_owned())),
        cut = act => cut,
    }?;
    let Heard { commands, twice, temperatures: [before, after], .. } = heard.into_inner();
    Ok(Story { cut, commands, twice, temperatures: (before, after) })
}

/// The TxNode of the gateways.
const GATEWAY: u8 = 100;
