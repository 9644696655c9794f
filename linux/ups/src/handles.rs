//! Handles: numbers that are never used again, so that one that was closed is an error and not another thing.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use cosmic_session::{Session, Subscription};

use crate::error::Error;

#[derive(Default)]
struct Handles {
    last: u64,
    nodes: HashMap<u64, Arc<Session>>,
    /// With the handle of the node.
    subscriptions: HashMap<u64, (u64, Subscribed)>,
}

/// A subscription, and the subject of its channel.
#[derive(Clone)]
pub(crate) struct Subscribed {
    pub(crate) subject: u64,
    pub(crate) subscription: Arc<Subscription>,
}

static HANDLES: Mutex<Option<Handles>> = Mutex::new(None);

fn with<R>(act: impl FnOnce(&mut Handles) -> R) -> R {
    let mut handles: MutexGuard<'_, Option<Handles>> = HANDLES.lock().unwrap_or_else(PoisonError::into_inner);
    act(handles.get_or_insert_default())
}

impl Handles {
    fn next(&mut self) -> u64 {
        self.last += 1;
        self.last
    }
}

pub(crate) fn add_node(session: Session) -> u64 {
    with(|handles| {
        let handle = handles.next();
        handles.nodes.insert(handle, Arc::new(session));
        handle
    })
}

pub(crate) fn node(handle: u64) -> Result<Arc<Session>, Error> {
    with(|handles| handles.nodes.get(&handle).cloned()).ok_or_else(|| Error::handle("node", handle))
}

/// Forgets a node with its subscriptions. The caller closes it, not under the lock.
pub(crate) fn remove_node(handle: u64) -> Result<Arc<Session>, Error> {
    with(|handles| {
        let session = handles.nodes.remove(&handle)?;
        // None of them is the last holder of the node.
        handles.subscriptions.retain(|_, (node, _)| *node != handle);
        Some(session)
    })
    .ok_or_else(|| Error::handle("node", handle))
}

/// Refused if the node has been closed meanwhile.
pub(crate) fn add_subscription(node: u64, subscribed: Subscribed) -> Result<u64, Error> {
    with(|handles| {
        handles.nodes.contains_key(&node).then(|| {
            let handle = handles.next();
            handles.subscriptions.insert(handle, (node, subscribed));
            handle
        })
    })
    .ok_or_else(|| Error::handle("node", node))
}

pub(crate) fn subscription(handle: u64) -> Result<Subscribed, Error> {
    with(|handles| handles.subscriptions.get(&handle).map(|(_, subscribed)| subscribed.clone()))
        .ok_or_else(|| Error::handle("subscription", handle))
}

pub(crate) fn remove_subscription(handle: u64) -> Result<Subscribed, Error> {
    with(|handles| handles.subscriptions.remove(&handle))
        .map(|(_, subscribed)| subscribed)
        .ok_or_else(|| Error::handle("subscription", handle))
}
