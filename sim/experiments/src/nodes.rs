//! What the nodes of the cluster experiments have in common.

use anyhow::anyhow;
use cosmic_bus::{Filter, Filters};
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::BitRate;
use cosmic_core::can::filter_banks::{FilterBank, FilterBanks, Wanted};
use cosmic_core::time::Duration;
use embedded_can::ExtendedId;

/// No hard real-time channels.
pub(crate) static EMPTY_CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(100),
    &[],
);

/// The acceptance filters of a bxCAN controller for what a node wants, planned by the core.
pub(crate) fn hardware_filters(wanted: &[Wanted]) -> anyhow::Result<Filters> {
    let banks = FilterBanks::<BANKS>::plan::<MOST_WANTED>(wanted);
    let banks = banks.map_err(|error| anyhow!("no acceptance filters for {wanted:?}: {error:?}"))?;
    let extended = |raw: u32| ExtendedId::new(raw).unwrap_or(ExtendedId::ZERO).into();
    let filters = banks.iter().flat_map(|bank| match bank {
        FilterBank::Mask { id, mask, .. } => vec![Filter::new(extended(*id), false, *mask)],
        FilterBank::List { ids, .. } => ids.map(|id| Filter::exactly(extended(id.raw()))).to_vec(),
    });
    Ok(filters.collect())
}

/// Filter banks of one bxCAN controller (RM0090, bxCAN main features: 28, shared by two).
const BANKS: usize = 14;
const MOST_WANTED: usize = 32;
