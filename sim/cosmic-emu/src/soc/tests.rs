//! The address map, and what is said of accesses that are not modelled.

use super::*;

fn system() -> System {
    let pace = Rc::new(Pace::default());
    let can = CanController::Can1;
    let wiring = Wiring {
        error: ClockError::ZERO,
        crystal_hertz: 8_000_000,
        crystal_runs: true,
        supply_is_low: false,
        low_speed_hertz: 32_000,
        can,
    };
    System::new(&pace, VirtualInstant::from_ticks(0), wiring)
}

#[test]
fn the_bit_band_alias_reaches_single_bits() {
    let mut system = system();
    // RCC.AHB1ENR bit 3, then GPIOD.ODR bit 5 in output mode.
    system.write(0x4200_0000 + 0x2_3830 * 32 + 3 * 4, 4, 1);
    assert_eq!(system.read(0x4002_3830, 4), 0x0010_0008);
    system.write(0x4002_0C00, 4, 1 << 10);
    system.write(0x4200_0000 + 0x2_0C14 * 32 + 5 * 4, 4, 1);
    let kinds: Vec<_> = system.take_happenings().iter().map(|happening| happening.kind).collect();
    assert_eq!(kinds, [HappeningKind::Pin(3, 5, true)]);
}

#[test]
fn what_is_not_modelled_or_not_clocked_is_reported_once() {
    let mut system = system();
    for _ in 0..2 {
        system.write(0x4000_4400, 4, 1); // USART2
        system.read(0x4000_6404, 4); // CAN1 without clock
    }
    let kinds: Vec<_> = system.take_happenings().iter().map(|happening| happening.kind).collect();
    let (write, read) = (AccessKind::Write, AccessKind::Read);
    assert_eq!(
        kinds,
        [
            HappeningKind::NotModelled { access: write, address: 0x4000_4400, pc: 0 },
            HappeningKind::NotClocked { access: read, address: 0x4000_6404, pc: 0 },
        ]
    );
}

#[test]
fn bytes_and_halfwords_reach_their_part_of_a_word() {
    let mut system = system();
    system.write(0xE000_E400 + 28, 1, 0x50);
    system.write(0xE000_E400 + 29, 1, 0x60);
    assert_eq!(system.read(0xE000_E400 + 28, 4), 0x6050);
    assert_eq!(system.read(0xE000_E400 + 29, 1), 0x60);
    system.write(0x4002_3830, 1, 1);
    system.write(0x4002_0000 + 0x22, 2, 0x1234);
    assert_eq!(system.read(0x4002_0020, 4), 0x1234_0000);
}
