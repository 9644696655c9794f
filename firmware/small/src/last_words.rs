//! The panic handler of images without logs: a HardFault.
//!
//! A message would cost 4 KB of flash. With the feature `last-words` it is kept for a debugger, and so `cargo xtask panics`
//! looks at such an image: where nobody reads what a panic says, the compiler makes one of all of them.

use core::panic::PanicInfo;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    #[cfg(feature = "last-words")]
    keep(info);
    let _ = info;
    cortex_m::asm::udf()
}

#[cfg(feature = "last-words")]
fn keep(info: &PanicInfo<'_>) {
    /// The message, if it is a constant, and where it was said.
    static mut LAST_WORDS: (Option<&str>, *const str, u32) = (None, "", 0);

    let (file, line): (*const str, _) = info.location().map_or(("", 0), |at| (at.file(), at.line()));
    // SAFETY: nobody comes back from here, so at worst a task of a higher priority, which panics too, writes its own.
    unsafe { (&raw mut LAST_WORDS).write_volatile((info.message().as_str(), file, line)) };
}
