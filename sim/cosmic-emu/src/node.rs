//! One emulated microcontroller: core, peripherals and firmware, and the loop that runs them.
//!
//! A node runs on its own up to an instant that the cluster gives, between two events of the bus. It
//! stops earlier when it asks something of the bus that has an answer at once. Asleep (WFI), it jumps
//! from deadline to deadline.

use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;

use cosmic_bus::{ErrorState, EventKind, VirtualInstant, WireFrame, time};
use cosmic_core::time::Duration;

use crate::cpu::{Cpu, MaskedAt, Pace, Stop};
use crate::exception::{self, ENTRY_CYCLES, RETURN_CYCLES, TAIL_CHAIN_CYCLES};
use crate::hardware::{self, Hardware, power_on};
use crate::image::{Image, LoadError};
use crate::log::LogDecoder;
use crate::node_config::{Firmware, NodeConfig};
use crate::observation::{Masked, ObservationKind, Pin, Place, ResetCause, StopReason};
use crate::rtt::Rtt;
use crate::soc::can::{Command, Outcome};
use crate::soc::{HappeningKind, System, number};

/// Longest time that RTT channels are not looked at while a node does not sleep.
const DRAIN_PERIOD: Duration = Duration::from_millis(1);

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    Running,
    /// At a WFI or WFE.
    Asleep,
    /// By a fault; a watchdog that runs goes on.
    Stopped,
    /// Without power.
    Off,
}

/// An emulated microcontroller.
pub(crate) struct Node {
    config: NodeConfig,
    image: Image,
    cpu: Box<dyn Cpu>,
    pace: Rc<Pace>,
    system: Rc<RefCell<System>>,
    state: State,
    /// The event register of WFE and SEV.
    event: bool,
    rtt: Option<Rtt>,
    log: LogDecoder,
    drained_at: VirtualInstant,
    seen: Vec<(VirtualInstant, ObservationKind)>,
    /// Whether it is noted when handlers run.
    watches_handlers: bool,
}

impl Node {
    pub(crate) fn new(config: NodeConfig) -> Result<Self, LoadError> {
        let image = match &config.firmware {
            Firmware::File(path) => Image::read(path)?,
            Firmware::Bytes { name, bytes } => Image::parse(Path::new(name), bytes)?,
        };
        let start = config.start_at;
        let (cpu, pace, system) = power_on(&config, &image, start);
        let rtt = image.rtt.map(Rtt::new);
        let log = LogDecoder::default();
        let (state, event) = (State::Running, false);
        Ok(Self {
            config,
            image,
            cpu,
            pace,
            system,
            state,
            event,
            rtt,
            log,
            drained_at: start,
            seen: Vec::new(),
            watches_handlers: false,
        })
    }

    /// Switches the node off and on again: RAM and peripherals are as new, probes stay.
    pub(crate) fn restart(&mut self, at: VirtualInstant) {
        self.drain();
        let new = power_on(&self.config, &self.image, at);
        self.start_again(new, at);
    }

    /// Resets the node: RAM keeps what is in it, and RCC says why.
    pub(crate) fn reset(&mut self, at: VirtualInstant, cause: ResetCause) {
        self.drain();
        let new =
            hardware::reset(&self.config, &self.image, at, self.cpu.as_ref(), &self.system.borrow(), cause);
        self.start_again(new, at);
    }

    fn start_again(&mut self, new: Hardware, at: VirtualInstant) {
        let probes = self.pace.probes();
        (self.cpu, self.pace, self.system) = new;
        probes.into_iter().for_each(|pc| self.pace.add_probe(pc));
        self.rtt = self.image.rtt.map(Rtt::new);
        self.log = LogDecoder::default();
        (self.state, self.event, self.drained_at) = (State::Running, false, at);
    }

    /// Stops the node without a word: its power fails.
    pub(crate) fn power_off(&mut self) {
        self.drain();
        self.state = State::Off;
    }

    /// Its crystal begins to oscillate, or fails.
    pub(crate) fn set_crystal(&mut self, at: VirtualInstant, runs: bool) {
        self.config.crystal_runs = runs;
        self.change(at, |system| system.set_crystal(runs));
    }

    /// Its supply sinks below the threshold of the voltage detector, or rises above it.
    pub(crate) fn set_supply(&mut self, at: VirtualInstant, is_low: bool) {
        self.config.supply_is_low = is_low;
        self.change(at, |system| system.set_supply(is_low));
    }

