//! A rover on the simulated bus, told to a hub in virtual time; and the hub's server on loopback.
#![allow(dead_code, reason = "no test uses all of it")]

#[path = "../../../monitor/tests/bed/mod.rs"]
pub(crate) mod bed;
pub(crate) mod browser;

use std::net::{Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use bed::{Bed, instant};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::time::{self, Instant as LinkInstant};
use cosmic_linux::{Tapped, What};
use cosmic_monitor::Monitor;
use cosmic_page::{Hub, Segment};

/// A segment whose frames come from a simulated rover.
pub(crate) struct Rover {
    pub(crate) bed: Bed,
    pub(crate) segment: Segment,
    fed: usize,
}

impl Rover {
    pub(crate) fn of(hub: &Hub, name: &str) -> Self {
        let bed = Bed::rover().power_on();
        let monitor = Monitor::with_plan(bed.plan.clone(), LinkInstant::EPOCH);
        let segment = hub.segment(name, format!("sim:/run/cosmic/{name}"), monitor);
        segment.on_tapped(&Tapped { at: LinkInstant::EPOCH, what: What::Connected });
        Self { bed, segment, fed: 0 }
    }

    /// Lets so many milliseconds of the rover pass. Returns how many frames that were.
    pub(crate) fn run(&mut self, milliseconds: u64) -> usize {
        self.bed.run(milliseconds);
        let fresh = &self.bed.log[self.fed..];
        for (at, wire) in fresh {
            let what = Frame::try_from(*wire).map_or(What::Foreign(Some(*wire)), What::Frame);
            self.segment.on_tapped(&Tapped { at: instant(*at), what });
        }
        self.segment.advance(self.bed.now());
        self.fed += fresh.len();
        self.bed.log.len() - (self.fed - fresh.len())
    }
}

/// The `number`th event of a stream that nobody planned, and when it comes: 1 000 a second.
pub(crate) fn event(number: u64) -> Tapped {
    let etag = Etag::new(2_000 + (number % 20) as u16).unwrap();
    let publisher = TxNode::new((number % 100) as u8).unwrap();
    let content = Payload::full((number as u32).to_be_bytes().repeat(2).try_into().unwrap());
    let frame = Frame::new(Id::new(Priority::new(30), publisher, etag), content);
    let at = LinkInstant::from_epoch(time::Duration::from_micros(1_000 * number));
    Tapped { at, what: What::Frame(frame) }
}

/// A server that can be cut off: its connections end with it.
pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    runtime: Option<tokio::runtime::Runtime>,
}

impl Server {
    pub(crate) fn start(hub: &Hub) -> Self {
        Self::start_at(hub, (Ipv4Addr::LOCALHOST, 0).into())
    }

    pub(crate) fn start_at(hub: &Hub, address: SocketAddr) -> Self {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let listener = runtime.block_on(tokio::net::TcpListener::bind(address)).unwrap();
        let address = listener.local_addr().unwrap();
        runtime.spawn(cosmic_page::serve(hub.clone(), listener));
        Self { address, runtime: Some(runtime) }
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(10));
        }
    }
}

/// Waits for what another thread does.
pub(crate) fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !holds() {
        assert!(begun.elapsed() < PATIENCE, "in {PATIENCE:?} not: {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Bounds only a test that hangs.
pub(crate) const PATIENCE: Duration = Duration::from_secs(90);
