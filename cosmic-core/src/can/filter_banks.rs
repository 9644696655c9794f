//! From what a node wants to receive to the acceptance filters of its controller.
//!
//! A bxCAN controller has a number of filter banks. At a scale of 32 bits, a bank accepts either the
//! identifiers that agree with one identifier in the bits of a mask, or two single identifiers
//! (RM0090, bxCAN identifier filtering). A frame that no bank accepts costs the processor nothing; one
//! that is accepted though nobody wants it costs an interrupt.
//!
//! A node subscribes to etags, whoever sends them and with whatever priority, so it needs masks; of a
//! hard real-time slot it knows the whole identifier. If there are banks enough, each wish has its own
//! bank, or shares one of two single identifiers, and nothing else is accepted. If not, wishes share a
//! mask, and the plan looks for those that have most bits in common:
//!
//! 1. Merge the two banks whose common mask accepts the fewest additional identifiers, until the banks
//!    suffice.
//! 2. Move single wishes between banks as long as that accepts fewer.
//!
//! This finds the optimum for most small sets, and never rejects what is wanted. What a bank accepts is
//! counted in identifiers, all taken as equally likely.

use super::{Etag, Id, Priority, TxNode};

/// The receive FIFO of a controller that accepted frames go to.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fifo {
    /// FIFO 0, for what must be read at once: hard real-time and clock synchronisation.
    Urgent,
    /// FIFO 1, for the rest.
    Other,
}

/// Identifiers that a node wants: those that agree with one in the bits of a mask.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Wanted {
    fifo: Fifo,
    id: u32,
    mask: u32,
}

impl Wanted {
    /// Everything.
    pub const ALL: Self = Self { fifo: Fifo::Other, id: 0, mask: 0 };

    /// The frames of all etags that a broker gives: from [`Etag::BOUND_FIRST`] up, one of the four highest bits is set.
    pub const BOUND: [Self; 4] = [Self::bit(13), Self::bit(12), Self::bit(11), Self::bit(10)];

    /// All frames of a channel or protocol message.
    pub const fn etag(fifo: Fifo, etag: Etag) -> Self {
        Self::masked(fifo, Id::new(Priority::HARD, TxNode::MIN, etag), ETAG_BITS)
    }

    /// The frames of a hard real-time slot.
    pub const fn hard(etag: Etag, publisher: TxNode) -> Self {
        Self::masked(Fifo::Urgent, Id::new(Priority::HARD, publisher, etag), ID_BITS)
    }

    /// All frames of a node.
    pub const fn tx_node(fifo: Fifo, tx_node: TxNode) -> Self {
        Self::masked(fifo, Id::new(Priority::HARD, tx_node, Etag::SYNC), TX_NODE_BITS)
    }

    /// The identifiers that agree with `id` in the bits that are set in `mask`. Of the mask, the low 29
    /// bits count.
    pub const fn masked(fifo: Fifo, id: Id, mask: u32) -> Self {
        Self { fifo, id: id.raw() & mask, mask: mask & ID_BITS }
    }

    /// Returns whether this identifier is among them.
    pub const fn contains(&self, id: Id) -> bool {
        (id.raw() ^ self.id) & self.mask == 0
    }

    /// Where this bit is set.
    const fn bit(bit: u32) -> Self {
        Self { fifo: Fifo::Other, id: 1 << bit, mask: 1 << bit }
    }

    /// The bank that accepts these and no others.
    pub const fn bank(&self) -> FilterBank {
        let Self { fifo, id, mask } = *self;
        FilterBank::Mask { fifo, id, mask }
    }

    /// Returns whether all identifiers of `other` are among them.
    const fn covers(&self, other: &Self) -> bool {
        self.mask & !other.mask == 0 && (self.id ^ other.id) & self.mask == 0
    }
}

/// What to write into one filter bank of 32-bit scale. Both kinds accept extended data frames only.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FilterBank {
    /// Identifier mask mode.
    Mask {
        /// Where accepted frames go.
        fifo: Fifo,
        /// The 29 bits to agree with; zero where the mask is zero.
        id: u32,
        /// The bits that count.
        mask: u32,
    },
    /// Identifier list mode.
    List {
        /// Where accepted frames go.
        fifo: Fifo,
        /// Two identifiers, which may be the same.
        ids: [Id; 2],
    },
}

