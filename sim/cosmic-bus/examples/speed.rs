//! How fast the bus model is: `cargo run --release -p cosmic-bus --example speed`.
//!
//! A hundred stations keep a 1 Mbit/s bus saturated: each always has a frame of eight bytes in a mailbox.
//! Printed are the cost of a frame and the virtual seconds simulated in a second of the host, with the
//! filters and the faults named, then the cost of working out a frame's length.

use cosmic_bus::{Bus, Chance, EventKind, FaultModel, Filter, Filters, StationId, VirtualInstant, WireFrame};
use cosmic_core::can::BitRate;
use embedded_can::{ExtendedId, Frame as _};
use std::hint::black_box;
use std::time::Instant;

const STATIONS: u32 = 100;
const VIRTUAL_SECONDS: u64 = 20;
const FRAMES: u32 = 5_000_000;

fn main() {
    println!("{STATIONS} stations, 1 Mbit/s saturated, {VIRTUAL_SECONDS} virtual seconds");
    saturated("every station accepts every frame", |_| Filters::accept_all(), Chance::NEVER, false);
    saturated("14 filters a station, 1 % accepted", fourteen_filters, Chance::NEVER, false);
    saturated("the same, one frame in a thousand destroyed", fourteen_filters, one_in_a_thousand(), false);
    saturated("the same, traced", fourteen_filters, one_in_a_thousand(), true);
    length();
}

fn one_in_a_thousand() -> Chance {
    Chance::new(0.001).unwrap_or(Chance::NEVER)
}

fn fourteen_filters(station: u32) -> Filters {
    let last = (0..13).map(|unused| Filter::exactly(id(STATIONS + unused, 1)));
    last.chain([Filter::exactly(id((station + 1) % STATIONS, 0))]).collect()
}

/// An identifier by which all stations are served in turn.
fn id(station: u32, round: u32) -> embedded_can::Id {
    ExtendedId::new(round << 14 | station).unwrap_or(ExtendedId::MAX).into()
}

fn saturated(label: &str, filters: impl Fn(u32) -> Filters, destroyed: Chance, traced: bool) {
    let mut bus = Bus::new(BitRate::MAX, FaultModel::seeded(1).with_inversion(destroyed));
    let stations: Vec<StationId> = (0..STATIONS).map(|station| bus.attach(format!("{station}"))).collect();
    bus.record_trace(traced);
    for (number, station) in (0..).zip(&stations) {
        bus.set_filters(*station, filters(number));
    }
    let frame = |station: StationId, count: u64| {
        let data = count.wrapping_mul(0x9E37_79B9_7F4A_7C15).to_be_bytes();
        WireFrame::new(id(station.index() as u32, 0), &data)
    };
    for station in &stations {
        if let Some(frame) = frame(*station, 0) {
            bus.load(bus.now(), *station, 0, frame).unwrap_or_else(|error| println!("{error}"));
        }
    }
    let end = VirtualInstant::from_ticks(VIRTUAL_SECONDS * 1_000_000_000);
    let (mut events, mut trace, mut sent, mut received) = (Vec::new(), Vec::new(), 0_u64, 0_u64);
    let begun = Instant::now();
    while let Some(next) = bus.next_event().filter(|next| *next <= end) {
        bus.advance(next, &mut events);
        for event in events.drain(..) {
            match event.kind {
                EventKind::Received(_) => received += 1,
                EventKind::Sent { mailbox } => {
                    sent += 1;
                    if let Some(frame) = frame(event.station, sent) {
                        let loaded = bus.load(event.at, event.station, mailbox, frame);
                        loaded.unwrap_or_else(|error| println!("{error}"));
                    }
                }
                _ => {}
            }
        }
        bus.take_trace(&mut trace);
        trace.clear();
    }
    let took = begun.elapsed();
    println!(
        "  {label}: {sent} frames sent, {received} received, {:.0} ns a frame, {:.1} virtual s/s",
        took.as_nanos() as f64 / sent as f64,
        VIRTUAL_SECONDS as f64 / took.as_secs_f64(),
    );
}

fn length() {
    let begun = Instant::now();
    let mut bits = 0_u64;
    for count in 0..FRAMES {
        let data = u64::from(count).wrapping_mul(0x9E37_79B9_7F4A_7C15).to_be_bytes();
        if let Some(frame) = WireFrame::new(id(count & 0x7F, count >> 7 & 0x7FFF), &data) {
            bits += u64::from(black_box(frame).bit_count());
        }
    }
    let cost = begun.elapsed().as_nanos() as f64 / f64::from(FRAMES);
    println!("length of a frame: {cost:.0} ns (mean {:.1} bits)", bits as f64 / f64::from(FRAMES));
}
