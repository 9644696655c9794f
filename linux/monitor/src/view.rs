//! What a monitor knows, put into a [`Snapshot`].

use std::collections::BTreeSet;

use cosmic_core::Subject;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::time::{Duration, Instant};
use cosmic_plan::cluster::{Channel, PlannedClass};

use crate::channels::{ChannelSeen, PublisherSeen};
use crate::decode;
use crate::monitor::Monitor;
use crate::snapshot::{
    ChannelClass, ChannelView, ClockView, ContentView, LinkView, NodeView, PublisherView, Snapshot,
    SubscriberView,
};
use cosmic_core::protocol::Class;

impl Monitor {
    pub(crate) fn view(&self, now: Instant) -> Snapshot {
        Snapshot {
            segment: self.plan.as_ref().map(|plan| plan.cluster().name.clone()),
            listening_ns: ticks(now.saturating_since(self.started)),
            link: self.link_view(now),
            load: self.load.view(self.bit_rate),
            clock: self.clock_view(now),
            brokers: self.brokers.active(now).map(TxNode::get).collect(),
            nodes: self.node_views(now),
            channels: self.channel_views(now),
            slots: self.plan.as_ref().map_or_else(Vec::new, |plan| self.slots.views(plan)),
            cycle_ns: self.plan.as_ref().map_or(0, |plan| ticks(plan.cycle())),
            messages: self.messages.view(),
            overlooked: self.channels.overlooked(),
        }
    }

    fn link_view(&self, now: Instant) -> LinkView {
        let link = &self.link;
        LinkView {
            received: link.received,
            foreign: link.foreign,
            lost: link.lost,
            silent_ns: link.last_at.map(|at| ticks(now.saturating_since(at))),
            transmit_errors: link.errors.map(|errors| errors.transmit),
            receive_errors: link.errors.map(|errors| errors.receive),
            bus_off: link.bus_off,
        }
    }

    fn clock_view(&self, now: Instant) -> ClockView {
        let last = self.clock.last();
        let digest = |digest: u32| format!("{digest:08X}");
        ClockView {
            master: last.map(|sync| sync.from.get()),
            rank: last.map(|sync| sync.message.rank.get()),
            calendar: last.map(|sync| sync.message.calendar_digest).filter(|other| *other != 0).map(digest),
            planned_calendar: self.plan.as_ref().map(|plan| digest(plan.digest())),
            global_ns: self.clock.global(now).map(|global| ticks(global.since_epoch())),
            uncertainty_ns: self.clock.uncertainty().map(ticks),
            accuracy_ns: last.map(|sync| ticks(sync.message.accuracy)),
            steps: self.clock.steps(),
            age_ns: last.map(|sync| ticks(now.saturating_since(sync.at))),
        }
    }

    fn node_views(&self, now: Instant) -> Vec<NodeView> {
        let mut all: BTreeSet<TxNode> = self.nodes.iter().map(|(tx_node, _)| tx_node).collect();
        if let Some(plan) = &self.plan {
            all.extend(plan.cluster().nodes.iter().map(|node| node.tx_node));
        }
        all.into_iter().map(|tx_node| self.node_view(tx_node, now)).collect()
    }

    fn node_view(&self, tx_node: TxNode, now: Instant) -> NodeView {
        let seen = self.nodes.get(tx_node);
        let status = seen.and_then(|node| node.status).map(|(status, _)| status);
        let planned = self.plan.as_ref().and_then(|plan| plan.uid_of(tx_node));
        let uid = seen.and_then(|node| node.uid()).or(planned);
        NodeView {
            tx_node: tx_node.get(),
            name: self.name_of(tx_node),
            uid: uid.map(|uid| uid.to_string()),
            planned: planned.is_some(),
            alive: seen.is_some_and(|node| node.alive),
            state: status.map(|status| decode::state(status.state)),
            transmit_errors: status.map(|status| status.transmit_errors),
            receive_errors: status.map(|status| status.receive_errors),
            exceptions: seen.map_or(0, |node| node.exceptions),
            restarts: seen.map_or(0, |node| node.restarts),
            uptime_s: status.map(|status| status.uptime.duration().as_secs()),
            silent_ns: seen.map(|node| ticks(now.saturating_since(node.heard_at))),
            frames: seen.map_or(0, |node| node.frames),
            frames_per_second: seen.map_or(0.0, |node| node.rate.per_second(now)),
            is_broker: self.brokers.active(now).any(|broker| broker == tx_node),
            is_master: self
                .clock
                .last()
                .is_some_and(|sync| sync.from == tx_node && now <= sync.at + MASTER_SILENCE),
        }
    }

    fn channel_views(&self, now: Instant) -> Vec<ChannelView> {
        let seen: Vec<Etag> = self.channels.iter().map(|(etag, _)| etag).collect();
        let mut planned: BTreeSet<usize> = BTreeSet::new();
        let mut views: Vec<ChannelView> = Vec::new();
        for etag in seen {
            let at = self.planned_channel(etag);
            planned.extend(at);
            views.push(self.channel_view(Some(etag), at, now));
        }
        if let Some(plan) = &self.plan {
            for at in (0..plan.cluster().channels.len()).filter(|at| !planned.contains(at)) {
                views.push(self.channel_view(plan.channel(at).etag, Some(at), now));
            }
        }
        views.sort_by_key(|view| (view.etag.is_none(), view.etag));
        views
    }

