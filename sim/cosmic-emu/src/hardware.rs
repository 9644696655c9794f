//! The hardware of a node: a core with its memories and peripherals, as it comes out of power-on or of a reset.

use std::cell::RefCell;
use std::rc::Rc;

use cosmic_bus::VirtualInstant;

use crate::cpu::{Cpu, Interpreter, Io, Pace, Register};
use crate::image::Image;
use crate::memory;
use crate::node_config::NodeConfig;
use crate::observation::ResetCause;
use crate::soc::{System, Wiring};

pub(crate) type Hardware = (Box<dyn Cpu>, Rc<Pace>, Rc<RefCell<System>>);

/// A part that is switched on at `at`.
pub(crate) fn power_on(config: &NodeConfig, image: &Image, at: VirtualInstant) -> Hardware {
    let pace = Rc::new(Pace::default());
    let system = System::new(&pace, at, wiring(config));
    let (mut cpu, pace, system) = out_of_reset(config, image, pace, system);
    // Does not fail: the loader has checked that there is RAM.
    for (address, bytes) in &image.ram {
        let _ = cpu.write_memory(*address, bytes);
    }
    (cpu, pace, system)
}

/// A part that is reset at `at`.
pub(crate) fn reset(
    config: &NodeConfig,
    image: &Image,
    at: VirtualInstant,
    cpu: &dyn Cpu,
    system: &System,
    cause: ResetCause,
) -> Hardware {
    let pace = Rc::new(Pace::default());
    let system = system.reset(&pace, at, wiring(config), cause);
    let (mut new, pace, system) = out_of_reset(config, image, pace, system);
    for region in [memory::RAM, memory::CCM] {
        let mut content = vec![0; region.size as usize];
        // Neither fails: both cores have both.
        let _ = cpu.read_memory(region.base, &mut content);
        let _ = new.write_memory(region.base, &content);
    }
    (new, pace, system)
}

fn wiring(config: &NodeConfig) -> Wiring {
    Wiring {
        error: config.clock_error,
        crystal_hertz: config.crystal.to_Hz(),
        crystal_runs: config.crystal_runs,
        supply_is_low: config.supply_is_low,
        low_speed_hertz: config.low_speed.to_Hz(),
        can: config.can,
    }
}

/// A core at its reset vector, with its peripherals; RAM is empty.
fn out_of_reset(config: &NodeConfig, image: &Image, pace: Rc<Pace>, system: System) -> Hardware {
    let system = Rc::new(RefCell::new(system));
    let io: Rc<RefCell<dyn Io>> = system.clone();
    let system_memory = memory::system_memory(config.unique_id);
    let rom = [
        (memory::FLASH, image.flash.as_slice()),
        (memory::BOOT_ALIAS, image.flash.as_slice()),
        (memory::SYSTEM, system_memory.as_slice()),
    ];
    let mut cpu = Interpreter::new(&rom, &[memory::RAM, memory::CCM], &memory::IO, &io, &pace);
    // Does not fail: the loader has checked that the vector table is there.
    let vector = |cpu: &Interpreter, number: u32| cpu.read_word(memory::FLASH.base + 4 * number).unwrap_or(0);
    let (stack, reset) = (vector(&cpu, 0), vector(&cpu, 1));
    cpu.set_register(Register::Msp, stack);
    cpu.set_register(Register::Lr, u32::MAX);
    cpu.set_register(Register::Pc, reset);
    (Box::new(cpu), pace, system)
}
