//! `cosmic top`, and colours, on a pseudo terminal: what a person sees.

mod common;

use common::CLUSTER;
use common::terminal::Terminal;

const LOG: &str = "log:docs/tasks/late.log";

#[test]
fn top_shows_the_segment_and_answers_keys() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[], (36, 120));
    let screen = top.shows("the log has ended");
    for wanted in [
        "cosmic top: rover",
        "500 kbit/s",
        "HRT ",
        "SRT ",
        "NRT ",
        "foreign ",
        "load, last minute",
        "time of base within",
        "7 nodes",
        "left_motor",
        "operational",
        "9 channels",
        "attitude",
        "gripper",
        "state=holding force=12.5 N",
        "notices, newest first",
        "unplanned publisher: node 70",
    ] {
        assert!(screen.contains(wanted), "{wanted}\n{screen}");
    }
    top.press("d");
    let screen = top.shows("add the channel to the node's `publishes`");
    assert!(screen.contains("doctor"), "{screen}");
    top.press("\x1b");
    top.press("?");
    top.shows("Tab, Shift-Tab");
    top.press("?");
    // Down in the list of channels: the first of them is out of sight.
    top.press("\t\t\t");
    top.press("q");
    assert_eq!(top.ends(), 0);
    // The terminal is as it was: the other screen is left, and the cursor is back.
    let raw = String::from_utf8_lossy(&top.raw).into_owned();
    assert!(raw.contains("\x1b[?1049l") && raw.contains("\x1b[?25h"), "{raw:?}");
}

#[test]
fn top_fits_a_small_terminal_and_ends_on_control_c() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[], (24, 80));
    let screen = top.shows("the log has ended");
    for wanted in ["cosmic top: rover", "nodes", "channels", "notices", "q quit"] {
        assert!(screen.contains(wanted), "{wanted}\n{screen}");
    }
    top.press("\x03");
    assert_eq!(top.ends(), 0);
}

#[test]
fn top_scrolls_what_has_the_focus() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[], (24, 100));
    let screen = top.shows("the log has ended");
    assert!(screen.contains("▸9 channels"), "{screen}");
    top.press("jj");
    top.shows("▸9 channels from 3");
    top.press("\t");
    top.shows("notices, newest first");
    top.press("q");
    assert_eq!(top.ends(), 0);
}

#[test]
fn tables_have_colours_on_a_terminal_but_not_with_no_color() {
    let nodes = ["nodes", "-l", LOG, "-c", CLUSTER];
    let mut coloured = Terminal::start(&nodes, &[], (40, 160));
    coloured.shows("power");
    assert_eq!(coloured.ends(), 0);
    assert!(String::from_utf8_lossy(&coloured.raw).contains("\x1b[32moperational\x1b[0m"));
    let mut plain = Terminal::start(&nodes, &[("NO_COLOR", "1")], (40, 160));
    plain.shows("power");
    assert_eq!(plain.ends(), 0);
    assert!(!String::from_utf8_lossy(&plain.raw).contains('\x1b'));
}

#[test]
fn top_without_colours_says_the_same_in_words() {
    let mut top = Terminal::start(&["top", "-l", LOG, "-c", CLUSTER], &[("NO_COLOR", "1")], (36, 120));
    top.shows("the log has ended");
    top.press("q");
    assert_eq!(top.ends(), 0);
    let raw = String::from_utf8_lossy(&top.raw).into_owned();
    assert!(
        !raw.contains("\x1b[38;5;") && !raw.contains("\x1b[31m") && !raw.contains("\x1b[33m"),
        "no colour is set"
    );
}
