//! What is wrong with a segment, and what to do about it.

use std::fmt;

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::protocol::NodeState;
use cosmic_core::time::{Duration, Instant};
use serde::Serialize;

use crate::monitor::Monitor;
use crate::plan::SegmentPlan;
use crate::slots::Standing;
use crate::suspects::named;

/// Something that is wrong.
#[derive(Clone, PartialEq, Eq, Serialize, Debug)]
pub struct Finding {
    /// Which rule found it.
    pub rule: Rule,
    /// How bad it is.
    pub severity: Severity,
    /// The nodes that it concerns.
    pub nodes: Vec<u8>,
    /// The channel that it concerns.
    pub etag: Option<u16>,
    /// A sentence: what was seen.
    pub what: String,
    /// What to do.
    pub remedy: &'static str,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.rule.name(), self.what)
    }
}

/// How bad something is.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Debug)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// The segment does not keep its promises.
    Error,
    /// It may soon not, or this listener cannot tell.
    Warning,
}

macro_rules! rules {
    ($($(#[$doc:meta])+ $rule:ident = $name:literal, $severity:ident, $remedy:literal;)+) => {
        /// What is looked for.
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Serialize, Debug)]
        #[serde(rename_all = "kebab-case")]
        #[non_exhaustive]
        pub enum Rule {
            $($(#[$doc])+ $rule,)+
        }

        impl Rule {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$rule),+];

            /// What it is called.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$rule => $name,)+ }
            }

            /// How bad it is when it applies.
            pub const fn severity(self) -> Severity {
                match self { $(Self::$rule => Severity::$severity,)+ }
            }

            /// What to do.
            pub const fn remedy(self) -> &'static str {
                match self { $(Self::$rule => $remedy,)+ }
            }
        }
    };
}

rules! {
    /// No frame of any kind has arrived, or none for seconds.
    NothingReceived = "nothing received", Error,
        "look at the wiring and the two terminating resistors, whether the link is the right one, and whether a node has power";
    /// The controller sees frames that it cannot read.
    WrongBitRate = "wrong bit rate", Error,
        "give the link the bit rate of the segment; with two nodes of different rates on the bus, flash both from one plan";
    /// The link's own controller has left the bus.
    BusOff = "bus-off", Error,
        "look at the wiring between this link and the bus, and give the link the bit rate of the segment";
    /// Nobody acknowledges what the link or a node sends.
    NoAcknowledgement = "no acknowledgement", Error,
        "a sender needs one other node that is on and not only listening: power one up, or look at the wiring between them";
    /// Two brokers are active at once, or answer differently.
    TwoBrokers = "two brokers", Error,
        "of two COSMIC brokers one stays as soon as they hear each other: look for the node that hears only part of the bus. \
         An old FAMOUSO broker does not yield: switch it off";
    /// Two calendars are in use.
    TwoCalendars = "two calendars", Error,
        "build and flash all nodes from one cluster file, and give this program the same file";
    /// Hard real-time is inhibited, or no time master is heard, or global time has jumped.
    ClockOutOfBound = "clock out of bound", Error,
        "look at the time master: is it on, does it get its frames through, is its oscillator as good as planned? With two \
         time scales on the bus, restart the node that does not follow";
    /// A frame of priority 0 without a slot, or outside of it.
    UnplannedHard = "unplanned frame at priority 0", Error,
        "only slots of the calendar may use priority 0: find the sender by its TxNode, take it off the bus, and plan its \
         channel or send it as a soft real-time one";
    /// Two nodes use one TxNode or one UID.
    DuplicateNode = "duplicate node", Error,
        "give each node a UID of its own, and a TxNode of its own if it is fixed; the second one was probably flashed with \
         the image of the first";
    /// A node publishes on a channel for which the plan does not name it.
    UnplannedPublisher = "unplanned publisher", Warning,
        "add the channel to the node's `publishes` in the cluster file and build anew, or stop the node";
    /// A publisher sends much more than its plan allows.
    Babbling = "babbling channel", Error,
        "the node publishes more often than planned: look at what calls `publish`, and stop the node if it disturbs others";
    /// A node of the plan is not heard.
    SilentNode = "silent node", Error,
        "look at its power and wiring; if it is meant to be away, this is no fault";
    /// A controller has counted so many errors that it no longer takes full part.
    ErrorPassive = "node near bus-off", Warning,
        "look at its wiring and bit rate: it alone sees or makes these errors";
    /// Hardly any time is left on the bus.
    BusFull = "bus is full", Warning,
        "the least urgent frames wait long or expire: publish less, or plan a faster bus";
    /// Frames were lost before they arrived at this listener.
    LostHere = "frames lost here", Warning,
        "what is shown is incomplete: use a faster link, or give this program more of the processor";
}

