//! The cluster as the judge knows it: nodes, channels, calendar, out of its description.
//!
//! The images must have been built from the same description. The digest of the calendar travels in every sync frame,
//! so images of another plan are found out.

use std::path::{Path, PathBuf};
use std::{fs, io};

use cosmic_core::calendar::Calendar;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::time::Duration;
use cosmic_plan::cluster as described;
use cosmic_plan::document::{Problems, Source};
use cosmic_plan::plan::{Effort, NoPlan, plan};
use thiserror::Error;

/// What the judge has to know of a cluster. Names and calendar live as long as the program, which runs one cluster.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Cluster {
    /// What the segment is called.
    pub name: String,
    /// The file of the description.
    pub file: PathBuf,
    /// When which hard real-time frame may be on the bus.
    pub calendar: &'static Calendar,
    /// How often the time master sends its time; zero in a cluster without clock synchronisation.
    pub sync_period: Duration,
    /// The nodes.
    pub nodes: Vec<Node>,
    /// The event channels; one that several nodes publish on stands here once for each of them.
    pub channels: Vec<Channel>,
    /// The etags of the channels, by their numbers in the plan.
    pub etags: Vec<Etag>,
}

/// A node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Node {
    /// Its name, which is also that of its image.
    pub name: &'static str,
    /// Its short id.
    pub tx_node: TxNode,
}

/// An event channel, as far as one node publishes on it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Channel {
    /// What it is called in tables.
    pub name: &'static str,
    /// Its number in the plan.
    pub number: u16,
    /// Its etag.
    pub etag: Etag,
    /// Its class and what that asks for.
    pub class: Promise,
    /// Who publishes.
    pub publisher: TxNode,
    /// Who subscribes, according to the plan; without the publisher, whose own events never see the bus.
    pub subscribers: Vec<TxNode>,
}

/// What a channel promises: its class, and what that asks for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Promise {
    /// Hard real-time; the calendar says the rest.
    Hard,
    /// Soft real-time.
    Soft {
        /// From publication until an event should have been sent.
        deadline: Duration,
        /// From publication until an event is of no use any more.
        validity: Duration,
    },
    /// Non real-time.
    NonRealTime {
        /// From publication until an event is of no use any more, if ever.
        validity: Option<Duration>,
    },
}

impl Promise {
    /// The class as it stands in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hard => "HRT",
            Self::Soft { .. } => "SRT",
            Self::NonRealTime { .. } => "NRT",
        }
    }
}

/// There is no cluster to be judged.
#[derive(Error, Debug)]
pub enum ClusterError {
    /// The description cannot be read.
    #[error("{} cannot be read ({error}); give the file of a cluster with --cluster", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why not.
        error: io::Error,
    },
    /// The description is wrong.
    #[error("{0}`cosmic-plan check` explains them")]
    Wrong(Problems),
    /// There is no calendar for it.
    #[error("{}: there is no calendar for it; `cosmic-plan check` says why", file.display())]
    NoPlan {
        /// The file.
        file: PathBuf,
    },
    /// Frames of a channel cannot be told from others.
    #[error(
        "channel {channel} gets its etag at run time, so the demo cannot tell its frames: state `binding = \
         \"static\"`"
    )]
    NoEtag {
        /// Which.
        channel: String,
    },
}

impl Cluster {
    /// Reads and plans a description, as the build script of the images does.
    ///
    /// # Errors
    /// [`ClusterError`].
    pub fn read(file: &Path) -> Result<Self, ClusterError> {
        let cluster = description(file)?;
        let no_plan = || ClusterError::NoPlan { file: file.into() };
        let planned = plan(&cluster, &Effort::default()).map_err(|_: NoPlan| no_plan())?;
        let calendar = planned.calendar().map_err(|_| no_plan())?.with_priority_step(cluster.priority_step);
        let nodes = cluster.nodes.iter().map(|node| Node { name: kept(&node.name), tx_node: node.tx_node });
        let etag = |channel: &described::Channel| {
            channel.etag.ok_or_else(|| ClusterError::NoEtag { channel: channel.name.clone() })
        };
        let etags = cluster.channels.iter().map(etag).collect::<Result<Vec<_>, _>>()?;
        let channels = etags.iter().enumerate().flat_map(|(number, etag)| channels(&cluster, number, *etag));
        Ok(Self {
            name: cluster.name.clone(),
            file: file.into(),
            calendar: Box::leak(Box::new(calendar)),
            sync_period: cluster.sync().map_or(Duration::from_ticks(0), |sync| sync.period),
            nodes: nodes.collect(),
            channels: channels.collect(),
            etags,
        })
    }