impl FilterBank {
    /// Where accepted frames go.
    pub const fn fifo(&self) -> Fifo {
        match self {
            Self::Mask { fifo, .. } | Self::List { fifo, .. } => *fifo,
        }
    }

    /// Returns whether it accepts extended data frames of this identifier.
    pub fn accepts(&self, id: Id) -> bool {
        match self {
            Self::Mask { id: wanted, mask, .. } => (id.raw() ^ wanted) & mask == 0,
            Self::List { ids, .. } => ids.contains(&id),
        }
    }

    /// The two registers of the bank, CAN_FiR1 and CAN_FiR2: identifiers, or an identifier and its mask,
    /// in bits 31..3, IDE in bit 2, RTR in bit 1.
    pub const fn registers(&self) -> [u32; 2] {
        const IDE: u32 = 1 << 2;
        const RTR: u32 = 1 << 1;
        match self {
            Self::Mask { id, mask, .. } => [*id << 3 | IDE, *mask << 3 | IDE | RTR],
            Self::List { ids: [first, second], .. } => [first.raw() << 3 | IDE, second.raw() << 3 | IDE],
        }
    }
}

/// Why there is no plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FilterBanksError {
    /// More is wanted than the plan has room for: raise the capacity `WANTED`.
    TooManyWanted,
    /// There is not one bank for each FIFO that is used.
    TooFewBanks,
}

/// Filters for up to `BANKS` banks, to be written in this order to banks of ascending number.
///
/// Frames that are wanted in the urgent FIFO go there. One that is wanted in the other FIFO may come
/// through the urgent one, if a mask there accepts it by the way: the receiver looks at the etag, not at
/// the FIFO. A frame that several banks accept is stored once: list mode takes precedence, then the lower
/// number (RM0090, bxCAN filter priority rules).
///
/// ```
/// use cosmic_core::can::{Etag, TxNode, filter_banks::{Fifo, FilterBanks, Wanted}};
///
/// let wanted = [
///     Wanted::hard(Etag::HARD_FIRST, TxNode::MIN),
///     Wanted::etag(Fifo::Urgent, Etag::SYNC),
///     Wanted::etag(Fifo::Urgent, Etag::FOLLOW_UP),
///     Wanted::etag(Fifo::Other, Etag::SUPPLY_ETAG),
/// ];
/// // Sync (16) and follow-up (17) differ in one bit, so three banks suffice.
/// let banks = FilterBanks::<3>::plan::<8>(&wanted)?;
/// assert_eq!(banks.false_acceptance(), 0);
/// # Ok::<(), cosmic_core::can::filter_banks::FilterBanksError>(())
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FilterBanks<const BANKS: usize> {
    banks: [Option<FilterBank>; BANKS],
    false_acceptance: u32,
}

impl<const BANKS: usize> FilterBanks<BANKS> {
    /// The filters for what is wanted, at most `WANTED` wishes. Work: O(`WANTED`³).
    ///
    /// # Errors
    /// See [`FilterBanksError`].
    #[expect(clippy::arithmetic_side_effects, reason = "two at most")]
    pub fn plan<const WANTED: usize>(wanted: &[Wanted]) -> Result<Self, FilterBanksError> {
        if wanted.len() > WANTED {
            return Err(FilterBanksError::TooManyWanted);
        }
        let mut partition = Partition::<WANTED>::of_singles(wanted);
        let used = |fifo| partition.groups.iter().flatten().any(|group| group.fifo == fifo);
        if usize::from(used(Fifo::Urgent)) + usize::from(used(Fifo::Other)) > BANKS {
            return Err(FilterBanksError::TooFewBanks);
        }
        partition.merge(BANKS);
        partition.refine(BANKS);
        Ok(partition.banks())
    }

    /// The filters, urgent ones first.
    pub fn iter(&self) -> impl Iterator<Item = &FilterBank> {
        self.banks.iter().flatten()
    }

    /// Where frames of this identifier go; `None` if they are not accepted.
    pub fn accepts(&self, id: Id) -> Option<Fifo> {
        let lists = self.iter().filter(|bank| matches!(bank, FilterBank::List { .. }));
        let masks = self.iter().filter(|bank| matches!(bank, FilterBank::Mask { .. }));
        lists.chain(masks).find(|bank| bank.accepts(id)).map(FilterBank::fifo)
    }

