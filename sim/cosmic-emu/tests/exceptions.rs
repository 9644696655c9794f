//! Exceptions: entry, return, nesting, tail-chaining, masks, saved context.

mod support;

use cosmic_emu::{CpuFault, ObservationKind, ResetCause, StopReason};
use support::register::{ICSR, TIM2};
use support::{HSI_PERIOD_NS, Program, edges, order, run};

/// Cycles between two edges.
fn cycles(from: (u64, u8, bool), to: (u64, u8, bool)) -> f64 {
    (to.0 - from.0) as f64 / HSI_PERIOD_NS
}

#[test]
fn a_compare_interrupt_comes_at_the_exact_tick() {
    let mut program = Program::default();
    program.handler(16 + 28, |asm| {
        asm.set(1).write(TIM2 + 0x10, 0); // SR
    });
    program.main(|asm| {
        asm.set_up().enable_interrupt(28, 0);
        // CCR1, DIER, and CR1.CEN with pin 0 one instruction behind it.
        asm.write(TIM2 + 0x34, 1000).write(TIM2 + 0x0C, 2);
        asm.load(0, TIM2).load(1, 1).load(2, support::register::GPIOA_BSRR);
        asm.halves(&[0x6001, 0x6011]).sleep(); // str r1, [r0]; str r1, [r2]
    });
    let edges = edges(&run(&program, 200));
    assert_eq!(edges.len(), 2);
    // The counter starts one cycle before the edge of pin 0. The entry takes 12 cycles, the handler writes
    // its pin with its fifth instruction.
    let expected = 1000.0 - 1.0 + 12.0 + 5.0;
    assert!((cycles(edges[0], edges[1]) - expected).abs() < 0.02, "{edges:?}");
}

#[test]
fn urgent_interrupts_nest_and_equal_ones_wait() {
    let mut program = Program::default();
    program.handler(16, |asm| {
        asm.set(0).pend(1).pend(2).clear(0);
    });
    program.handler(17, |asm| {
        asm.set(1).clear(1);
    });
    program.handler(18, |asm| {
        asm.set(2).clear(2);
    });
    program.main(|asm| {
        asm.set_up().enable_interrupt(0, 0x20).enable_interrupt(1, 0x10).enable_interrupt(2, 0x20);
        asm.pend(0).set(3).sleep();
    });
    let on = |pin| (pin, true);
    let off = |pin| (pin, false);
    let expected = [on(0), on(1), off(1), off(0), on(2), off(2), on(3)];
    assert_eq!(order(&run(&program, 100)), expected);
}

#[test]
fn basepri_and_primask_hold_back_and_the_most_urgent_comes_first() {
    for (mask, unmask) in [
        // movs r4, #0x10; msr basepri, r4 ... movs r4, #0; msr basepri, r4
        (&[0x2410, 0xF384, 0x8811][..], &[0x2400, 0xF384, 0x8811][..]),
        // cpsid i ... cpsie i
        (&[0xB672], &[0xB662]),
    ] {
        let mut program = Program::default();
        for number in 0..2 {
            program.handler(16 + number, |asm| {
                asm.set(number).clear(number);
            });
        }
        program.main(|asm| {
            asm.set_up().enable_interrupt(0, 0x20).enable_interrupt(1, 0x10);
            asm.halves(mask).pend(0).pend(1).set(3).halves(unmask).set(4).sleep();
        });
        let seen = run(&program, 100);
        let expected = [(3, true), (1, true), (1, false), (0, true), (0, false), (4, true)];
        assert_eq!(order(&seen), expected);
        // Between the two handlers lie the return (1 cycle), the change of handlers (6), and the second
        // handler's first five instructions.
        let edges = edges(&seen);
        assert!((cycles(edges[2], edges[3]) - 12.0).abs() < 0.02, "{edges:?}");
    }
}

