//! When the handlers of the nodes run: begins and ends, put together.

use std::collections::HashMap;
use std::rc::Rc;

use cosmic_bus::VirtualInstant;
use cosmic_core::can::TxNode;

use crate::journal::HandlerRun;

/// A handler: its node, the number of its exception, its priority.
type Handler = (TxNode, u16, u8);

/// What ran so far, and what runs now.
#[derive(Clone, Debug, Default)]
pub(crate) struct Handlers {
    /// In the order of their ends.
    pub(crate) runs: Vec<HandlerRun>,
    running: HashMap<(TxNode, u16), VirtualInstant>,
    names: HashMap<(TxNode, u16), Rc<str>>,
}

impl Handlers {
    /// A handler begins or ends. Its name is asked for once.
    pub(crate) fn take(
        &mut self,
        (node, exception, priority): Handler,
        begins: bool,
        at: VirtualInstant,
        name: impl FnOnce() -> Option<String>,
    ) {
        let key = (node, exception);
        if begins {
            self.running.insert(key, at);
            return;
        }
        let Some(from) = self.running.remove(&key) else { return };
        let name = self
            .names
            .entry(key)
            .or_insert_with(|| name().unwrap_or_else(|| format!("exception {exception}")).into());
        self.runs.push(HandlerRun { node, name: name.clone(), exception, priority, from, until: at });
    }
}
