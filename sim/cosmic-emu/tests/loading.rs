//! What is refused as firmware, and with which words; RTT channels; watched functions.

mod support;

use cosmic_emu::{Cluster, Firmware, NodeConfig, ObservationKind};
use support::{FLASH, Program, RAM, elf, instant, quiet_bus};

fn refusal(bytes: Vec<u8>) -> String {
    let mut config = NodeConfig::new("node", "");
    config.firmware = Firmware::Bytes { name: "brake.elf".into(), bytes };
    match Cluster::new(quiet_bus()).add_node(config) {
        Ok(_) => panic!("it was accepted"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn refusals_name_the_file_and_the_remedy() {
    let missing = Cluster::new(quiet_bus()).add_node(NodeConfig::new("node", "/nowhere/brake"));
    let missing = missing.map_err(|error| error.to_string());
    assert!(missing.is_err_and(|text| text.starts_with("/nowhere/brake: cannot be read")));

    assert!(refusal(b"#!/bin/sh\n".to_vec()).starts_with("brake.elf: not an ELF file"));
    let mut other = elf(&[(FLASH, vec![0; 8])], &[]);
    other[18] = 62; // x86-64 in the machine field
    assert!(refusal(other).contains("for another machine"));
    let host = std::env::current_exe().and_then(std::fs::read);
    assert!(refusal(host.unwrap_or_else(|error| panic!("{error}"))).contains("for another machine"));

    assert!(refusal(elf(&[(FLASH + 0x100, vec![0; 8])], &[])).contains("initial stack pointer"));
    assert!(refusal(elf(&[], &[])).contains("nothing is loaded there"));
    let far = refusal(elf(&[(0x9000_0000, vec![0; 16])], &[]));
    assert!(far.contains("segment 0x90000000 + 0x10 lies outside"), "{far}");
    let mut cut = Program::default()
        .main(|asm| {
            asm.sleep();
        })
        .elf();
    cut.truncate(60);
    assert!(refusal(cut).starts_with("brake.elf: "));
}

/// A control block with one up-channel, `records`, whose buffer of eight bytes follows.
fn control_block() -> Vec<u8> {
    let (name, buffer) = (RAM + 0x30, RAM + 0x40);
    let mut block = b"SEGGER RTT\0\0\0\0\0\0".to_vec();
    for word in [1, 0, name, buffer, 8, 3, 0, 0] {
        block.extend(u32::to_le_bytes(word));
    }
    block.extend(b"records\0abcdefgh12345678");
    block
}

#[test]
fn records_are_read_out_of_the_memory_of_the_node() {
    let mut program = Program::default();
    program.data("_SEGGER_RTT", RAM, control_block()).main(|asm| {
        // Around the end of the buffer: write position 3, then read from 3 to 1.
        asm.load(4, 20_000).halves(&[0x3C01, 0xD1FD]);
        asm.write(RAM + 0x24, 1).sleep();
    });
    let mut cluster = Cluster::new(quiet_bus());
    cluster.add_node(program.node("node")).unwrap_or_else(|error| panic!("{error}"));
    cluster.run_until(instant(10_000));
    let records: Vec<_> = cluster.take_observations().into_iter().map(|seen| seen.kind).collect();
    let record =
        |bytes: &[u8]| ObservationKind::Record { channel: "records".to_owned(), bytes: bytes.to_vec() };
    assert_eq!(records, [record(b"123"), record(b"456781")]);
}

#[test]
fn watched_functions_count_instructions_between_them() {
    let mut program = Program::default();
    program.main(|asm| {
        asm.function("app::publish").halves(&[0xBF00; 10]);
        asm.function("app::done").halves(&[0x2000, 0x3801, 0xD5FD]); // movs; subs; bpl
        asm.sleep();
    });
    let mut cluster = Cluster::new(quiet_bus());
    let node = cluster.add_node(program.node("node")).unwrap_or_else(|error| panic!("{error}"));
    assert!(cluster.watch(node, "publish").is_ok() && cluster.watch(node, "app::done").is_ok());
    assert!(cluster.watch(node, "nobody").is_err_and(|error| error.to_string().contains("inlined")));
    cluster.run_until(instant(100));
    let reached: Vec<_> = cluster
        .take_observations()
        .into_iter()
        .filter_map(|seen| match seen.kind {
            ObservationKind::Reached { place, instructions } => Some((place.symbol?, instructions)),
            _ => None,
        })
        .collect();
    assert_eq!(reached, [("app::publish".to_owned(), 0), ("app::done".to_owned(), 10)]);
    assert_eq!(cluster.instructions(node), 10 + 3 + 1);
}