    /// How many identifiers are accepted that nobody wants. Those that two banks accept count twice.
    pub const fn false_acceptance(&self) -> u32 {
        self.false_acceptance
    }
}

/// What one bank is to accept: wishes and the mask around them.
#[derive(Clone, Copy)]
struct Group {
    fifo: Fifo,
    id: u32,
    mask: u32,
    /// How many wishes.
    count: u32,
    /// All of them are single identifiers.
    single: bool,
}

impl Group {
    const fn of(wanted: &Wanted) -> Self {
        let Wanted { fifo, id, mask } = *wanted;
        Self { fifo, id, mask, count: 1, single: mask == ID_BITS }
    }

    /// `None` if they go to different FIFOs.
    #[expect(clippy::arithmetic_side_effects, reason = "one for each wish")]
    fn joined(&self, other: &Self) -> Option<Self> {
        if self.fifo != other.fifo {
            return None;
        }
        let mask = self.mask & other.mask & !(self.id ^ other.id);
        let single = self.single && other.single;
        Some(Self { id: self.id & mask, mask, count: self.count + other.count, single, ..*self })
    }

    const fn is_list(&self) -> bool {
        self.single && self.count <= 2
    }

    /// How many identifiers the bank accepts.
    const fn accepted(&self) -> i64 {
        if self.is_list() { self.count as i64 } else { self.covered() }
    }

    /// How many identifiers the mask around them accepts.
    #[expect(clippy::arithmetic_side_effects, reason = "a mask has no bits but those of an identifier")]
    const fn covered(&self) -> i64 {
        1 << (ID_BITS.count_ones() - self.mask.count_ones())
    }
}

/// Wishes, and the group that each belongs to.
struct Partition<const WANTED: usize> {
    members: [Option<(Wanted, usize)>; WANTED],
    groups: [Option<Group>; WANTED],
}

impl<const WANTED: usize> Partition<WANTED> {
    /// Each wish is a group of its own; those that others include are left out.
    fn of_singles(wanted: &[Wanted]) -> Self {
        let mut partition = Self { members: [None; WANTED], groups: [None; WANTED] };
        let places = partition.members.iter_mut().zip(&mut partition.groups).enumerate();
        for ((number, (member, group)), wish) in places.zip(wanted) {
            let included = wanted.iter().enumerate().any(|(other_number, other)| {
                // An urgent wish is not satisfied in the other FIFO. Of equals the first stays.
                other_number != number
                    && other.fifo <= wish.fifo
                    && other.covers(wish)
                    && (other.fifo < wish.fifo || !wish.covers(other) || other_number < number)
            });
            if !included {
                *member = Some((*wish, number));
                *group = Some(Group::of(wish));
            }
        }
        partition
    }

    fn count(&self) -> usize {
        self.groups.iter().flatten().count()
    }

    /// Joins groups until there are no more than `banks`, and those that others accept anyway.
    fn merge(&mut self, banks: usize) {
        while let Some((into, from, joined, cost)) = self.cheapest_join() {
            if self.count() <= banks && cost >= 0 {
                break;
            }
            for (_, group) in self.members.iter_mut().flatten() {
                if *group == from {
                    *group = into;
                }
            }
            self.set(into, Some(joined));
            self.set(from, None);
        }
    }

    /// The two groups that accept the fewest additional identifiers when they are joined; of several, the
    /// most alike.
    #[expect(clippy::arithmetic_side_effects, reason = "counts of identifiers, below 2^32")]
    fn cheapest_join(&self) -> Option<(usize, usize, Group, i64)> {
        let mut cheapest: Option<(usize, usize, Group, i64)> = None;
        for (number, group) in self.iter_groups() {
            for (other_number, other) in self.iter_groups().skip_while(|(other, _)| *other <= number) {
                let Some(joined) = group.joined(other) else { continue };
                let cost = joined.accepted() - group.accepted() - other.accepted();
                let better = cheapest.is_none_or(|(.., best, best_cost)| {
                    (cost, joined.covered()) < (best_cost, best.covered())
                });
                if better {
                    cheapest = Some((number, other_number, joined, cost));
                }
            }
        }
        cheapest
    }