    /// Something changes around the part, if it runs.
    fn change(&mut self, at: VirtualInstant, to: impl FnOnce(&mut System)) {
        if !self.is_stopped() {
            let mut system = self.system.borrow_mut();
            // If it sleeps, nobody has looked at it since.
            if self.state == State::Asleep {
                self.pace.sleep_until(system.timebase.cycle_at(at));
            }
            to(&mut system);
        }
    }

    pub(crate) fn image(&self) -> &Image {
        &self.image
    }

    pub(crate) fn pace(&self) -> &Pace {
        &self.pace
    }

    /// For how long interrupts of the watched priority were masked at most by what they would pre-empt.
    pub(crate) fn longest_masked(&self) -> Vec<Masked> {
        let Some(watched) = self.pace.watched_priority() else { return Vec::new() };
        let nvic = &self.system.borrow().nvic;
        let is_below = |at: &MaskedAt| at.exception == 0 || nvic.priority(at.exception) > watched;
        let all = self.pace.longest_masked().into_iter().filter(|(at, _)| is_below(at));
        let mut all: Vec<_> = all
            .map(|(at, cycles)| Masked { place: self.place(at.pc), exception: at.exception, cycles })
            .collect();
        all.sort_by_key(|masked| std::cmp::Reverse(masked.cycles));
        all
    }

    pub(crate) fn watch_handlers(&mut self) {
        self.watches_handlers = true;
    }

    /// The name of the function that handles an exception, by the vector table of the image.
    pub(crate) fn handler(&self, exception: u16) -> Option<String> {
        let at = 4 * usize::from(exception);
        let vector = self.image.flash.get(at..at + 4)?.first_chunk()?;
        self.image.symbol(u32::from_le_bytes(*vector))
    }

    pub(crate) fn is_stopped(&self) -> bool {
        matches!(self.state, State::Stopped | State::Off)
    }

    pub(crate) fn is_off(&self) -> bool {
        self.state == State::Off
    }

    pub(crate) fn wants_reset(&self) -> Option<ResetCause> {
        self.system.borrow().reset_requested
    }

    /// What TIM2 shows, and since when; `None` while it stands.
    pub(crate) fn tim2(&self) -> Option<(u32, VirtualInstant)> {
        self.system.borrow_mut().tim2()
    }

    /// The bit rate that the firmware set, in bits per second.
    pub(crate) fn can_bits_per_second(&self) -> u32 {
        self.system.borrow().can_bits_per_second()
    }

    /// How far the node has come.
    pub(crate) fn now(&self) -> VirtualInstant {
        self.system.borrow().now()
    }

    /// The node does nothing before this instant, unless the bus wakes it.
    pub(crate) fn acts_at(&self) -> VirtualInstant {
        let system = self.system.borrow();
        match self.state {
            State::Off => time::FAR_FUTURE,
            State::Stopped => {
                let deadline = system.watchdog_deadline();
                deadline.map_or(time::FAR_FUTURE, |cycle| system.timebase.instant(cycle).max(system.now()))
            }
            State::Running => system.now(),
            State::Asleep => {
                let masks = exception::masks(self.cpu.as_ref());
                if system.nvic.wakes(masks) {
                    return system.now();
                }
                let deadline = system.deadline();
                deadline.map_or(time::FAR_FUTURE, |cycle| system.timebase.instant(cycle).max(system.now()))
            }
        }
    }

    /// Runs until the instant `until`, or until the bus must act first.
    pub(crate) fn run(&mut self, until: VirtualInstant) {
        while !self.is_stopped() {
            let masks = exception::masks(self.cpu.as_ref());
            let mut system = self.system.borrow_mut();
            system.advance();
            let horizon = system.timebase.cycle_at(until);
            if system.must_stop() || self.pace.cycle() >= horizon {
                break;
            }
            if system.nvic.to_take(masks).is_some() {
                drop(system);
                self.take_exception();
                continue;
            }
            if self.state == State::Asleep && !system.nvic.wakes(masks) {
                let next = system.deadline().map_or(horizon, |deadline| deadline.min(horizon));
                self.pace.sleep_until(next);
                continue;
            }
            self.state = State::Running;
            self.pace.set_pending(system.nvic.any_pending());
            system.set_horizon(horizon);
            drop(system);
            let stop = self.cpu.run();
            self.handle(stop);
        }
        if self.state == State::Stopped {
            self.wait_for_watchdog(until);
        }
        let now = self.system.borrow().now();
        if now >= self.drained_at + DRAIN_PERIOD {
            self.drain();
        }
    }