    /// The node with this id.
    pub fn node(&self, tx_node: TxNode) -> Option<&Node> {
        self.nodes.iter().find(|node| node.tx_node == tx_node)
    }

    /// The name of a node, for messages.
    pub fn name_of(&self, tx_node: TxNode) -> &'static str {
        self.node(tx_node).map_or("another node", |node| node.name)
    }

    /// The channel with this etag; of several publishers the first.
    pub fn channel(&self, etag: Etag) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.etag == etag)
    }

    /// The channel with this etag, as far as this node publishes on it.
    pub fn channel_of(&self, etag: Etag, publisher: TxNode) -> Option<&Channel> {
        self.channels.iter().find(|channel| (channel.etag, channel.publisher) == (etag, publisher))
    }

    /// The etag of a channel, by its number in the plan.
    pub fn etag(&self, number: u16) -> Option<Etag> {
        self.etags.get(usize::from(number)).copied()
    }
}

/// What stands in a description.
///
/// # Errors
/// [`ClusterError::Unreadable`], [`ClusterError::Wrong`].
pub fn description(file: &Path) -> Result<described::Cluster, ClusterError> {
    let unreadable = |error| ClusterError::Unreadable { file: file.into(), error };
    let text = fs::read_to_string(file).map_err(unreadable)?;
    let source = Source::new(file.display().to_string(), text);
    described::Cluster::read(&source).map_err(ClusterError::Wrong)
}

/// A channel of the description, once for each node that publishes on it.
fn channels(cluster: &described::Cluster, number: usize, etag: Etag) -> Vec<Channel> {
    let channel = &cluster.channels[number];
    let publishers: Vec<_> = cluster.publishers(number).collect();
    let class = match (&channel.class, channel.deadline) {
        (described::PlannedClass::Hard { .. }, _) => Promise::Hard,
        (described::PlannedClass::Soft, Some(deadline)) => {
            Promise::Soft { deadline, validity: channel.validity.unwrap_or(FOREVER) }
        }
        // A soft channel without a deadline has that of its period (`cosmic-plan`, the schema).
        (described::PlannedClass::Soft, None) => {
            let deadline = channel.recurrence.span();
            Promise::Soft { deadline, validity: channel.validity.unwrap_or(FOREVER) }
        }
        (described::PlannedClass::NonRealTime { .. }, _) => {
            Promise::NonRealTime { validity: channel.validity }
        }
    };
    let one = |publisher: &&described::Node| {
        let subscribers = cluster.subscribers(number).map(|node| node.tx_node);
        let name = match publishers.len() {
            1 => channel.name.clone(),
            _ => format!("{} ({})", channel.name, publisher.name),
        };
        Channel {
            name: kept(&name),
            number: u16::try_from(number).unwrap_or(u16::MAX),
            etag,
            class,
            publisher: publisher.tx_node,
            subscribers: subscribers.filter(|node| *node != publisher.tx_node).collect(),
        }
    };
    publishers.iter().map(one).collect()
}

fn kept(name: &str) -> &'static str {
    Box::leak(name.to_owned().into_boxed_str())
}

/// No run is as long.
const FOREVER: Duration = Duration::from_secs(1_000_000);

#[cfg(test)]
mod tests {
    use super::*;

    fn example(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../").join(name)
    }

    #[test]
    fn the_example_is_whole() {
        let cluster = Cluster::read(&example("cosmic-plan/examples/vehicle.toml")).unwrap();
        let names: Vec<_> = cluster.channels.iter().map(|channel| channel.name).collect();
        assert_eq!(names, ["wheel_speed", "temperature", "brake_force", "suspension", "logbook"]);
        for channel in &cluster.channels {
            assert!(!channel.subscribers.is_empty(), "{}", channel.name);
            assert_eq!(channel.class == Promise::Hard, channel.etag.is_hard());
            assert!(cluster.node(channel.publisher).is_some());
            assert_eq!(cluster.etag(channel.number), Some(channel.etag));
        }
        let hard = cluster.channels.iter().filter(|channel| channel.class == Promise::Hard);
        assert!(hard.map(|it| it.etag).eq(cluster.calendar.slots().iter().map(|slot| slot.etag)));
    }

    #[test]
    fn a_description_that_is_none_is_named() {
        let error = Cluster::read(&example("none.toml")).unwrap_err().to_string();
        assert!(error.contains("none.toml") && error.contains("--cluster"), "{error}");
        let error = Cluster::read(&example("Cargo.toml")).unwrap_err().to_string();
        assert!(error.contains("Cargo.toml"), "{error}");
    }
}
