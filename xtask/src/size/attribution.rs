//! Which crate a byte of an image came from, by its debug information.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};

use anyhow::Result;
use gimli::{AttributeValue, DebuggingInformationEntry, Dwarf, EndianSlice, RunTimeEndian};
use object::{Object as _, ObjectSection as _, SectionKind};

use crate::program::Program;

type Reader<'a> = EndianSlice<'a, RunTimeEndian>;
type Unit<'a> = gimli::Unit<Reader<'a>>;
type Entry<'a> = DebuggingInformationEntry<Reader<'a>>;
type Offset = gimli::UnitOffset<usize>;

/// Bytes of code by their owner: the crate that the code was written in, or that it was written for.
///
/// What a crate inlines of the library (iterators, integers, slices) is its own: an instruction counts for the innermost
/// function that is not of the library, of those that were inlined into each other. Functions of the library that stand
/// alone, and code without debug information, such as that of the start, count for [`LIBRARY`].
pub(super) fn owners(program: &Program) -> BTreeMap<String, u64> {
    let mut owners = BTreeMap::new();
    for piece in program.code() {
        for address in piece.clone().step_by(2) {
            let frames = program.frames(address);
            let owner = frames.iter().find_map(|frame| owner(&frame.file)).unwrap_or(LIBRARY);
            let bytes = owners.entry(owner.to_owned()).or_default();
            *bytes += u64::from((piece.end - address).min(2));
        }
    }
    owners
}

/// The crate that a source file belongs to; `None` for the library.
fn owner(file: &str) -> Option<&str> {
    if file.is_empty() || file.contains("/library/") || file.contains("compiler_builtins") {
        return None;
    }
    if let Some((_, rest)) = file.split_once("/registry/src/") {
        // index/name-version/...
        let folder = rest.split('/').nth(1)?;
        return folder.rsplit_once('-').map(|(name, _)| name);
    }
    let (before, _) = file.split_once("/src/")?;
    before.rsplit('/').next()
}

/// Who owns what nobody else does.
const LIBRARY: &str = "library and start";

fn is_in(ranges: &[(u64, u64)], address: u64) -> bool {
    ranges.iter().any(|&(start, end)| (start..end).contains(&address))
}

/// Bytes of variables that are of a type of the crate, or parts of variables that are.
pub(super) fn variable_bytes(file: &object::File<'_>, crate_name: &str) -> Result<u64> {
    let sections = Sections::load(file)?;
    let dwarf = sections.dwarf(file);
    let writable: Vec<(u64, u64)> = file
        .sections()
        .filter(|section| matches!(section.kind(), SectionKind::Data | SectionKind::UninitializedData))
        .map(|section| (section.address(), section.address() + section.size()))
        .collect();
    let mut counted = BTreeMap::new();
    let mut units = dwarf.units();
    while let Some(header) = units.next()? {
        let unit = dwarf.unit(header)?;
        let types = Types { unit: &unit, ours: types_of(&dwarf, &unit, crate_name)? };
        let mut entries = unit.entries();
        while let Some(entry) = entries.next_dfs()? {
            if entry.tag() != gimli::DW_TAG_variable {
                continue;
            }
            let Some(address) = static_address(&unit, entry)? else { continue };
            if is_in(&writable, address) {
                counted.insert(address, types.bytes_of(entry, DEEPEST)?);
            }
        }
    }
    Ok(counted.values().sum())
}

/// Where a variable stands, if its place is fixed.
fn static_address(unit: &Unit<'_>, variable: &Entry<'_>) -> Result<Option<u64>> {
    let Some(AttributeValue::Exprloc(expression)) = variable.attr_value(gimli::DW_AT_location) else {
        return Ok(None);
    };
    let mut operations = expression.operations(unit.encoding());
    Ok(match operations.next()? {
        Some(gimli::Operation::Address { address }) => Some(address),
        _ => None,
    })
}