    /// The core does nothing more. Its watchdog, if it runs, ends that.
    fn wait_for_watchdog(&mut self, until: VirtualInstant) {
        let mut system = self.system.borrow_mut();
        let horizon = system.timebase.cycle_at(until);
        if let Some(deadline) = system.watchdog_deadline().filter(|deadline| *deadline <= horizon) {
            self.pace.skip_to(deadline);
            system.advance();
        }
    }

    fn handle(&mut self, stop: Stop) {
        match stop {
            Stop::Limit => {}
            Stop::WaitForInterrupt => {
                self.state = State::Asleep;
                self.drain();
            }
            Stop::WaitForEvent => {
                if !std::mem::take(&mut self.event) {
                    self.state = State::Asleep;
                    self.drain();
                }
            }
            Stop::SendEvent => {
                self.event = true;
            }
            Stop::SupervisorCall => self.supervisor_call(),
            Stop::Breakpoint(immediate) => self.stop(StopReason::Breakpoint(immediate)),
            Stop::ExceptionReturn(exc_return) => self.return_from_exception(exc_return),
            Stop::Fault(fault) => self.stop(StopReason::Fault(fault)),
        }
    }

    fn supervisor_call(&mut self) {
        let masks = exception::masks(self.cpu.as_ref());
        let mut system = self.system.borrow_mut();
        system.nvic.pend(number::SV_CALL);
        let is_taken = system.nvic.to_take(masks).is_some();
        drop(system);
        if !is_taken {
            self.stop(StopReason::MaskedSupervisorCall);
        }
    }

    fn take_exception(&mut self) {
        let align = self.system.borrow().control.aligns_stack();
        match exception::stack(self.cpu.as_mut(), align) {
            Ok(exc_return) => self.enter_handler(exc_return, ENTRY_CYCLES),
            Err(fault) => self.stop(StopReason::Fault(fault)),
        }
    }

    /// Enters the most urgent handler that there is `cycles` from now: one that arrives late goes first.
    fn enter_handler(&mut self, exc_return: u32, cycles: u64) {
        let masks = exception::masks(self.cpu.as_ref());
        self.pace.skip_to(self.pace.cycle() + cycles);
        let mut system = self.system.borrow_mut();
        system.advance();
        let Some(exception) = system.nvic.to_take(masks) else { return };
        system.nvic.activate(exception);
        let vector = self.cpu.read_word(system.control.vtor + 4 * u32::from(exception));
        drop(system);
        match vector {
            Ok(handler) if handler & 1 != 0 => {
                exception::enter(self.cpu.as_mut(), exception, handler, exc_return);
                self.event = true;
                self.state = State::Running;
                self.note_handler(exception, true);
            }
            _ => self.stop(StopReason::NoHandler(exception)),
        }
    }

    fn note_handler(&mut self, exception: u16, begins: bool) {
        if self.watches_handlers {
            let system = self.system.borrow();
            let kind =
                ObservationKind::Handler { exception, priority: system.nvic.priority(exception), begins };
            self.seen.push((system.now(), kind));
        }
    }

    fn return_from_exception(&mut self, exc_return: u32) {
        let system = self.system.borrow_mut();
        let exception = system.nvic.current();
        drop(system);
        self.note_handler(exception, false);
        let mut system = self.system.borrow_mut();
        system.nvic.deactivate(exception);
        let leaves_handlers = system.nvic.current() == 0;
        let sleeps = leaves_handlers && system.control.sleeps_on_exit();
        exception::clear_faultmask(self.cpu.as_mut(), exception);
        let masks = exception::masks(self.cpu.as_ref());
        system.advance();
        let chains = system.nvic.to_take(masks).is_some();
        drop(system);
        if exception == 0 || !exception::is_valid(exc_return, leaves_handlers) {
            self.stop(StopReason::BadExceptionReturn(exc_return));
            return;
        }
        self.event = true;
        if chains {
            self.enter_handler(exc_return, TAIL_CHAIN_CYCLES);
        } else if let Err(fault) = exception::unstack(self.cpu.as_mut(), exc_return) {
            self.stop(StopReason::Fault(fault));
        } else {
            self.pace.skip_to(self.pace.cycle() + RETURN_CYCLES);
            self.state = if sleeps { State::Asleep } else { State::Running };
        }
    }

    fn stop(&mut self, reason: StopReason) {
        self.drain();
        self.collect_hits();
        self.state = State::Stopped;
        let at = self.system.borrow().now();
        let place = self.place(self.pace.pc());
        self.seen.push((at, ObservationKind::Stopped { reason, place }));
    }

