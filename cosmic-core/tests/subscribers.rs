//! The queues of subscribers against a simple model: each policy keeps its promise, and the places that all of them share
//! come back, whoever leaves.

use std::collections::VecDeque;

use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::event_half::EventHalf;
use cosmic_core::event_layer::{
    AnnounceError, Attribute, Channel, Constant, Context, Depth, Filter, Policy, SoftAttributes,
    SubscribeError, Subscription,
};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::network::soft::RESERVED;
use cosmic_core::time::{Duration, GlobalClock, Instant};
use proptest::prelude::*;

const PLACES: usize = 6;
const SUBSCRIBERS: usize = 5;

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    Duration::from_millis(10),
    &[],
);

type Half = EventHalf<2, 4, SUBSCRIBERS, PLACES, { 2 + RESERVED }, { 2 + RESERVED }>;

/// One channel without context, and one with.
const CHANNELS: [Channel<u8>; 2] = [channel(0), channel(1).with_context()];

const fn channel(number: u16) -> Channel<u8> {
    let attributes =
        SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) };
    Channel::soft(Subject::new(0x200 + number as u64).unwrap(), attributes).with_etag(etag(number))
}

const fn etag(number: u16) -> Etag {
    Etag::new(Etag::BOUND_LAST.get() - number).unwrap()
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Subscribe {
        channel: usize,
        filtered: bool,
        policy: Policy,
    },
    Cancel(usize),
    /// An event of a channel, with this priority; it carries an attribute or not.
    Event {
        channel: usize,
        priority: u8,
        located: bool,
    },
    Fetch(usize),
}

fn steps() -> impl Strategy<Value = Step> {
    let depth = || (1_u8..4).prop_map(|depth| Depth::new(depth).unwrap());
    let policy = prop_oneof![
        depth().prop_map(Policy::Fifo),
        depth().prop_map(Policy::DeadlineOrder),
        Just(Policy::Latest)
    ];
    prop_oneof![
        2 => (0_usize..2, any::<bool>(), policy)
            .prop_map(|(channel, filtered, policy)| Step::Subscribe { channel, filtered, policy }),
        1 => (0_usize..SUBSCRIBERS).prop_map(Step::Cancel),
        5 => (0_usize..2, 10_u8..14, any::<bool>())
            .prop_map(|(channel, priority, located)| Step::Event { channel, priority, located }),
        4 => (0_usize..SUBSCRIBERS).prop_map(Step::Fetch),
    ]
}

/// A subscriber as it should be.
struct Model {
    subscription: Subscription<u8>,
    channel: usize,
    filtered: bool,
    policy: Policy,
    /// Content and priority.
    queue: VecDeque<(u8, u8)>,
}

impl Model {
    /// Takes an event if there is room for it in the queue and among the `free` places.
    fn offer(&mut self, event: (u8, u8), located: bool, free: usize) {
        if self.filtered && !(located && self.channel == 1) {
            return;
        }
        let depth = match self.policy {
            Policy::Fifo(depth) | Policy::DeadlineOrder(depth) => usize::from(depth.get()),
            Policy::Latest => 1,
        };
        let full = self.queue.len() >= depth;
        match self.policy {
            Policy::Latest if full => self.queue = [event].into(),
            _ if full || free == 0 => {}
            Policy::DeadlineOrder(_) => {
                // All arrive at one instant, so the priority alone says which deadline is earlier.
                let at = self.queue.iter().take_while(|other| other.1 <= event.1).count();
                self.queue.insert(at, event);
            }
            _ => self.queue.push_back(event),
        }
    }
}

fn frame(channel: usize, priority: u8, located: bool, number: u8) -> Frame {
    let mut payload = Payload::new(&[number]).unwrap();
    if channel == 1 {
        let context =
            if located { Context::EMPTY.with(Attribute::Location, 7).unwrap() } else { Context::EMPTY };
        payload = context.prepend(&payload).unwrap();
    }
    Frame::new(Id::new(Priority::new(priority), TxNode::new(2).unwrap(), etag(channel as u16)), payload)
}

/// The half and its model, which do the same.
struct Both {
    half: Half,
    /// In the order of subscription.
    models: Vec<Model>,
    number: u8,
}

