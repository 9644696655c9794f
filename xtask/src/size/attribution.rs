//! Which crate a byte of an image came from, by its debug information.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use anyhow::Result;
use gimli::{
    AttributeValue, DebuggingInformationEntry, Dwarf, EndianSlice, LineProgramHeader, RunTimeEndian,
};
use object::{Object as _, ObjectSection as _, SectionKind};

type Reader<'a> = EndianSlice<'a, RunTimeEndian>;
type Unit<'a> = gimli::Unit<Reader<'a>>;
type Entry<'a> = DebuggingInformationEntry<Reader<'a>>;
type Offset = gimli::UnitOffset<usize>;

/// Bytes of code whose source line is in a file whose path contains `directory`.
///
/// Code that was inlined counts for the file that it was written in.
pub(super) fn code_bytes(file: &object::File<'_>, directory: &str) -> Result<u64> {
    let sections = Sections::load(file)?;
    let dwarf = sections.dwarf(file);
    let text: Vec<(u64, u64)> = file
        .sections()
        .filter(|section| section.kind() == SectionKind::Text)
        .map(|section| (section.address(), section.address() + section.size()))
        .collect();
    // Rows of functions that the linker dropped or merged may name one place twice.
    let mut addresses = BTreeSet::new();
    let mut units = dwarf.units();
    while let Some(header) = units.next()? {
        let unit = dwarf.unit(header)?;
        let Some(program) = unit.line_program.clone() else { continue };
        let mut is_ours = HashMap::new();
        let mut rows = program.rows();
        let mut open: Option<u64> = None;
        while let Some((header, row)) = rows.next_row()? {
            if let Some(start) = open.take().filter(|start| is_in(&text, *start)) {
                addresses.extend(start..row.address());
            }
            if row.end_sequence() {
                continue;
            }
            let index = row.file_index();
            let ours = match is_ours.get(&index) {
                Some(&known) => known,
                None => {
                    let path = path(&dwarf, &unit, header, index)?;
                    *is_ours.entry(index).or_insert(path.contains(directory))
                }
            };
            open = ours.then(|| row.address());
        }
    }
    Ok(addresses.len() as u64)
}

fn is_in(ranges: &[(u64, u64)], address: u64) -> bool {
    ranges.iter().any(|&(start, end)| (start..end).contains(&address))
}

/// The path of a source file, as far as the line program knows it.
fn path(
    dwarf: &Dwarf<Reader<'_>>,
    unit: &Unit<'_>,
    header: &LineProgramHeader<Reader<'_>>,
    index: u64,
) -> Result<String> {
    let Some(file) = header.file(index) else { return Ok(String::new()) };
    let mut path = String::new();
    if let Some(directory) = file.directory(header) {
        path.push_str(&dwarf.attr_string(unit, directory)?.to_string_lossy());
        path.push('/');
    }
    path.push_str(&dwarf.attr_string(unit, file.path_name())?.to_string_lossy());
    Ok(path)
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
