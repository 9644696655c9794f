//! Random segments with a plan, random questions, and the exact test: the analysis of the planner.

use crate::random::Random;
use anyhow::{Context as _, anyhow};
use cosmic_core::admission::{AdmissionPlan, PlannedPublication, Unplanned};
use cosmic_core::calendar::Calendar;
use cosmic_core::event_layer::{EventRate, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};
use cosmic_plan::analysis::reserved::Reserved;
use cosmic_plan::analysis::segment::assess;
use cosmic_plan::cluster::{Channel, Cluster, PlannedClass, Recurrence};
use cosmic_plan::document::Source;
use cosmic_plan::plan::{Effort, Plan, plan};
use std::fmt::Write as _;

/// A segment, its plan, and what its nodes are told of both.
pub(super) struct Planned {
    pub(super) cluster: Cluster,
    plan: Plan,
    pub(super) calendar: &'static Calendar,
    pub(super) admission: &'static AdmissionPlan,
    /// How many times slower than 1 Mbit/s its bus is.
    pub(super) scale: u64,
}

/// What a node asks for, or publishes by plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offered {
    pub(super) subject: Subject,
    pub(super) rate: EventRate,
    pub(super) deadline: Duration,
    /// 2, 5 or 8.
    pub(super) len: u8,
}

impl Offered {
    pub(super) fn attributes(&self) -> SoftAttributes {
        // Long enough that no event is discarded: whatever is late is seen on the bus.
        SoftAttributes {
            deadline: self.deadline,
            validity: Duration::from_ticks(self.deadline.as_ticks() * 20),
        }
    }

    /// What is asked for at random: alone it mostly fits, but not a dozen of them.
    pub(super) fn drawn(random: &mut Random, subject: u64, scale: u64) -> anyhow::Result<Self> {
        let interval = (500 + random.below(4_500)) * scale;
        let jitter = random.below(1_000) * scale;
        let burst = 1 + random.below(3) as u8;
        let rate = EventRate::sporadic(Duration::from_micros(interval)).with_burst(burst);
        Ok(Self {
            subject: Subject::new(subject).context("a subject that is not zero")?,
            rate: rate.with_jitter(Duration::from_micros(jitter)),
            deadline: Duration::from_micros((500 + random.below(7_500)) * scale),
            len: length(random),
        })
    }
}

fn length(random: &mut Random) -> u8 {
    [2, 5, 8][random.below(3) as usize]
}

impl Planned {
    /// A segment whose plan keeps all its promises; others are drawn until one does.
    pub(super) fn drawn(random: &mut Random) -> anyhow::Result<Self> {
        loop {
            if let Some(planned) = Self::try_drawn(random)? {
                return Ok(planned);
            }
        }
    }

    fn try_drawn(random: &mut Random) -> anyhow::Result<Option<Self>> {
        let scale = [1, 2, 4][random.below(3) as usize];
        let text = description(random, scale)?;
        let cluster =
            Cluster::read(&Source::new("random.toml", text)).map_err(|problems| anyhow!("{problems}"))?;
        let Ok(plan) = plan(&cluster, &Effort::default()) else { return Ok(None) };
        if !assess(&cluster, &plan).holds() {
            return Ok(None);
        }
        let calendar = plan.calendar().map_err(|error| anyhow!("the calendar: {error:?}"))?;
        let calendar = Box::leak(Box::new(calendar.with_priority_step(cluster.priority_step)));
        // As constants in an image: they live as long as the program.
        let reserved: &'static Reserved = Box::leak(Box::new(Reserved::of(&cluster, &plan)));
        let publisher = NodeUid::new(cluster.nodes[PUBLISHER].uid).context("a UID that is not zero")?;
        let planned = soft_channels(&cluster).map(|(_, of)| PlannedPublication {
            publisher,
            subject: of.subject,
            rate: of.rate,
            deadline: of.deadline,
            len: of.len,
        });
        let planned = planned.collect::<Vec<_>>().leak();
        let reservations = reserved.reservations();
        let admission = AdmissionPlan { unplanned: Unplanned::Ask, planned, reservations };
        let admission = Box::leak(Box::new(admission));
        Ok(Some(Self { cluster, plan, calendar, admission, scale }))
    }