    /// The bus tells this node's controller something.
    pub(crate) fn deliver(&mut self, at: VirtualInstant, event: &EventKind, bit_time: Duration) {
        let mut system = self.system.borrow_mut();
        let cycle = system.timebase.cycle_at(at);
        if self.state == State::Asleep {
            self.pace.sleep_until(cycle);
        } else {
            self.pace.skip_to(cycle);
        }
        system.advance();
        let now = self.pace.cycle();
        match event {
            EventKind::Received(frame) => {
                let started = system.timebase.cycle_at(start_of(frame, at, bit_time));
                system.can.receive(started, frame);
            }
            EventKind::Sent { mailbox } => system.can.wired_mut().complete(now, *mailbox, Outcome::Sent),
            EventKind::Withdrawn { mailbox } => {
                system.can.wired_mut().complete(now, *mailbox, Outcome::Withdrawn)
            }
            EventKind::Failed { mailbox, cause } => system.can.wired_mut().failed(now, *mailbox, *cause),
            EventKind::ErrorState(state) => system.can.wired_mut().set_errors(*state),
        }
        system.update_lines();
    }

    /// The bus counted errors.
    pub(crate) fn set_errors(&mut self, errors: ErrorState) {
        let mut system = self.system.borrow_mut();
        system.can.wired_mut().set_errors(errors);
        system.update_lines();
    }

    /// What the node wants of the bus, and when it said so.
    pub(crate) fn take_commands(&mut self) -> Vec<(VirtualInstant, Command)> {
        let mut system = self.system.borrow_mut();
        let commands = system.can.take_commands();
        commands.into_iter().map(|(cycle, command)| (system.timebase.instant(cycle), command)).collect()
    }

    /// What was seen of the node since the last call, in the order of time.
    pub(crate) fn take_seen(&mut self) -> Vec<(VirtualInstant, ObservationKind)> {
        self.collect_hits();
        let happenings = self.system.borrow_mut().take_happenings();
        for happening in happenings {
            let kind = match happening.kind {
                HappeningKind::Pin(port, number, level) => {
                    let pin = Pin { port: char::from(b'A' + port), number };
                    ObservationKind::Pin { pin, level, instructions: happening.instructions }
                }
                HappeningKind::NotModelled { access, address, pc } => {
                    ObservationKind::NotModelled { access, address, place: self.place(pc) }
                }
                HappeningKind::NotClocked { access, address, pc } => {
                    ObservationKind::NotClocked { access, address, place: self.place(pc) }
                }
            };
            self.seen.push((happening.at, kind));
        }
        let mut seen = std::mem::take(&mut self.seen);
        seen.sort_by_key(|(at, _)| *at);
        seen
    }

    /// The node says something about itself.
    pub(crate) fn note(&mut self, at: VirtualInstant, kind: ObservationKind) {
        self.seen.push((at, kind));
    }

    fn collect_hits(&mut self) {
        for hit in self.pace.take_hits() {
            let at = self.system.borrow().timebase.instant(hit.cycle);
            let place = self.place(hit.pc);
            self.seen.push((at, ObservationKind::Reached { place, instructions: hit.instructions }));
        }
    }

    /// Reads the RTT channels.
    pub(crate) fn drain(&mut self) {
        let now = self.system.borrow().now();
        self.drained_at = now;
        let Some(rtt) = &mut self.rtt else { return };
        // Buffers outside of memory are a damaged control block; nothing can be read then.
        let chunks = rtt.drain(self.cpu.as_mut()).unwrap_or_default();
        for chunk in chunks {
            let channel = rtt.name(chunk.channel);
            match &self.image.defmt {
                Some(table) if channel == DEFMT_CHANNEL => {
                    let lines = self.log.decode(table, &chunk.bytes);
                    self.seen.extend(lines.into_iter().map(|line| (now, ObservationKind::Log(line))));
                }
                _ => {
                    let channel = channel.to_owned();
                    self.seen.push((now, ObservationKind::Record { channel, bytes: chunk.bytes }));
                }
            }
        }
    }

    fn place(&self, pc: u32) -> Place {
        Place { pc, symbol: self.image.symbol(pc) }
    }
}

const DEFMT_CHANNEL: &str = "defmt";

/// A frame is received at the end of its last bit but one.
fn start_of(frame: &WireFrame, received_at: VirtualInstant, bit_time: Duration) -> VirtualInstant {
    let length = bit_time.as_ticks() * u64::from(frame.bit_count() - 1);
    VirtualInstant::from_ticks(received_at.as_ticks().saturating_sub(length))
}
