//! What a process costs so far.

use serde::{Deserialize, Serialize};
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};

/// To be the global allocator of whoever wants to know [`Cost::live`].
pub static COUNTING: &StatsAlloc<std::alloc::System> = &INSTRUMENTED_SYSTEM;

/// What a process costs so far.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Cost {
    /// Time of processors, of all its threads, in nanoseconds.
    pub cpu: u64,
    /// Bytes that are resident.
    pub resident: u64,
    /// Bytes that it has taken from its allocator and not given back.
    pub live: u64,
}

impl Cost {
    /// Of this process.
    pub fn now() -> Self {
        let cpu = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        let nanoseconds = cpu.tv_sec * 1_000_000_000 + cpu.tv_nsec;
        let stats = COUNTING.stats();
        let grown = stats.bytes_allocated as i64 - stats.bytes_deallocated as i64;
        Self {
            cpu: u64::try_from(nanoseconds).unwrap_or(0),
            resident: resident(),
            live: u64::try_from(grown).unwrap_or(0),
        }
    }

    /// Processor time since then, in nanoseconds.
    pub const fn cpu_since(&self, before: &Self) -> u64 {
        self.cpu.saturating_sub(before.cpu)
    }
}

fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.and_then(|rest| rest.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}