impl Both {
    fn free(&self) -> usize {
        PLACES - self.models.iter().map(|model| model.queue.len()).sum::<usize>()
    }

    fn subscribe(&mut self, channel: usize, filtered: bool, policy: Policy) {
        let filter = if filtered { Filter::at_least(&[Attribute::Location]) } else { Filter::ALL };
        let subscribed = self.half.subscribe(&CHANNELS[channel], filter, policy);
        assert_eq!(subscribed.is_ok(), self.models.len() < SUBSCRIBERS);
        if let Ok(subscription) = subscribed {
            self.models.push(Model { subscription, channel, filtered, policy, queue: VecDeque::new() });
        }
    }

    fn event(&mut self, channel: usize, priority: u8, located: bool) {
        self.number = self.number.wrapping_add(1);
        self.half.on_frame(&frame(channel, priority, located, self.number), Instant::EPOCH);
        // Who subscribed last is served first, which shows when there are not enough places for all.
        for at in (0..self.models.len()).rev() {
            let free = self.free();
            if self.models[at].channel == channel {
                self.models[at].offer((self.number, priority), located, free);
            }
        }
    }

    fn fetch(&mut self, at: usize) {
        let Some(model) = self.models.get_mut(at) else { return };
        let got = self.half.next(&model.subscription).map(|got| (got.content, got.id.priority().get()));
        assert_eq!(got, model.queue.pop_front());
    }

    fn step(&mut self, step: Step) {
        match step {
            Step::Subscribe { channel, filtered, policy } => self.subscribe(channel, filtered, policy),
            Step::Cancel(at) if at < self.models.len() => {
                self.half.cancel_subscription(self.models.remove(at).subscription);
            }
            Step::Cancel(_) => {}
            Step::Event { channel, priority, located } => self.event(channel, priority, located),
            Step::Fetch(at) => self.fetch(at),
        }
    }
}

proptest! {
    #[test]
    fn each_subscriber_gets_what_its_policy_says_and_no_place_is_lost(
        steps in prop::collection::vec(steps(), 0..200)
    ) {
        let buffers = HrtBuffers::new(GlobalClock::free_running());
        let mut both = Both { half: Half::new(TxNode::new(1), &CALENDAR, (), buffers), models: Vec::new(), number: 0 };
        for step in steps {
            both.step(step);
        }
        // All leave with what waits for them; then one subscriber has all places.
        while !both.models.is_empty() {
            both.step(Step::Cancel(0));
        }
        both.subscribe(0, false, Policy::Fifo(Depth::new(PLACES as u8 + 1).unwrap()));
        for _ in 0..=PLACES {
            both.event(0, 10, false);
        }
        for _ in 0..=PLACES {
            both.fetch(0);
        }
    }
}

#[test]
fn a_node_without_contexts_refuses_channels_with_context_and_filters() {
    type Half = EventHalf<
        2,
        4,
        SUBSCRIBERS,
        PLACES,
        { 2 + RESERVED },
        { 2 + RESERVED },
        (),
        HrtBuffers<2>,
        Constant<false, true>,
    >;
    static CHANNELS_HERE: [Channel<u8>; 2] = CHANNELS;
    let [plain, located] = &CHANNELS_HERE;
    let mut half = Half::new(TxNode::new(1), &CALENDAR, (), HrtBuffers::new(GlobalClock::free_running()));
    let refused = Some(SubscribeError::Channel(AnnounceError::NoContexts));
    assert_eq!(half.subscribe(located, Filter::ALL, Policy::Latest).err(), refused);
    assert_eq!(half.announce(located).err(), Some(AnnounceError::NoContexts));
    // No event of it would pass.
    let filter = Filter::at_least(&[Attribute::Location]);
    assert_eq!(half.subscribe(plain, filter, Policy::Latest).err(), refused);
    let subscription = half.subscribe(plain, Filter::ALL, Policy::Latest).unwrap();
    half.on_frame(
        &Frame::new(Id::new(Priority::new(9), TxNode::new(2).unwrap(), etag(0)), Payload::new(&[3]).unwrap()),
        Instant::EPOCH,
    );
    assert_eq!(half.next(&subscription).map(|event| event.content), Some(3));
}