impl Monitor {
    /// What is wrong with the segment at `now`, the worst first.
    pub fn doctor(&mut self, now: Instant) -> Vec<Finding> {
        let now = self.refresh(now);
        let mut findings = Vec::new();
        self.look_at_link(now, &mut findings);
        self.look_at_brokers(now, &mut findings);
        self.look_at_clock(now, &mut findings);
        self.look_at_nodes(now, &mut findings);
        self.look_at_frames(now, &mut findings);
        self.look_at_rates(now, &mut findings);
        findings.sort_by_key(|finding| finding.severity);
        findings
    }

    fn look_at_link(&self, now: Instant, findings: &mut Vec<Finding>) {
        let link = &self.link;
        let since = now.saturating_since(link.last_at.unwrap_or(self.started));
        let errors = link.errors.unwrap_or_default();
        if link.bus_off_at.is_some_and(|at| now.saturating_since(at) <= SHOWN) {
            let what = format!("the controller of this link has left the bus {} times", link.bus_off);
            findings.push(finding(Rule::BusOff, what));
        }
        let silent = since >= NOTHING;
        let seconds = since.as_millis() as f64 / 1e3;
        // Who is not acknowledged counts transmit errors up to the limit; who cannot read what others send counts
        // receive errors.
        if silent && errors.receive >= ERROR_WARNING {
            let what = format!("no frame for {seconds:.1} s, and {} receive errors", errors.receive);
            findings.push(finding(Rule::WrongBitRate, what));
        } else if errors.transmit >= ERROR_PASSIVE {
            let what = format!("the controller of this link counts {} transmit errors", errors.transmit);
            findings.push(finding(Rule::NoAcknowledgement, what));
        } else if silent {
            findings.push(finding(Rule::NothingReceived, format!("no frame for {seconds:.1} s")));
        }
        if link.lost > 0 {
            findings.push(finding(Rule::LostHere, format!("{} frames did not arrive here", link.lost)));
        }
    }

    fn look_at_brokers(&self, now: Instant, findings: &mut Vec<Finding>) {
        if let Some((one, other)) = self.brokers.two(now) {
            let what = format!("{} and {} are both active brokers", self.named(one), self.named(other));
            findings.push(finding(Rule::TwoBrokers, what).of(&[one, other]));
        } else if let Some((subject, one, other)) = self.brokers.contradiction(now) {
            let what =
                format!("subject {subject} was bound to etag {} and then to {}", one.get(), other.get());
            findings.push(finding(Rule::TwoBrokers, what));
        }
    }