    fn channel_view(&self, etag: Option<Etag>, planned: Option<usize>, now: Instant) -> ChannelView {
        let seen = etag.and_then(|etag| self.channels.get(etag));
        let channel = planned.zip(self.plan.as_ref()).map(|(at, plan)| plan.channel(at));
        let subject = etag.and_then(|etag| self.subject_of(etag));
        let subject = subject.or_else(|| channel.and_then(|channel| Subject::new(channel.subject)));
        ChannelView {
            etag: etag.map(Etag::get),
            subject: subject.map(|subject| subject.to_string()),
            name: channel.map(|channel| channel.name.clone()),
            class: class_of(channel, seen, etag),
            rate: seen.map_or(0.0, |seen| seen.rate.per_second(now)),
            frames: seen.map_or(0, |seen| seen.frames),
            deadline_ns: channel.and_then(|channel| channel.deadline).map(ticks),
            period_ns: channel.map(|channel| ticks(channel.recurrence.span())),
            publishers: self.publisher_views(seen, planned, now),
            subscribers: self.subscriber_views(seen, planned, now),
            last: seen.and_then(|seen| self.last_content(seen, planned, now)),
            latency: seen.and_then(|seen| seen.latency.view()),
        }
    }

    /// The last event; of a channel of messages the last one that is whole.
    fn last_content(&self, seen: &ChannelSeen, planned: Option<usize>, now: Instant) -> Option<ContentView> {
        let view = |tx_node: TxNode, at: Instant, data: String, bytes: &[u8]| ContentView {
            tx_node: tx_node.get(),
            age_ns: ticks(now.saturating_since(at)),
            data,
            fields: self.content(planned, bytes).0,
        };
        if self.carries_messages(planned) {
            return seen.message.as_ref().map(|it| view(it.tx_node, it.at, it.data(), &it.content));
        }
        seen.last.map(|it| view(it.tx_node, it.at, it.payload.to_string(), it.payload.as_slice()))
    }

    fn publisher_views(
        &self,
        seen: Option<&ChannelSeen>,
        planned: Option<usize>,
        now: Instant,
    ) -> Vec<PublisherView> {
        let none = PublisherSeen::new;
        let mut views: Vec<PublisherView> = Vec::new();
        let seen = seen.map_or(&[][..], |seen| &seen.publishers);
        views.extend(seen.iter().map(|publisher| self.publisher_view(publisher, planned, now)));
        if let Some((plan, channel)) = self.plan.as_ref().zip(planned) {
            let unseen = plan.cluster().publishers(channel).map(|node| node.tx_node);
            let unseen = unseen.filter(|node| !seen.iter().any(|publisher| publisher.tx_node == *node));
            views.extend(unseen.map(|node| self.publisher_view(&none(node), planned, now)));
        }
        views.sort_by_key(|view| view.tx_node);
        views
    }

    fn publisher_view(
        &self,
        publisher: &PublisherSeen,
        planned: Option<usize>,
        now: Instant,
    ) -> PublisherView {
        let tx_node = publisher.tx_node;
        PublisherView {
            tx_node: tx_node.get(),
            name: self.name_of(tx_node),
            lease_ns: publisher.announced_until.map(|until| ticks(until.saturating_since(now))),
            planned: self.plan.as_ref().zip(planned).map(|(plan, channel)| plan.publishes(tx_node, channel)),
            frames: publisher.frames,
            interval_ns: publisher.mean.map(ticks),
            shortest_ns: publisher.shortest.map(ticks),
            longest_ns: publisher.longest.map(ticks),
            silent_ns: publisher.last_at.map(|at| ticks(now.saturating_since(at))),
        }
    }

    fn subscriber_views(
        &self,
        seen: Option<&ChannelSeen>,
        planned: Option<usize>,
        now: Instant,
    ) -> Vec<SubscriberView> {
        let seen = seen.map_or(&[][..], |seen| &seen.subscribers);
        let view = |tx_node: TxNode, lease: Option<Duration>| SubscriberView {
            tx_node: tx_node.get(),
            name: self.name_of(tx_node),
            lease_ns: lease.map(ticks),
        };
        let leased = seen.iter().map(|seen| view(seen.tx_node, Some(seen.until.saturating_since(now))));
        let mut views: Vec<SubscriberView> = leased.collect();
        if let Some((plan, channel)) = self.plan.as_ref().zip(planned) {
            let unseen = plan.cluster().subscribers(channel).map(|node| node.tx_node);
            views.extend(
                unseen
                    .filter(|node| !seen.iter().any(|seen| seen.tx_node == *node))
                    .map(|node| view(node, None)),
            );
        }
        views.sort_by_key(|view| view.tx_node);
        views
    }
}

/// By the plan, or as its nodes say, or by its etag.
fn class_of(
    planned: Option<&Channel>,
    seen: Option<&ChannelSeen>,
    etag: Option<Etag>,
) -> Option<ChannelClass> {
    let planned = planned.map(|channel| match channel.class {
        PlannedClass::Hard { .. } => ChannelClass::Hard,
        PlannedClass::Soft => ChannelClass::Soft,
        PlannedClass::NonRealTime { .. } => ChannelClass::NonRealTime,
    });
    let told = seen.and_then(|seen| seen.class).map(|class| match class {
        Class::Hard => ChannelClass::Hard,
        Class::Soft => ChannelClass::Soft,
        Class::NonRealTime => ChannelClass::NonRealTime,
    });
    let by_priority = || match seen {
        _ if etag.is_some_and(Etag::is_hard) => Some(ChannelClass::Hard),
        Some(seen) if seen.latency.view().is_some() => Some(ChannelClass::Soft),
        Some(seen) if seen.frames > 0 => Some(ChannelClass::NonRealTime),
        _ => None,
    };
    planned.or(told).or_else(by_priority)
}

fn ticks(span: Duration) -> u64 {
    span.as_ticks()
}

/// A master that is silent for so long is none.
const MASTER_SILENCE: Duration = Duration::from_secs(5);
