//! A program for the target, as it stands in its ELF file: functions, calls, and where code was written.

mod decode;
mod graph;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, SectionKind, SymbolKind};

pub(crate) use graph::{CallGraph, FunctionId};

type Reader = gimli::EndianArcSlice<gimli::RunTimeEndian>;

/// A function of the program.
#[derive(Debug)]
pub(crate) struct Function {
    pub(crate) start: u32,
    pub(crate) end: u32,
    /// Its path, without a hash.
    pub(crate) name: String,
}

/// A place in the source, and in which function.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Frame {
    /// The function, without generic arguments' hashes; empty if unknown.
    pub(crate) function: String,
    /// As the compiler knows it.
    pub(crate) file: String,
    pub(crate) line: u32,
}

/// A loaded program.
pub(crate) struct Program {
    /// In the order of their addresses.
    pub(crate) functions: Vec<Function>,
    /// Sections with an address and contents.
    sections: Vec<Section>,
    /// Where data begins and ends amidst code: address, and whether data follows.
    marks: BTreeMap<u32, bool>,
    lines: addr2line::Context<Reader>,
    /// Where the stack may be.
    pub(crate) stack: std::ops::Range<u32>,
}

struct Section {
    address: u32,
    bytes: Vec<u8>,
    name: String,
    is_code: bool,
}

impl Program {
    /// Reads an ELF file for Arm.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).with_context(|| format!("{} cannot be read", path.display()))?;
        Self::parse(&bytes).with_context(|| format!("{} is no program for the target", path.display()))
    }

    /// Takes the bytes of an ELF file for Arm.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self> {
        let file = object::File::parse(bytes)?;
        if file.architecture() != object::Architecture::Arm {
            bail!("it is an ELF file for {:?}, not for Arm", file.architecture());
        }
        let (mut functions, mut marks) = (BTreeMap::new(), BTreeMap::new());
        for symbol in file.symbols() {
            let (Ok(name), address) = (symbol.name(), symbol.address() as u32 & !1) else { continue };
            match name.split('.').next() {
                Some("$t") => {
                    marks.insert(address, false);
                }
                Some("$d") => {
                    marks.insert(address, true);
                }
                _ if symbol.kind() == SymbolKind::Text && symbol.size() > 0 => {
                    let name = format!("{:#}", rustc_demangle::demangle(name));
                    let end = address + symbol.size() as u32;
                    functions.entry(address).or_insert(Function { start: address, end, name });
                }
                _ => {}
            }
        }
        let mut sections = Vec::new();
        for section in file.sections().filter(|section| section.address() != 0 && section.size() > 0) {
            let is_code = section.kind() == SectionKind::Text;
            let has_contents = matches!(
                section.kind(),
                SectionKind::Text
                    | SectionKind::Data
                    | SectionKind::ReadOnlyData
                    | SectionKind::ReadOnlyString
            );
            if has_contents {
                let (address, bytes) = (section.address() as u32, section.data()?.to_vec());
                sections.push(Section { address, bytes, name: section.name()?.to_owned(), is_code });
            }
        }
        let lines = addr2line::Context::from_dwarf(dwarf(&file)?)?;
        let address = |name| file.symbol_by_name(name).map_or(0, |symbol| symbol.address() as u32);
        let stack = address("_stack_end")..address("_stack_start");
        Ok(Self { functions: functions.into_values().collect(), sections, marks, lines, stack })
    }

    /// The function at an address.
    pub(crate) fn function_at(&self, address: u32) -> Option<FunctionId> {
        let behind = self.functions.partition_point(|function| function.start <= address);
        let at = behind.checked_sub(1)?;
        (address < self.functions[at].end).then_some(FunctionId(at))
    }

    /// Who wrote the instruction at an address: the innermost function first, then those that it was inlined into.
    pub(crate) fn frames(&self, address: u32) -> Vec<Frame> {
        let Ok(mut found) = self.lines.find_frames(address.into()).skip_all_loads() else {
            return Vec::new();
        };
        let mut frames = Vec::new();
        while let Ok(Some(frame)) = found.next() {
            let name = frame.function.as_ref().and_then(|name| name.raw_name().ok());
            let function =
                name.map_or(String::new(), |name| format!("{:#}", rustc_demangle::demangle(&name)));
            let (file, line) =
                frame.location.map_or(("", 0), |at| (at.file.unwrap_or(""), at.line.unwrap_or(0)));
            frames.push(Frame { function, file: file.to_owned(), line });
        }
        frames
    }

    /// Addresses of all code, in pieces without data between.
    pub(crate) fn code(&self) -> impl Iterator<Item = std::ops::Range<u32>> {
        self.sections.iter().filter(|section| section.is_code).flat_map(|section| {
            let end = section.address + section.bytes.len() as u32;
            let mut pieces = Vec::new();
            let mut from = Some(section.address);
            for (&at, &is_data) in self.marks.range(section.address..end) {
                match (is_data, from) {
                    (true, Some(start)) => {
                        pieces.push(start..at);
                        from = None;
                    }
                    (false, None) => from = Some(at),
                    _ => {}
                }
            }
            pieces.extend(from.map(|start| start..end));
            pieces.retain(|piece| !piece.is_empty());
            pieces
        })
    }

    fn halfword(&self, address: u32) -> Option<u16> {
        let section = self.sections.iter().find(|section| {
            (section.address..section.address + section.bytes.len() as u32).contains(&address)
        })?;
        let at = (address - section.address) as usize;
        Some(u16::from_le_bytes(section.bytes.get(at..at + 2)?.try_into().ok()?))
    }
}

fn dwarf(file: &object::File<'_>) -> Result<gimli::Dwarf<Reader>> {
    let endian =
        if file.is_little_endian() { gimli::RunTimeEndian::Little } else { gimli::RunTimeEndian::Big };
    let load = |id: gimli::SectionId| -> Result<Reader> {
        let data = match file.section_by_name(id.name()) {
            Some(section) => section.uncompressed_data()?.into_owned(),
            None => Vec::new(),
        };
        Ok(gimli::EndianArcSlice::new(data.into(), endian))
    };
    gimli::Dwarf::load(load)
}

#[cfg(test)]
impl Program {
    /// A program of functions of 16 bytes each from address 0 on, and a table of vectors.
    pub(crate) fn of_parts(functions: &[(&str, Vec<u16>)], vectors: &[u32]) -> Self {
        let mut code = Vec::new();
        let mut list = Vec::new();
        for (number, (name, words)) in functions.iter().enumerate() {
            let start = 16 * number as u32;
            code.extend(words.iter().flat_map(|word| word.to_le_bytes()));
            let end = code.len() as u32;
            code.resize(16 * (number + 1), 0);
            list.push(Function { start, end, name: (*name).to_owned() });
        }
        let table = vectors.iter().flat_map(|word| word.to_le_bytes()).collect();
        let section =
            |address, bytes, name: &str, is_code| Section { address, bytes, name: name.to_owned(), is_code };
        let sections =
            vec![section(0, code, ".text", true), section(0x800_0000, table, ".vector_table", false)];
        let empty = |_| -> Result<Reader> {
            Ok(gimli::EndianArcSlice::new(Vec::new().into(), gimli::RunTimeEndian::Little))
        };
        let lines =
            gimli::Dwarf::load(empty).and_then(|dwarf| Ok(addr2line::Context::from_dwarf(dwarf)?)).unwrap();
        Self { functions: list, sections, marks: BTreeMap::new(), lines, stack: 0..0 }
    }
}
