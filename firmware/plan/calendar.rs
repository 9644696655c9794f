// Made by `cosmic-plan build vehicle.toml`. Change that file, not this one.

/// What holds for all slots of the calendar.
pub const SEGMENT: ::cosmic_core::calendar::Segment = ::cosmic_core::calendar::Segment {
    bit_rate: ::cosmic_core::can::BitRate::new(1000000).unwrap(),
    accuracy: ::cosmic_core::time::Duration::from_micros(50),
    release_jitter: ::cosmic_core::time::Duration::from_micros(20),
};

/// The slots, by phase.
pub const SLOTS: [::cosmic_core::calendar::Slot; 1] = [
    // wheel_speed of sensor: ready 2 ms into every 10 ms
    ::cosmic_core::calendar::Slot {
        etag: ::cosmic_core::can::Etag::new(100).unwrap(),
        publisher: ::cosmic_core::can::TxNode::new(1).unwrap(),
        len: 8,
        omission_degree: 1,
        periodic: true,
        period: ::cosmic_core::time::Duration::from_millis(10),
        phase: ::cosmic_core::time::Duration::from_millis(2),
    },
];

/// The calendar of segment `vehicle`. It does not compile if windows overlap.
pub static CALENDAR: ::cosmic_core::calendar::Calendar = ::cosmic_core::calendar::Calendar::checked(SEGMENT, ::cosmic_core::time::Duration::from_millis(10), &SLOTS);

/// CRC-32 of the calendar; nodes with another one keep silent in hard real-time.
pub const DIGEST: u32 = 0xdfe96ca3;

/// How often the clock master sends sync and follow-up.
pub const SYNC_PERIOD: ::cosmic_core::time::Duration = ::cosmic_core::time::Duration::from_millis(25);

/// Δt_p: the span of deadlines that one soft real-time priority stands for.
pub const PRIORITY_STEP: ::cosmic_core::time::Duration = ::cosmic_core::time::Duration::from_micros(160);

/// The event channels, one module each.
pub mod channels {
    /// HRT channel `wheel_speed`: at most 8 bytes.
    pub mod wheel_speed {
        /// Its subject.
        pub const SUBJECT: ::cosmic_core::Subject = ::cosmic_core::Subject::new(0xc05a1c0000000001).unwrap();
        /// Its etag on this segment.
        pub const ETAG: ::cosmic_core::can::Etag = ::cosmic_core::can::Etag::new(100).unwrap();
        /// Bytes of an event at most.
        pub const LENGTH: usize = 8;
        /// One event in every period.
        pub const PERIOD: ::cosmic_core::time::Duration = ::cosmic_core::time::Duration::from_millis(10);
        /// Its slot in the calendar.
        pub const SLOT: ::cosmic_core::calendar::Slot = super::super::SLOTS[0];
        /// The quality that the channel is announced with.
        pub const ATTRIBUTES: ::cosmic_core::event_layer::HardAttributes = ::cosmic_core::event_layer::HardAttributes { period: ::cosmic_core::time::Duration::from_millis(10), periodic: true, omission_degree: 1 };
    }
    /// SRT channel `temperature`: at most 8 bytes.
    pub mod temperature {
        /// Its subject.
        pub const SUBJECT: ::cosmic_core::Subject = ::cosmic_core::Subject::new(0xc05a1c0000000002).unwrap();
        /// Its etag on this segment.
        pub const ETAG: ::cosmic_core::can::Etag = ::cosmic_core::can::Etag::new(16383).unwrap();
        /// Bytes of an event at most.
        pub const LENGTH: usize = 8;
        /// One event in every period.
        pub const PERIOD: ::cosmic_core::time::Duration = ::cosmic_core::time::Duration::from_millis(20);
        /// The quality that the channel is announced with.
        pub const ATTRIBUTES: ::cosmic_core::event_layer::SoftAttributes = ::cosmic_core::event_layer::SoftAttributes { deadline: ::cosmic_core::time::Duration::from_millis(10), validity: ::cosmic_core::time::Duration::from_millis(40) };
    }
    /// SRT channel `brake_force`: at most 8 bytes.
    pub mod brake_force {
        /// Its subject.
        pub const SUBJECT: ::cosmic_core::Subject = ::cosmic_core::Subject::new(0xc05a1c0000000003).unwrap();
        /// Its etag on this segment.
        pub const ETAG: ::cosmic_core::can::Etag = ::cosmic_core::can::Etag::new(16382).unwrap();
        /// Bytes of an event at most.
        pub const LENGTH: usize = 8;
        /// Events come at least this far apart.
        pub const MIN_INTERARRIVAL: ::cosmic_core::time::Duration = ::cosmic_core::time::Duration::from_millis(10);
        /// The quality that the channel is announced with.
        pub const ATTRIBUTES: ::cosmic_core::event_layer::SoftAttributes = ::cosmic_core::event_layer::SoftAttributes { deadline: ::cosmic_core::time::Duration::from_millis(4), validity: ::cosmic_core::time::Duration::from_millis(20) };
    }
    /// SRT channel `suspension`: at most 8 bytes.
    pub mod suspension {
        /// Its subject.
        pub const SUBJECT: ::cosmic_core::Subject = ::cosmic_core::Subject::new(0xc05a1c0000000004).unwrap();
        /// Its etag on this segment.
        pub const ETAG: ::cosmic_core::can::Etag = ::cosmic_core::can::Etag::new(16381).unwrap();
        /// Bytes of an event at most.
        pub const LENGTH: usize = 8;
        /// One event in every period.
        pub const PERIOD: ::cosmic_core::time::Duration = ::cosmic_core::time::Duration::from_millis(1);
        /// The quality that the channel is announced with.
        pub const ATTRIBUTES: ::cosmic_core::event_layer::SoftAttributes = ::cosmic_core::event_layer::SoftAttributes { deadline: ::cosmic_core::time::Duration::from_millis(2), validity: ::cosmic_core::time::Duration::from_millis(8) };
    }
    /// NRT channel `logbook`: at most 8 bytes.
    pub mod logbook {
        /// Its subject.
        pub const SUBJECT: ::cosmic_core::Subject = ::cosmic_core::Subject::new(0xc05a1c0000000005).unwrap();
        /// Its etag on this segment.
        pub const ETAG: ::cosmic_core::can::Etag = ::cosmic_core::can::Etag::new(16380).unwrap();
        /// Bytes of an event at most.
        pub const LENGTH: usize = 8;
        /// Events come at least this far apart.
        pub const MIN_INTERARRIVAL: ::cosmic_core::time::Duration = ::cosmic_core::time::Duration::from_millis(4);
        /// The quality that the channel is announced with.
        pub const ATTRIBUTES: ::cosmic_core::event_layer::NonRealTimeAttributes = ::cosmic_core::event_layer::NonRealTimeAttributes { importance: ::cosmic_core::event_layer::Importance::new(4).unwrap(), validity: None };
    }
}

