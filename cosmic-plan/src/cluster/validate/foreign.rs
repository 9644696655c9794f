//! Frames that are not COSMIC's.

use super::{Checker, ZERO, start_of};
use crate::cluster::format::ForeignTable;
use crate::cluster::{Foreign, dbc};
use std::path::Path;

impl Checker<'_> {
    pub(super) fn foreign(&self, table: &ForeignTable, folder: &Path) -> Vec<Foreign> {
        let name = table.name.as_ref().map_or("", |at| at.value.as_str());
        let period = table.period.as_ref().map(|at| at.value.0);
        if let Some(at) = &table.dbc {
            let frames = dbc::read(&folder.join(&at.value), period).unwrap_or_else(|(what, help)| {
                self.problem(&at.place, "foreign.dbc".to_owned(), what, help);
                Vec::new()
            });
            for frame in frames.iter().filter(|frame| beats_hard(frame.id, frame.extended)) {
                let what = format!("{} would win against hard real-time frames", frame.name);
                self.problem(&at.place, "foreign.dbc".to_owned(), what, ABOVE_HARD);
            }
            return frames;
        }
        let (Some(id), Some(length), Some(period)) = (&table.id, &table.length, period) else {
            if table.malformed.is_empty() {
                let help = "write id, length and period of the frame, or dbc = \"file.dbc\"";
                self.problem(&start_of(&table.place), format!("foreign.{name}"), "is incomplete", help);
            }
            return Vec::new();
        };
        let extended = table.extended.as_ref().map_or(id.value > 0x7FF, |at| at.value);
        let limit: u32 = if extended { 0x1FFF_FFFF } else { 0x7FF };
        if id.value > limit {
            let help = format!("write at most {limit:#x}");
            self.problem(
                &id.place,
                format!("foreign.{name}.id"),
                format!("{:#x} is too large", id.value),
                help,
            );
        }
        if length.value > 8 {
            let what = format!("{} bytes are too many", length.value);
            self.problem(&length.place, format!("foreign.{name}.length"), what, "write at most 8");
        }
        if beats_hard(id.value, extended) {
            let what = "it would win against hard real-time frames, which have the priority 0";
            self.problem(&id.place, format!("foreign.{name}.id"), what, ABOVE_HARD);
        }
        let fallback = format!("{:#x}", id.value);
        vec![Foreign {
            name: if name.is_empty() { fallback } else { name.to_owned() },
            id: id.value,
            extended,
            length: length.value.min(8),
            period,
            jitter: table.jitter.as_ref().map_or(ZERO, |at| at.value.0),
            deadline: table.deadline.as_ref().map(|at| at.value.0),
        }]
    }
}

/// Returns whether the first eight bits are those of hard real-time, the priority 0.
fn beats_hard(id: u32, extended: bool) -> bool {
    if extended { id >> 21 == 0 } else { id >> 3 == 0 }
}

const ABOVE_HARD: &str = "choose identifiers from 0x8 (11 bits) or 0x200000 (29 bits) up";
