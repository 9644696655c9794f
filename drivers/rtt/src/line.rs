//! One line of the log at a time.
//!
//! Who may log masks all others who may. So a line is begun while another is open only by somebody who may not,
//! or by the one who has it open, in the middle of formatting a value. Neither gets a line of its own.

use crate::control::{Channel, Staged};

/// The state of the log.
pub(crate) struct Lines {
    channel: Option<Channel>,
    encoder: defmt::Encoder,
    staged: Staged,
    /// A line is open.
    open: bool,
    /// Lines begun while one is open, by the same task.
    nested: u8,
    lost: u32,
}

impl Lines {
    pub(crate) const fn new() -> Self {
        Self {
            channel: None,
            encoder: defmt::Encoder::new(),
            staged: Staged::NOTHING,
            open: false,
            nested: 0,
            lost: 0,
        }
    }

    pub(crate) fn set_channel(&mut self, channel: Channel) {
        self.channel = Some(channel);
    }

    /// Lines that were not written.
    pub(crate) const fn lost(&self) -> u32 {
        self.lost
    }

    /// A line was left out.
    pub(crate) fn count_lost(&mut self) {
        self.lost = self.lost.wrapping_add(1);
    }

    /// Begins a line.
    pub(crate) fn begin(&mut self) {
        if self.open {
            self.nested = self.nested.saturating_add(1);
            self.count_lost();
            return;
        }
        let Some(channel) = &self.channel else { return };
        self.open = true;
        self.staged = channel.begin();
        let staged = &mut self.staged;
        self.encoder.start_frame(|bytes| channel.put(staged, bytes));
    }

    /// A part of the line.
    pub(crate) fn write(&mut self, bytes: &[u8]) {
        let Some(channel) = self.channel.as_ref().filter(|_| self.open && self.nested == 0) else { return };
        let staged = &mut self.staged;
        self.encoder.write(bytes, |bytes| channel.put(staged, bytes));
    }

    /// The end of the line. Returns whether it is the one that was begun first.
    pub(crate) fn end(&mut self) -> bool {
        if self.nested > 0 {
            self.nested -= 1;
            return false;
        }
        match &self.channel {
            Some(channel) if self.open => {
                let staged = &mut self.staged;
                self.encoder.end_frame(|bytes| channel.put(staged, bytes));
                if !channel.commit(self.staged) {
                    self.count_lost();
                }
            }
            _ => self.count_lost(),
        }
        self.open = false;
        true
    }

    /// Gives up the line that is open: what follows comes from somebody after whom nobody runs.
    pub(crate) fn give_up(&mut self) {
        if self.open {
            self.count_lost();
        }
        (self.open, self.nested) = (false, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Control, LOG};
    use std::boxed::Box;

    fn lines() -> Lines {
        let control: &'static Control = Box::leak(Box::new(Control::new()));
        let buffer = Box::leak(Box::new([0; 16]));
        let mut lines = Lines::new();
        lines.set_channel(control.channel(LOG, c"defmt", buffer).unwrap());
        lines
    }

    fn line(lines: &mut Lines, bytes: &[u8]) {
        lines.begin();
        lines.write(bytes);
        assert!(lines.end());
    }

    #[test]
    fn before_the_log_is_started_lines_are_lost() {
        let mut lines = Lines::new();
        line(&mut lines, b"1");
        assert_eq!(lines.lost(), 1);
    }

    #[test]
    fn a_line_that_finds_no_room_is_lost_and_the_next_one_is_not() {
        let mut lines = lines();
        line(&mut lines, &[0x55; 20]);
        assert_eq!(lines.lost(), 1);
        line(&mut lines, &[0x55; 4]);
        assert_eq!(lines.lost(), 1);
    }

    #[test]
    fn a_line_within_a_line_is_lost_and_leaves_the_outer_one_whole() {
        let mut lines = lines();
        lines.begin();
        lines.write(&[1]);
        lines.begin();
        lines.write(&[0x55; 20]);
        assert!(!lines.end());
        lines.write(&[2]);
        assert!(lines.end());
        assert_eq!(lines.lost(), 1);
    }

    #[test]
    fn who_comes_last_of_all_gets_a_line() {
        let mut lines = lines();
        lines.begin();
        lines.begin();
        lines.give_up();
        line(&mut lines, &[1]);
        assert_eq!(lines.lost(), 2);
    }
}
