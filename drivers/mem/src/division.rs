//! Division of 64 by 64 bits, a bit at a time.
//!
//! The compiler's own takes 900 bytes to be quick where both are long. What a node divides are spans of time, some tens
//! of times a second: this takes 14 cycles for each bit of the dividend, and a seventh of the room.
//! `qemu-tests/src/bin/division.rs` checks it.

// Dividend in r0 and r1, divisor in r2 and r3; quotient to r0 and r1, remainder to r2 and r3 (Run-time ABI for the Arm
// architecture, 4.3.1). That nobody divides by zero is asked before; the result would be a number all the same.
core::arch::global_asm!(
    "
    .syntax unified
    .section .text.cosmic_mem_divide, \"ax\", %progbits
    .global __aeabi_uldivmod
    .type __aeabi_uldivmod, %function
    .thumb_func
__aeabi_uldivmod:
    push {{r4, r5, r6, lr}}
    movs r4, #0
    movs r5, #0
    movs r6, #64
    // Zeros at the top of the dividend are passed over: first 32, then those that are left.
    cbnz r1, 4f
    movs r1, r0
    movs r0, #0
    movs r6, #32
4:  clz r12, r1
    subs r6, r6, r12
    beq 5f
    lsl r1, r1, r12
    rsb lr, r12, #32
    lsr lr, r0, lr
    orr r1, r1, lr
    lsl r0, r0, r12
    // The dividend goes out at the top into the remainder, while the quotient comes in at the bottom.
1:  adds r0, r0, r0
    adcs r1, r1, r1
    adcs r4, r4, r4
    adcs r5, r5, r5
    // The remainder has 65 bits now if its divisor has 64: then it is larger.
    bcs 2f
    cmp r4, r2
    sbcs r12, r5, r3
    blo 3f
2:  subs r4, r4, r2
    sbcs r5, r5, r3
    adds r0, r0, #1
3:  subs r6, r6, #1
    bne 1b
5:  mov r2, r4
    mov r3, r5
    pop {{r4, r5, r6, pc}}
    .size __aeabi_uldivmod, . - __aeabi_uldivmod

    .section .text.cosmic_mem_divide_signed, \"ax\", %progbits
    .global __aeabi_ldivmod
    .type __aeabi_ldivmod, %function
    .thumb_func
__aeabi_ldivmod:
    push {{r4, r5, r6, lr}}
    // All bits of the sign; with it a number is negated by flipping the bits and taking it away.
    asrs r4, r1, #31
    asrs r5, r3, #31
    eors r0, r0, r4
    eors r1, r1, r4
    subs r0, r0, r4
    sbcs r1, r1, r4
    eors r2, r2, r5
    eors r3, r3, r5
    subs r2, r2, r5
    sbcs r3, r3, r5
    // The sign of the quotient; the remainder has that of the dividend.
    eors r5, r5, r4
    bl __aeabi_uldivmod
    eors r0, r0, r5
    eors r1, r1, r5
    subs r0, r0, r5
    sbcs r1, r1, r5
    eors r2, r2, r4
    eors r3, r3, r4
    subs r2, r2, r4
    sbcs r3, r3, r4
    pop {{r4, r5, r6, pc}}
    .size __aeabi_ldivmod, . - __aeabi_ldivmod
    "
);
