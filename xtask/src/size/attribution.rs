//! Which crate a byte of an image came from, by its debug information.

use std::borrow::Cow;
use std::collections::{BTreeSet, HashMap};

use anyhow::Result;
use gimli::{
    AttributeValue, DebuggingInformationEntry, Dwarf, EndianSlice, LineProgramHeader, RunTimeEndian,
};
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, SectionKind, SymbolKind};

type Reader<'a> = EndianSlice<'a, RunTimeEndian>;
type Unit<'a> = gimli::Unit<Reader<'a>>;
type Entry<'u, 'a> = DebuggingInformationEntry<Reader<'a>>;

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

/// Bytes of variables whose type's name contains `path`.
pub(super) fn variable_bytes(file: &object::File<'_>, path: &str) -> Result<u64> {
    let sections = Sections::load(file)?;
    let dwarf = sections.dwarf(file);
    let sizes: HashMap<u64, u64> = file
        .symbols()
        .filter(|symbol| symbol.kind() == SymbolKind::Data)
        .map(|symbol| (symbol.address(), symbol.size()))
        .collect();
    let writable: Vec<(u64, u64)> = file
        .sections()
        .filter(|section| matches!(section.kind(), SectionKind::Data | SectionKind::UninitializedData))
        .map(|section| (section.address(), section.address() + section.size()))
        .collect();
    let mut counted = BTreeSet::new();
    let mut units = dwarf.units();
    while let Some(header) = units.next()? {
        let unit = dwarf.unit(header)?;
        let mut entries = unit.entries();
        while let Some(entry) = entries.next_dfs()? {
            if entry.tag() != gimli::DW_TAG_variable {
                continue;
            }
            let Some(address) = static_address(&unit, entry)? else { continue };
            if is_in(&writable, address) && type_name(&dwarf, &unit, entry)?.contains(path) {
                counted.insert(address);
            }
        }
    }
    Ok(counted.iter().filter_map(|address| sizes.get(address)).sum())
}

/// Where a variable stands, if its place is fixed.
fn static_address(unit: &Unit<'_>, variable: &Entry<'_, '_>) -> Result<Option<u64>> {
    let Some(AttributeValue::Exprloc(expression)) = variable.attr_value(gimli::DW_AT_location) else {
        return Ok(None);
    };
    let mut operations = expression.operations(unit.encoding());
    Ok(match operations.next()? {
        Some(gimli::Operation::Address { address }) => Some(address),
        _ => None,
    })
}

fn type_name<'a>(dwarf: &Dwarf<Reader<'a>>, unit: &Unit<'a>, entry: &Entry<'_, 'a>) -> Result<Cow<'a, str>> {
    let Some(AttributeValue::UnitRef(offset)) = entry.attr_value(gimli::DW_AT_type) else {
        return Ok(Cow::Borrowed(""));
    };
    let kind = unit.entry(offset)?;
    match kind.attr_value(gimli::DW_AT_name) {
        Some(name) => Ok(dwarf.attr_string(unit, name)?.to_string_lossy()),
        // An array has no name; its elements have.
        None if kind.tag() == gimli::DW_TAG_array_type => type_name(dwarf, unit, &kind),
        None => Ok(Cow::Borrowed("")),
    }
}

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
