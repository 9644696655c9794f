//! What the tests of the bus share.
#![allow(dead_code, reason = "each test uses its part")]

use cosmic_bus::{Bus, Event, EventKind, FaultModel, StationId, VirtualInstant, WireFrame};
use cosmic_core::can::BitRate;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};

/// The instant of a bit boundary at 1 Mbit/s.
pub(crate) const fn bit(count: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(count * 1_000)
}

/// A bus of 1 Mbit/s with so many stations.
pub(crate) fn bus_of<const N: usize>(faults: FaultModel) -> (Bus, [StationId; N]) {
    let mut bus = Bus::new(BitRate::MAX, faults);
    let stations = core::array::from_fn(|number| bus.attach(format!("station {number}")));
    (bus, stations)
}

pub(crate) fn standard(id: u16, data: &[u8]) -> WireFrame {
    WireFrame::new(StandardId::new(id).unwrap(), data).unwrap()
}

pub(crate) fn extended(id: u32, data: &[u8]) -> WireFrame {
    WireFrame::new(ExtendedId::new(id).unwrap(), data).unwrap()
}

pub(crate) fn remote(id: impl Into<Id>, len: usize) -> WireFrame {
    WireFrame::new_remote(id, len).unwrap()
}

/// All events until `to`.
pub(crate) fn events_until(bus: &mut Bus, to: VirtualInstant) -> Vec<Event> {
    let mut events = Vec::new();
    bus.advance(to, &mut events);
    events
}

pub(crate) const fn event(at: VirtualInstant, station: StationId, kind: EventKind) -> Event {
    Event { at, station, kind }
}

pub(crate) fn count(events: &[Event], station: StationId, is_it: impl Fn(&EventKind) -> bool) -> usize {
    events.iter().filter(|event| event.station == station && is_it(&event.kind)).count()
}

pub(crate) fn received(events: &[Event], station: StationId) -> usize {
    count(events, station, |kind| matches!(kind, EventKind::Received(_)))
}

pub(crate) fn sent(events: &[Event], station: StationId) -> usize {
    count(events, station, |kind| matches!(kind, EventKind::Sent { .. }))
}

pub(crate) fn failed(events: &[Event], station: StationId) -> usize {
    count(events, station, |kind| matches!(kind, EventKind::Failed { .. }))
}

pub(crate) fn withdrawn(events: &[Event], station: StationId) -> usize {
    count(events, station, |kind| matches!(kind, EventKind::Withdrawn { .. }))
}
