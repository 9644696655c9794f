//! What the user sees of what there is: which list has the keys, and from where on it is shown.

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// The lists.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Pane {
    Nodes,
    Channels,
    Notices,
}

impl Pane {
    pub(crate) const ALL: [Self; 3] = [Self::Nodes, Self::Channels, Self::Notices];
}

/// The state of the screen.
#[derive(Debug)]
pub(crate) struct Screen {
    pub(crate) focus: Pane,
    /// The first line that is shown, of each list.
    offsets: [usize; 3],
    pub(crate) shows_help: bool,
    pub(crate) shows_findings: bool,
}

/// What follows from a key.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Answer {
    Stay,
    Quit,
}

impl Default for Screen {
    fn default() -> Self {
        Self { focus: Pane::Channels, offsets: [0; 3], shows_help: false, shows_findings: false }
    }
}

impl Screen {
    pub(crate) fn on_key(&mut self, key: &KeyEvent) -> Answer {
        let interrupts = key.modifiers.contains(KeyModifiers::CONTROL) && key.code == KeyCode::Char('c');
        match key.code {
            _ if interrupts => return Answer::Quit,
            KeyCode::Char('q') => return Answer::Quit,
            KeyCode::Esc if !self.shows_help && !self.shows_findings => return Answer::Quit,
            KeyCode::Esc => (self.shows_help, self.shows_findings) = (false, false),
            KeyCode::Char('?' | 'h') => self.shows_help = !self.shows_help,
            KeyCode::Char('d') => self.shows_findings = !self.shows_findings,
            KeyCode::Tab => self.focus = Pane::ALL[(self.focus as usize + 1) % 3],
            KeyCode::BackTab => self.focus = Pane::ALL[(self.focus as usize + 2) % 3],
            KeyCode::Up | KeyCode::Char('k') => self.scroll(-1),
            KeyCode::Down | KeyCode::Char('j') => self.scroll(1),
            KeyCode::PageUp => self.scroll(-10),
            KeyCode::PageDown => self.scroll(10),
            KeyCode::Home => self.offsets[self.focus as usize] = 0,
            _ => {}
        }
        Answer::Stay
    }

    fn scroll(&mut self, by: isize) {
        let offset = &mut self.offsets[self.focus as usize];
        *offset = offset.saturating_add_signed(by);
    }

    /// The first line to show of a list with so many lines, of which so many fit. Nobody scrolls beyond the last.
    pub(crate) fn first(&mut self, pane: Pane, lines: usize, fit: usize) -> usize {
        let offset = &mut self.offsets[pane as usize];
        *offset = (*offset).min(lines.saturating_sub(fit));
        *offset
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(screen: &mut Screen, code: KeyCode) -> Answer {
        screen.on_key(&KeyEvent::new(code, KeyModifiers::NONE))
    }

    #[test]
    fn keys_move_what_has_the_focus_and_not_beyond_its_end() {
        let mut screen = Screen::default();
        press(&mut screen, KeyCode::PageDown);
        assert_eq!(screen.first(Pane::Channels, 8, 5), 3);
        press(&mut screen, KeyCode::Up);
        assert_eq!((screen.first(Pane::Channels, 8, 5), screen.first(Pane::Nodes, 8, 5)), (2, 0));
        press(&mut screen, KeyCode::Tab);
        assert_eq!(screen.focus, Pane::Notices);
        press(&mut screen, KeyCode::BackTab);
        assert_eq!(screen.focus, Pane::Channels);
    }

    #[test]
    fn escape_closes_what_is_open_and_then_the_program() {
        let mut screen = Screen::default();
        assert_eq!(press(&mut screen, KeyCode::Char('d')), Answer::Stay);
        assert!(screen.shows_findings);
        assert_eq!(press(&mut screen, KeyCode::Esc), Answer::Stay);
        assert_eq!(press(&mut screen, KeyCode::Esc), Answer::Quit);
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(screen.on_key(&interrupt), Answer::Quit);
    }
}
