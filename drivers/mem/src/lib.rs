//! `memcpy`, `memmove`, `memset` and long division for a Cortex-M3 or M4, for images that are to be small:
//! `use cosmic_mem as _;`.
//!
//! The compiler's own are written for speed over kilobytes, each once for every alignment, and take 3.5 KB of flash. What a
//! node copies is a frame, an event, a dozen words. These copy a word at a time, also where it is not aligned, which this
//! processor does by itself unless CCR.UNALIGN_TRP is set. They stand in for the compiler's, whose symbols are weak.
//! `qemu-tests/src/bin/memory.rs` compares them with loops, and `division.rs` beside it checks the division.
#![no_std]

#[cfg(all(target_arch = "arm", target_os = "none"))]
mod division;

// The arguments of `memset` and those of `__aeabi_memset` are in another order (Run-time ABI for the Arm architecture, 4.3.4).
#[cfg(all(target_arch = "arm", target_os = "none"))]
core::arch::global_asm!(
    "
    .syntax unified
    .section .text.cosmic_mem_copy, \"ax\", %progbits
    .global memmove, __aeabi_memmove, __aeabi_memmove4, __aeabi_memmove8
    .type memmove, %function
    .type __aeabi_memmove, %function
    .type __aeabi_memmove4, %function
    .type __aeabi_memmove8, %function
    .thumb_func
memmove:
    .thumb_func
__aeabi_memmove:
    .thumb_func
__aeabi_memmove4:
    .thumb_func
__aeabi_memmove8:
    cmp r0, r1
    bls memcpy
    add r12, r0, r2
    add r1, r1, r2
    subs r2, r2, #4
    blo 2f
1:  ldr r3, [r1, #-4]!
    str r3, [r12, #-4]!
    subs r2, r2, #4
    bhs 1b
2:  adds r2, r2, #4
    beq 4f
3:  ldrb r3, [r1, #-1]!
    strb r3, [r12, #-1]!
    subs r2, r2, #1
    bne 3b
4:  bx lr
    .size memmove, . - memmove

    .global memcpy, __aeabi_memcpy, __aeabi_memcpy4, __aeabi_memcpy8
    .type memcpy, %function
    .type __aeabi_memcpy, %function
    .type __aeabi_memcpy4, %function
    .type __aeabi_memcpy8, %function
    .thumb_func
memcpy:
    .thumb_func
__aeabi_memcpy:
    .thumb_func
__aeabi_memcpy4:
    .thumb_func
__aeabi_memcpy8:
    mov r12, r0
    subs r2, r2, #4
    blo 2f
1:  ldr r3, [r1], #4
    str r3, [r12], #4
    subs r2, r2, #4
    bhs 1b
2:  adds r2, r2, #4
    beq 4f
3:  ldrb r3, [r1], #1
    strb r3, [r12], #1
    subs r2, r2, #1
    bne 3b
4:  bx lr
    .size memcpy, . - memcpy

    .section .text.cosmic_mem_set, \"ax\", %progbits
    .global __aeabi_memclr, __aeabi_memclr4, __aeabi_memclr8
    .type __aeabi_memclr, %function
    .type __aeabi_memclr4, %function
    .type __aeabi_memclr8, %function
    .thumb_func
__aeabi_memclr:
    .thumb_func
__aeabi_memclr4:
    .thumb_func
__aeabi_memclr8:
    movs r2, #0
    .size __aeabi_memclr, . - __aeabi_memclr
    .global __aeabi_memset, __aeabi_memset4, __aeabi_memset8
    .type __aeabi_memset, %function
    .type __aeabi_memset4, %function
    .type __aeabi_memset8, %function
    .thumb_func
__aeabi_memset:
    .thumb_func
__aeabi_memset4:
    .thumb_func
__aeabi_memset8:
    mov r3, r1
    mov r1, r2
    mov r2, r3
    .size __aeabi_memset, . - __aeabi_memset
    .global memset
    .type memset, %function
    .thumb_func
memset:
    uxtb r1, r1
    orr r1, r1, r1, lsl #8
    orr r1, r1, r1, lsl #16
    mov r12, r0
    subs r2, r2, #4
    blo 2f
1:  str r1, [r12], #4
    subs r2, r2, #4
    bhs 1b
2:  adds r2, r2, #4
    beq 4f
3:  strb r1, [r12], #1
    subs r2, r2, #1
    bne 3b
4:  bx lr
    .size memset, . - memset
    "
);