    fn look_at_clock(&self, now: Instant, findings: &mut Vec<Finding>) {
        let calendars = self.suspects.two_calendars(self.plan.as_ref(), now);
        let mismatch = calendars.is_some();
        if let Some((nodes, what)) = calendars {
            findings.push(Finding { nodes, ..finding(Rule::TwoCalendars, what) });
        }
        // A node without slots, such as a gateway's, loses nothing by it.
        let has_slots = |tx_node: TxNode| {
            let of_node = |plan: &SegmentPlan| plan.slots().iter().any(|it| it.slot.publisher == tx_node);
            self.plan.as_ref().is_none_or(of_node)
        };
        let inhibited = self.nodes.iter().filter(|(tx_node, node)| {
            let state = node.status.map(|(status, _)| status.state);
            node.alive && state == Some(NodeState::HardInhibited) && has_slots(*tx_node)
        });
        for (tx_node, _) in inhibited.filter(|_| !mismatch) {
            let what = format!(
                "{} keeps silent in its slots: its clock is less accurate than the calendar allows, or its calendar is not \
                 the time master's",
                self.named(tx_node)
            );
            findings.push(finding(Rule::ClockOutOfBound, what).of(&[tx_node]));
        }
        if let Some((from, by, at)) = self.suspects.step
            && now.saturating_since(at) <= SHOWN
        {
            let what = format!("global time of {} jumped by {:.6} s", self.named(from), by as f64 / 1e9);
            findings.push(finding(Rule::ClockOutOfBound, what).of(&[from]));
        }
        let period = self.plan.as_ref().and_then(|plan| plan.cluster().sync_period);
        let last = self.clock.last().map_or(self.started, |sync| sync.at);
        let silent = now.saturating_since(last);
        if self.link.received > 0
            && period.is_some_and(|period| {
                silent.as_ticks() > period.as_ticks().saturating_mul(20).max(NOTHING.as_ticks())
            })
        {
            let what = format!("no time master for {:.1} s", silent.as_millis() as f64 / 1e3);
            findings.push(finding(Rule::ClockOutOfBound, what));
        }
    }

    fn look_at_nodes(&self, now: Instant, findings: &mut Vec<Finding>) {
        for (tx_node, node) in self.nodes.iter() {
            if let Some(claims) = node.duplicate(now) {
                let what = match claims {
                    Some((one, other)) => format!("{one} and {other} both claim TxNode {tx_node}"),
                    None => format!(
                        "somebody else uses TxNode {tx_node}: its node claims it again and again, or its statuses are \
                         those of two nodes"
                    ),
                };
                findings.push(finding(Rule::DuplicateNode, what).of(&[tx_node]));
            }
            let other = node.uid().filter(|_| node.sends_status(now));
            let other = other.and_then(|uid| Some((uid, self.nodes.other_with(uid, tx_node, now)?)));
            if let Some((uid, other)) = other.filter(|(_, other)| *other > tx_node) {
                let what = format!("TxNodes {tx_node} and {other} both have UID {uid}");
                findings.push(finding(Rule::DuplicateNode, what).of(&[tx_node, other]));
            }
            let Some((status, _)) = node.status.filter(|_| node.alive) else { continue };
            let errors = status.transmit_errors.max(status.receive_errors);
            if errors >= ERROR_WARNING {
                let (tec, rec) = (status.transmit_errors, status.receive_errors);
                let what = format!("{} counts {tec} transmit and {rec} receive errors", self.named(tx_node));
                findings.push(finding(Rule::ErrorPassive, what).of(&[tx_node]));
            }
        }
        // When nothing at all is heard, each node's silence is no news.
        let hears = self.link.last_at.is_some_and(|at| now.saturating_since(at) < NOTHING);
        let Some(plan) = self.plan.as_ref().filter(|_| hears) else { return };
        for node in &plan.cluster().nodes {
            let seen = self.nodes.get(node.tx_node);
            let silent = now.saturating_since(seen.map_or(self.started, |seen| seen.heard_at));
            if !seen.is_some_and(|seen| seen.alive) && silent >= SILENT_NODE {
                let what = match seen {
                    Some(_) => {
                        format!("{} was last heard {} s ago", self.named(node.tx_node), silent.as_secs())
                    }
                    None => {
                        format!("{} was never heard, for {} s", self.named(node.tx_node), silent.as_secs())
                    }
                };
                findings.push(finding(Rule::SilentNode, what).of(&[node.tx_node]));
            }
        }
    }