    /// Moves single wishes to other groups, or to a group of their own if there is a bank left, while that
    /// accepts fewer identifiers.
    fn refine(&mut self, banks: usize) {
        for _ in 0..PASSES {
            let mut moved = false;
            for place in 0..WANTED {
                moved |= self.move_member(place, banks);
            }
            if !moved {
                break;
            }
        }
    }

    #[expect(clippy::arithmetic_side_effects, reason = "counts of identifiers, below 2^32")]
    fn move_member(&mut self, place: usize, banks: usize) -> bool {
        let Some(&Some((wish, from))) = self.members.get(place) else { return false };
        let Some(&Some(old)) = self.groups.get(from) else { return false };
        let rest = self.group_without(from, place);
        let saved = old.accepted() - rest.map_or(0, |rest| rest.accepted());
        let single = Group::of(&wish);
        let bank_left = self.count() < banks && rest.is_some();
        let mut best: Option<(usize, Group, i64)> = None;
        for (to, group) in self.groups.iter().enumerate() {
            let joined = match group {
                _ if to == from => None,
                Some(group) => group.joined(&single).map(|joined| (joined, group.accepted())),
                None if bank_left => Some((single, 0)),
                None => None,
            };
            let Some((joined, before)) = joined else { continue };
            let cost = joined.accepted() - before;
            if cost < saved && best.is_none_or(|(.., best)| cost < best) {
                best = Some((to, joined, cost));
            }
        }
        let Some((to, joined, _)) = best else { return false };
        self.set(from, rest);
        self.set(to, Some(joined));
        if let Some(Some((_, group))) = self.members.get_mut(place) {
            *group = to;
        }
        true
    }

    fn group_without(&self, number: usize, place: usize) -> Option<Group> {
        let rest = self.members.iter().enumerate().filter(|(at, _)| *at != place);
        let rest = rest.filter_map(|(_, member)| member.as_ref()).filter(|(_, group)| *group == number);
        rest.map(|(wish, _)| Group::of(wish)).reduce(|one, other| one.joined(&other).unwrap_or(one))
    }

    fn iter_groups(&self) -> impl Iterator<Item = (usize, &Group)> {
        self.groups.iter().enumerate().filter_map(|(number, group)| Some((number, group.as_ref()?)))
    }

    fn set(&mut self, number: usize, group: Option<Group>) {
        if let Some(place) = self.groups.get_mut(number) {
            *place = group;
        }
    }

    #[expect(
        clippy::arithmetic_side_effects,
        reason = "counts of identifiers, below 2^32 for each of the wishes"
    )]
    fn banks<const BANKS: usize>(&self) -> FilterBanks<BANKS> {
        let of = |fifo| self.iter_groups().filter(move |(_, group)| group.fifo == fifo);
        let mut banks = [None; BANKS];
        for (bank, (number, group)) in banks.iter_mut().zip(of(Fifo::Urgent).chain(of(Fifo::Other))) {
            *bank = Some(self.bank(number, group));
        }
        let wanted: i64 = self.members.iter().flatten().map(|(wish, _)| Group::of(wish).accepted()).sum();
        let accepted: i64 = self.groups.iter().flatten().map(Group::accepted).sum();
        FilterBanks { banks, false_acceptance: u32::try_from((accepted - wanted).max(0)).unwrap_or(u32::MAX) }
    }

    fn bank(&self, number: usize, group: &Group) -> FilterBank {
        let Group { fifo, id, mask, .. } = *group;
        let mut singles = self.members.iter().flatten().filter(|(_, of)| *of == number);
        let mut single = || singles.next().and_then(|(wish, _)| Id::from_raw(wish.id));
        match (group.is_list(), single()) {
            (true, Some(first)) => FilterBank::List { fifo, ids: [first, single().unwrap_or(first)] },
            _ => FilterBank::Mask { fifo, id, mask },
        }
    }
}

const ETAG_BITS: u32 = Etag::BOUND_LAST.get() as u32;
const ID_BITS: u32 = (1 << 29) - 1;
const TX_NODE_BITS: u32 = Id::new(Priority::HARD, TxNode::BROKER, Etag::SYNC).raw() & !ETAG_BITS;

/// Improvements by moving single wishes settle within a few passes.
const PASSES: usize = 8;

#[cfg(test)]
mod tests;