/// The types that stand in the namespace of a crate.
fn types_of(dwarf: &Dwarf<Reader<'_>>, unit: &Unit<'_>, crate_name: &str) -> Result<HashSet<usize>> {
    let mut ours = HashSet::new();
    // The depth of the namespace that we are in.
    let mut inside: Option<isize> = None;
    let mut entries = unit.entries();
    while let Some(entry) = entries.next_dfs()? {
        let depth = entry.depth();
        inside = inside.filter(|&namespace| depth > namespace);
        if inside.is_some() {
            ours.insert(entry.offset().0);
        } else if entry.tag() == gimli::DW_TAG_namespace
            && let Some(name) = entry.attr_value(gimli::DW_AT_name)
            && dwarf.attr_string(unit, name)?.slice() == crate_name.as_bytes()
        {
            inside = Some(depth);
        }
    }
    Ok(ours)
}

struct Types<'u, 'a> {
    unit: &'u Unit<'a>,
    ours: HashSet<usize>,
}

impl Types<'_, '_> {
    /// How much of a variable or field is of our types.
    fn bytes_of(&self, entry: &Entry<'_>, deepest: u32) -> Result<u64> {
        let Some(AttributeValue::UnitRef(offset)) = entry.attr_value(gimli::DW_AT_type) else { return Ok(0) };
        let kind = self.unit.entry(offset)?;
        let size = kind.attr_value(gimli::DW_AT_byte_size).and_then(|size| size.udata_value()).unwrap_or(0);
        if self.ours.contains(&offset.0) {
            return Ok(size);
        }
        let Some(deeper) = deepest.checked_sub(1) else { return Ok(0) };
        match kind.tag() {
            gimli::DW_TAG_array_type => self.of_array(offset, &kind, deeper),
            gimli::DW_TAG_structure_type => self.of_fields(offset, deeper, |sum, field| sum + field),
            // Only one of the fields is there.
            gimli::DW_TAG_union_type => self.of_fields(offset, deeper, u64::max),
            _ => Ok(0),
        }
    }

    fn of_fields(&self, offset: Offset, deepest: u32, join: fn(u64, u64) -> u64) -> Result<u64> {
        let mut tree = self.unit.entries_tree(Some(offset))?;
        let mut children = tree.root()?.children();
        let mut bytes = 0;
        while let Some(child) = children.next()? {
            if child.entry().tag() == gimli::DW_TAG_member {
                bytes = join(bytes, self.bytes_of(child.entry(), deepest)?);
            }
        }
        Ok(bytes)
    }

    fn of_array(&self, offset: Offset, array: &Entry<'_>, deepest: u32) -> Result<u64> {
        let mut tree = self.unit.entries_tree(Some(offset))?;
        let mut children = tree.root()?.children();
        let mut count = 0;
        while let Some(child) = children.next()? {
            let value = child.entry().attr_value(gimli::DW_AT_count);
            count = value.and_then(|value| value.udata_value()).unwrap_or(count);
        }
        Ok(count * self.bytes_of(array, deepest)?)
    }
}

/// No variable nests deeper; it keeps a damaged file from an endless search.
const DEEPEST: u32 = 24;

/// The debug sections of a file, uncompressed.
struct Sections<'a>(gimli::DwarfSections<Cow<'a, [u8]>>);

impl<'a> Sections<'a> {
    fn load(file: &object::File<'a>) -> Result<Self> {
        let load = |id: gimli::SectionId| -> Result<Cow<'a, [u8]>> {
            match file.section_by_name(id.name()) {
                Some(section) => Ok(section.uncompressed_data()?),
                None => Ok(Cow::Borrowed(&[])),
            }
        };
        Ok(Self(gimli::DwarfSections::load(load)?))
    }

    fn dwarf(&self, file: &object::File<'_>) -> Dwarf<Reader<'_>> {
        let endian = if file.is_little_endian() { RunTimeEndian::Little } else { RunTimeEndian::Big };
        self.0.borrow(|section| EndianSlice::new(section, endian))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_belongs_to_the_crate_that_it_is_in() {
        let registry =
            "/home/me/.cargo/registry/src/index.crates.io-1949cf8c6b5b557f/rtic-time-3.0.0/src/lib.rs";
        assert_eq!(owner(registry), Some("rtic-time"));
        assert_eq!(owner("/work/cosmic/cosmic-core/src/network/soft/queue.rs"), Some("cosmic-core"));
        assert_eq!(owner("boards/src/clock.rs"), Some("boards"));
        assert_eq!(owner("/rustc/59807616e1fa/library/core/src/slice/mod.rs"), None);
        assert_eq!(owner(""), None);
    }
}