    fn look_at_frames(&self, now: Instant, findings: &mut Vec<Finding>) {
        for suspect in self.suspects.hard.iter().filter(|suspect| now.saturating_since(suspect.at) <= SHOWN) {
            let where_ = match suspect.standing() {
                Standing::Outside => "outside of its window",
                _ => "for which the calendar has no slot",
            };
            let what = format!(
                "{} sent {} frames of {} at priority 0, {where_}",
                self.named(suspect.tx_node),
                suspect.count,
                self.channel_named(suspect.etag)
            );
            findings.push(finding(Rule::UnplannedHard, what).of(&[suspect.tx_node]).on(suspect.etag));
        }
        for suspect in
            self.suspects.publishers.iter().filter(|suspect| now.saturating_since(suspect.at) <= SHOWN)
        {
            let what = format!(
                "{} published {} times on {}, which the plan does not provide for",
                self.named(suspect.tx_node),
                suspect.count,
                self.channel_named(suspect.etag)
            );
            findings.push(finding(Rule::UnplannedPublisher, what).of(&[suspect.tx_node]).on(suspect.etag));
        }
    }

    fn look_at_rates(&self, now: Instant, findings: &mut Vec<Finding>) {
        let longest =
            f64::from(self.bit_rate.bits_per_second()) / f64::from(cosmic_core::can::LONGEST_FRAME_BITS);
        for (etag, channel) in self.channels.iter() {
            let planned = self.plan.as_ref().zip(self.planned_channel(etag));
            let publishers = planned.map_or(1, |(plan, at)| plan.cluster().publishers(at).count().max(1));
            let most = match planned {
                // A frame that is repeated on the bus counts twice; events may come in pairs, by their jitter.
                Some((plan, at)) => 1.5 * plan.most_frames_per_second(at) / publishers as f64 + 3.0,
                None => longest * UNPLANNED_SHARE,
            };
            for publisher in &channel.publishers {
                let rate = publisher.rate.per_second(now);
                if rate <= most {
                    continue;
                }
                let limit = match planned {
                    Some((plan, at)) => {
                        format!("{:.0} are planned", plan.most_frames_per_second(at) / publishers as f64)
                    }
                    None => format!("that is over {:.0} % of the bus", UNPLANNED_SHARE * 100.0),
                };
                let what = format!(
                    "{} sends {rate:.0} frames a second on {}; {limit}",
                    self.named(publisher.tx_node),
                    self.channel_named(etag)
                );
                findings.push(finding(Rule::Babbling, what).of(&[publisher.tx_node]).on(etag));
            }
        }
        let load = self.load.view(self.bit_rate).now.total();
        if load > FULL {
            findings.push(finding(
                Rule::BusFull,
                format!("{:.0} % of the time of the bus is used", load * 100.0),
            ));
        }
    }

    fn named(&self, tx_node: TxNode) -> String {
        named(tx_node, self.plan.as_ref())
    }

    fn channel_named(&self, etag: Etag) -> String {
        let planned = self.plan.as_ref().zip(self.planned_channel(etag));
        planned.map_or_else(|| format!("etag {}", etag.get()), |(plan, at)| plan.channel(at).name.clone())
    }
}

fn finding(rule: Rule, what: String) -> Finding {
    Finding { rule, severity: rule.severity(), nodes: Vec::new(), etag: None, what, remedy: rule.remedy() }
}

impl Finding {
    fn of(self, nodes: &[TxNode]) -> Self {
        Self { nodes: nodes.iter().map(|node| node.get()).collect(), ..self }
    }

    fn on(self, etag: Etag) -> Self {
        Self { etag: Some(etag.get()), ..self }
    }
}

/// What happened is shown for so long.
const SHOWN: Duration = Duration::from_secs(60);
/// Without a frame for so long, nothing is received: nodes send their status every half second.
const NOTHING: Duration = Duration::from_secs(3);
/// A node of the plan is missed after this.
const SILENT_NODE: Duration = Duration::from_secs(5);
/// Error counters from here on are a warning (ISO 11898-1, fault confinement).
const ERROR_WARNING: u8 = 96;
const ERROR_PASSIVE: u8 = 128;
/// A publisher without a plan babbles if it takes more of the bus.
const UNPLANNED_SHARE: f64 = 0.3;
/// A bus with more load is full.
const FULL: f64 = 0.9;