#[test]
fn the_context_survives_a_handler_that_destroys_it() {
    let mut program = Program::default();
    program.handler(11, |asm| {
        for register in [0, 1, 2, 3, 12] {
            asm.load(register, 0xDEAD_BEEF);
        }
        // vmov s0, r0; vmov s15, r0; cmp r0, r0
        asm.halves(&[0xEE00, 0x0A10, 0xEE07, 0x0A90, 0x4280]);
    });
    program.main(|asm| {
        asm.set_up();
        for register in 0..13 {
            asm.load(register, 0x1111 * (1 + u32::from(register)));
        }
        // vmov s0, r4; vmov s15, r5; cmp r0, r1 (not equal); svc 0; beq to the bkpt at the end
        asm.halves(&[0xEE00, 0x4A10, 0xEE07, 0x5A90, 0x4288, 0xDF00]);
        asm.halves(&[0xD100, 0xBE01]); // bne over the bkpt
        for register in [0_u16, 1, 2, 3, 12] {
            asm.load(7, 0x1111 * (1 + u32::from(register)));
            // cmp rN, r7 (the encoding for all registers); beq over the bkpt
            asm.halves(&[0x4500 | (register & 8) << 4 | 7 << 3 | register & 7, 0xD000, 0xBE02]);
        }
        // vmov r7, s0; cmp r7, r4; vmov r7, s15; cmp r7, r5
        asm.halves(&[0xEE10, 0x7A10, 0x42A7, 0xD000, 0xBE03, 0xEE17, 0x7A90, 0x42AF, 0xD000, 0xBE04]);
        asm.set(0).sleep();
    });
    assert_eq!(order(&run(&program, 100)), [(0, true)]);
}

#[test]
fn a_thread_on_the_process_stack_comes_back_to_it() {
    let mut program = Program::default();
    program.handler(14, |asm| {
        asm.set(1);
    });
    program.main(|asm| {
        asm.set_up().load(0, support::RAM + 0x1004);
        // msr psp, r0; movs r1, #2; msr control, r1; isb
        asm.halves(&[0xF380, 0x8809, 0x2102, 0xF381, 0x8814, 0xF3BF, 0x8F6F]);
        asm.write(ICSR, 1 << 28);
        // mov r3, sp; cmp with the value; mrs r2, control; cmp r2, #2
        asm.load(0, support::RAM + 0x1004).halves(&[0x466B, 0x4283, 0xD000, 0xBE01]);
        asm.halves(&[0xF3EF, 0x8214, 0x2A02, 0xD000, 0xBE02]);
        asm.set(0).sleep();
    });
    assert_eq!(order(&run(&program, 100)), [(1, true), (0, true)]);
}

#[test]
fn systick_ticks_at_its_period() {
    let mut program = Program::default();
    program.handler(15, |asm| {
        asm.load(0, support::register::GPIOA_ODR);
        asm.halves(&[0x6801, 0xF081, 0x0101, 0x6001]); // ldr; eor r1, r1, #1; str
    });
    program.main(|asm| {
        asm.set_up().write(0xE000_E014, 1599).write(0xE000_E018, 0).write(0xE000_E010, 7).sleep();
    });
    let edges = edges(&run(&program, 1000));
    assert_eq!(edges.len(), 9);
    assert!(edges.windows(2).all(|pair| pair[1].0 - pair[0].0 == 100_000), "{edges:?}");
}

#[test]
fn faults_end_a_node_and_name_the_place() {
    let mut program = Program::default();
    program.main(|asm| {
        asm.function("crash").load(0, 0x6000_0000).half(0x6801);
    });
    let seen = run(&program, 100);
    let [only] = &seen[..] else { panic!("{seen:?}") };
    let ObservationKind::Stopped { reason: StopReason::Fault(CpuFault::Access { address, .. }), place } =
        &only.kind
    else {
        panic!("{only:?}")
    };
    assert_eq!((*address, place.symbol.as_deref()), (0x6000_0000, Some("crash + 0x8")));
    assert_eq!(
        only.kind.to_string(),
        "stopped by read of unmapped or protected address 0x60000000 at 0x08000208 (crash + 0x8)"
    );
}

#[test]
fn a_reset_starts_the_program_again() {
    let mut program = Program::default();
    program.main(|asm| {
        asm.set_up().set(0).write(0xE000_ED0C, 0x05FA_0004).sleep();
    });
    let seen = run(&program, 20);
    let resets = seen.iter().filter(|seen| seen.kind == ObservationKind::Reset(ResetCause::Software)).count();
    let pins = seen.iter().filter(|seen| matches!(seen.kind, ObservationKind::Pin { .. })).count();
    assert!(resets > 3 && pins >= resets && resets + pins == seen.len(), "{seen:?}");
}
