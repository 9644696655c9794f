//! RTIC on the machine: tasks wake at their instants, in the order of time and of priority.
//!
//! Instants are 64 bits wide, the counter has 32 and starts again every 171,798,691.84 µs: tasks sleep
//! over the ends of its periods, and read the time across them, with interrupts on and off.
#![no_std]
#![no_main]

#[rtic::app(device = qemu_tests::device, peripherals = false, dispatchers = [GPIO0_0, GPIO0_1, GPIO0_2])]
mod app {
    use heapless::Vec;
    use qemu_tests::mono::{Duration, Instant, Mono, Timebase as _};
    use qemu_tests::{measured, pass, println};

    /// No wake-up may be later than this: interrupt, timer queue and dispatch are some hundred
    /// instructions of 8 ns each.
    const LATEST: Duration = Duration::from_micros(50);

    /// That a task woke up.
    pub struct Wakeup {
        task: &'static str,
        asked: Instant,
        due: Instant,
        at: Instant,
    }

    #[shared]
    struct Shared {
        log: Vec<Wakeup, 16>,
    }

    #[local]
    struct Local {}

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        Mono::start();
        println!("booted");
        low::spawn().unwrap();
        middle::spawn().unwrap();
        high::spawn().unwrap();
        (Shared { log: Vec::new() }, Local {})
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        qemu_tests::sleep()
    }

    #[task(priority = 3, shared = [log])]
    async fn high(mut cx: high::Context) {
        // At 1 ms all three are due. At 2500 µs the low task is computing and is preempted.
        for due_us in [1_000, 2_500] {
            let wakeup = sleep("high", due_us).await;
            cx.shared.log.lock(|log| log.push(wakeup).ok().unwrap());
        }
    }

    #[task(priority = 2, shared = [log])]
    async fn middle(mut cx: middle::Context) {
        // 500 µs has passed already by then, and is due at once.
        for due_us in [1_000, 500, 1_500, 600_000_000] {
            let wakeup = sleep("middle", due_us).await;
            cx.shared.log.lock(|log| log.push(wakeup).ok().unwrap());
        }
        cx.shared.log.lock(|log| report(log));
        pass()
    }

    #[task(priority = 1, shared = [log])]
    async fn low(mut cx: low::Context) {
        let wakeup = sleep("low", 1_000).await;
        cx.shared.log.lock(|log| log.push(wakeup).ok().unwrap());
        let wakeup = sleep("low", 2_000).await;
        cx.shared.log.lock(|log| log.push(wakeup).ok().unwrap());
        while Mono::now() < instant(3_000) {}
        let wakeup = sleep("low", 171_798_680).await;
        cx.shared.log.lock(|log| log.push(wakeup).ok().unwrap());
        watch_the_time(instant(171_798_700));
        let wakeup = sleep("low", 343_597_370).await;
        cx.shared.log.lock(|log| log.push(wakeup).ok().unwrap());
        cortex_m::interrupt::free(|_| watch_the_time(instant(343_597_392)));
    }

    async fn sleep(task: &'static str, due_us: u64) -> Wakeup {
        let due = instant(due_us);
        let asked = Mono::now();
        Mono::delay_until(due).await;
        Wakeup { task, asked, due, at: Mono::now() }
    }

    /// Reads the time over and over until `end`.
    fn watch_the_time(end: Instant) {
        let mut before = Mono::now();
        assert!(before < end);
        while before < end {
            let now = Mono::now();
            assert!(now > before, "{before} is followed by {now}");
            assert!(now - before < LATEST, "{before} is followed by {now}");
            before = now;
        }
    }

    fn instant(us_since_start: u64) -> Instant {
        Instant::from_ticks(0) + Duration::from_micros(us_since_start)
    }

    fn report(log: &[Wakeup]) {
        for &Wakeup { task, asked, due, at } in log {
            let late = at - due.max(asked);
            let when = if asked > due { "at once" } else { "in time" };
            let verdict = if late > LATEST { "too late" } else { when };
            println!("{:>9} us {:<6} {}", due.duration_since_epoch().as_micros(), task, verdict);
            measured!("{:<6} {} ticks late", task, late.as_ticks());
        }
    }
}