    /// Whether the analysis accepts these besides what is planned.
    pub(super) fn holds_with<'o>(&self, offered: impl Iterator<Item = &'o Offered>) -> bool {
        let mut all = self.cluster.clone();
        let Some(like) = self.cluster.channels.iter().find(|channel| channel.class == PlannedClass::Soft)
        else {
            return false;
        };
        for of in offered {
            all.nodes[PUBLISHER].publishes.push(all.channels.len());
            all.channels.push(Channel {
                name: format!("asked{}", all.channels.len()),
                subject: of.subject.get(),
                etag: None,
                length: of.len.into(),
                recurrence: Recurrence::Sporadic(of.rate.interval()),
                burst: 1,
                jitter: of.rate.tolerance(),
                deadline: Some(of.deadline),
                ..like.clone()
            });
        }
        assess(&all, &self.plan).holds()
    }
}

/// The planned soft real-time channels, as their publisher offers them, with their places in the cluster.
pub(super) fn soft_channels(cluster: &Cluster) -> impl Iterator<Item = (usize, Offered)> {
    let soft = cluster.channels.iter().enumerate().filter(|(_, channel)| channel.class == PlannedClass::Soft);
    soft.filter_map(|(at, channel)| {
        let rate = EventRate::sporadic(channel.recurrence.span()).with_burst(channel.burst);
        let offered = Offered {
            subject: Subject::new(channel.subject)?,
            rate: rate.with_jitter(channel.jitter),
            deadline: channel.deadline?,
            len: u8::try_from(channel.length).ok()?,
        };
        Some((at, offered))
    })
}

/// Some hard channels, some soft ones, a non real-time one with a deadline now and then.
fn description(random: &mut Random, scale: u64) -> anyhow::Result<String> {
    let mut text = format!(
        "[segment]\nname = 's'\nbit_rate = '{} kbit/s'\nclock_accuracy = '60 us'\nrelease_jitter = '10 us'\n",
        1_000 / scale
    );
    let (hard, soft, low) = (random.below(3), 1 + random.below(4), random.below(2));
    let names: Vec<String> = (0..hard + soft + low).map(|at| format!("'c{at}'")).collect();
    for (at, name) in NODES.iter().enumerate() {
        let publishes = if at == PUBLISHER { names.join(", ") } else { String::new() };
        writeln!(
            text,
            "[[node]]\nname = '{name}'\nuid = {}\npublishes = [{publishes}]",
            FIRST_UID + at as u64
        )?;
    }
    for at in 0..hard + soft + low {
        let (name, subject) = (format!("c{at}"), at + 1);
        let length = if at < hard { 8 } else { length(random) };
        write!(text, "[[channel]]\nname = '{name}'\nsubject = {subject}\nlength = {length}\n")?;
        if at < hard {
            writeln!(text, "class = 'HRT'\nperiod = '{} ms'", 20 * scale)?;
        } else if at < hard + soft {
            let period = (3 + random.below(17)) * scale;
            let (jitter, deadline) = (random.below(800) * scale, (2 + random.below(40)) * scale);
            writeln!(
                text,
                "class = 'SRT'\nmin_interarrival = '{period} ms'\nburst = {}",
                1 + random.below(2)
            )?;
            writeln!(text, "jitter = '{jitter} us'\ndeadline = '{deadline} ms'")?;
        } else {
            writeln!(
                text,
                "class = 'NRT'\nmin_interarrival = '{0} ms'\ndeadline = '{1} ms'",
                60 * scale,
                40 * scale
            )?;
        }
    }
    Ok(text)
}

/// The nodes: two that host brokers, one that publishes by plan, and those that ask.
pub(super) const NODES: [&str; 6] = ["first", "second", "planned", "a", "b", "c"];

/// Which of them publishes by plan.
pub(super) const PUBLISHER: usize = 2;

/// How many of them host brokers.
pub(super) const BROKERS: usize = 2;

const FIRST_UID: u64 = 0xC05_0001;