/// The nodes, one module each.
pub mod nodes {
    /// Node `sensor`.
    pub mod sensor {
        /// Its name.
        pub const NAME: &str = "sensor";
        /// Its UID.
        pub const UID: ::cosmic_core::NodeUid = ::cosmic_core::NodeUid::new(0xc05a000000000001).unwrap();
        /// Its short id.
        pub const TX_NODE: ::cosmic_core::can::TxNode = ::cosmic_core::can::TxNode::new(1).unwrap();
        /// What it publishes.
        pub const PUBLISHES: &[::cosmic_core::Subject] = &[::cosmic_core::Subject::new(0xc05a1c0000000001).unwrap(), ::cosmic_core::Subject::new(0xc05a1c0000000002).unwrap()];
        /// What it subscribes to.
        pub const SUBSCRIBES: &[::cosmic_core::Subject] = &[::cosmic_core::Subject::new(0xc05a1c0000000005).unwrap()];
    }
    /// Node `brake`.
    pub mod brake {
        /// Its name.
        pub const NAME: &str = "brake";
        /// Its UID.
        pub const UID: ::cosmic_core::NodeUid = ::cosmic_core::NodeUid::new(0xc05a000000000002).unwrap();
        /// Its short id.
        pub const TX_NODE: ::cosmic_core::can::TxNode = ::cosmic_core::can::TxNode::new(2).unwrap();
        /// What it publishes.
        pub const PUBLISHES: &[::cosmic_core::Subject] = &[::cosmic_core::Subject::new(0xc05a1c0000000003).unwrap()];
        /// What it subscribes to.
        pub const SUBSCRIBES: &[::cosmic_core::Subject] = &[::cosmic_core::Subject::new(0xc05a1c0000000001).unwrap(), ::cosmic_core::Subject::new(0xc05a1c0000000002).unwrap(), ::cosmic_core::Subject::new(0xc05a1c0000000004).unwrap()];
    }
    /// Node `diagnostics`.
    pub mod diagnostics {
        /// Its name.
        pub const NAME: &str = "diagnostics";
        /// Its UID.
        pub const UID: ::cosmic_core::NodeUid = ::cosmic_core::NodeUid::new(0xc05a000000000003).unwrap();
        /// Its short id.
        pub const TX_NODE: ::cosmic_core::can::TxNode = ::cosmic_core::can::TxNode::new(3).unwrap();
        /// What it publishes.
        pub const PUBLISHES: &[::cosmic_core::Subject] = &[::cosmic_core::Subject::new(0xc05a1c0000000004).unwrap(), ::cosmic_core::Subject::new(0xc05a1c0000000005).unwrap()];
        /// What it subscribes to.
        pub const SUBSCRIBES: &[::cosmic_core::Subject] = &[::cosmic_core::Subject::new(0xc05a1c0000000001).unwrap(), ::cosmic_core::Subject::new(0xc05a1c0000000003).unwrap()];
    }
}
