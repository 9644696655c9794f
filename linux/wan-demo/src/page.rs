//! The live page of the demo: both segments, and what crosses the two gateways.

use std::net::SocketAddr;
use std::path::Path;

use cosmic_core::can::Etag;
use cosmic_core::time::Instant;
use cosmic_monitor::{Monitor, SegmentPlan};
use cosmic_page::{Config, Hub};
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use crate::bed::Bed;
use crate::channels::{COMMAND_ETAG, SUBJECTS};
use crate::failed::Failed;

/// Where the page is to be served. It is nowhere yet.
///
/// # Errors
/// Another program is there.
pub async fn listen(address: SocketAddr) -> Result<TcpListener, Failed> {
    TcpListener::bind(address).await.map_err(|error| {
        Failed(format!("the page cannot be served at {address}: {error}; choose another address with --page"))
    })
}

/// Serves it, as long as the set lives.
///
/// # Errors
/// The description of the cluster is wrong.
pub fn serve(bed: &Bed, cluster: &Path, listener: TcpListener) -> Result<JoinSet<()>, Failed> {
    let plan = SegmentPlan::read(cluster).map_err(|refused| Failed(refused.to_string()))?;
    let title = "COSMIC: two segments, two gateways".to_owned();
    let hub = Hub::new(Config { title, ..Config::default() });
    bed.watch(&hub);
    let mut tasks = JoinSet::new();
    for served in [&bed.west, &bed.east] {
        let mut monitor = Monitor::with_plan(plan.clone(), Instant::EPOCH);
        for (subject, etag) in SUBJECTS.into_iter().zip(COMMAND_ETAG..) {
            if let Some(etag) = Etag::new(etag) {
                monitor.learn(subject, etag);
            }
        }
        let segment = hub.segment(served.name, served.link(), monitor);
        tasks.spawn(segment.follow(served.tap()));
    }
    tasks.spawn(async move {
        if let Err(error) = cosmic_page::serve(hub, listener).await {
            eprintln!("wan-demo: the page is served no longer: {error}");
        }
    });
    Ok(tasks)
}
