//! The page in Chromium: what a person sees and does. Needs Debian's `chromium-driver`; without it these tests say so.

mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use common::browser::{Browser, Screen, open};
use common::{Rover, Server, event};
use cosmic_core::can::BitRate;
use cosmic_core::time::Instant;
use cosmic_monitor::Monitor;
use cosmic_page::{Config, Hub};

const DESK: Screen = Screen::Wide(1_300, 1_000);

/// A rover, the server, and a browser that is connected.
fn rover() -> Option<(Hub, Rover, Server, Browser)> {
    let hub = Hub::new(Config::default());
    let mut rover = Rover::of(&hub, "rover");
    rover.run(800);
    let server = Server::start(&hub);
    let browser = open(&server.url(), &DESK)?;
    browser.until("document.documentElement.dataset.connection === 'live'");
    Some((hub, rover, server, browser))
}

#[test]
fn a_person_opens_the_page_and_sees_events_as_they_come() {
    let Some((_hub, mut rover, _server, browser)) = rover() else { return };
    let before = browser.number("count-frames");
    let fresh = rover.run(300) as u64;
    browser
        .until(&format!("Number(document.getElementById('count-frames').innerText) >= {}", before + fresh));
    browser.until("document.getElementById('event-table').innerText.includes('quality=9')");
    browser.until("document.getElementById('channel-table').innerText.includes('attitude')");
    // Nodes, channels, and who publishes to whom.
    browser.until("document.querySelectorAll('#maps .spot').length >= 6 + 8");
    assert!(browser.run("return document.querySelectorAll('#maps .wire').length").as_u64().unwrap() > 10);
    browser.until("document.getElementById('line-text').innerText.includes('hard real-time')");
    assert!(browser.text("line-text").contains("0 slots missed"), "{}", browser.text("line-text"));
    assert!(browser.text("facts").contains("base, rank"), "{}", browser.text("facts"));
    // The policy of the page forbids nothing that it does.
    assert_eq!(browser.run("return window.performance.getEntriesByType('resource').filter(it => !it.name.endsWith('/events')).length"), 0);
}

#[test]
fn a_filter_shows_what_is_looked_for() {
    let Some((_hub, mut rover, _server, browser)) = rover() else { return };
    rover.run(300);
    browser.until("document.querySelectorAll('#channel-table tbody tr').length > 5");
    browser.press("/");
    browser.press("gripper");
    browser.until("document.querySelectorAll('#channel-table tbody tr').length === 1");
    rover.run(400);
    browser.until("[...document.querySelectorAll('#event-table tbody tr')].every(row => row.innerText.includes('gripper'))");
    browser.until("document.querySelector('#event-table tbody').innerText.includes('force=12.5')");
    assert!(browser.run("return document.querySelectorAll('.spot.faint').length").as_u64().unwrap() > 5);
    // Escape.
    browser.press("\u{E00C}");
    browser.until("document.querySelectorAll('#channel-table tbody tr').length > 5");
}

#[test]
fn an_exception_is_followed_to_its_channel_and_its_instant() {
    let Some((_hub, mut rover, _server, browser)) = rover() else { return };
    let channel = common::bed::channel_named(&rover.bed.plan, "left_wheel");
    rover.bed.orders.borrow_mut().mute = Some(channel);
    rover.run(1_500);
    browser.until("document.getElementById('notices').innerText.includes('missed slot')");
    let item =
        "[...document.querySelectorAll('#notices button')].find(it => it.innerText.includes('missed slot'))";
    browser.run(&format!("{item}.click()"));
    browser.until("document.getElementById('notices').innerText.includes('missed event:')");
    browser.until("document.querySelector('.spot.chosen title').textContent.length > 0");
    browser.until("document.getElementById('channel-words').innerText.startsWith('left_wheel (HRT')");
    browser.until("document.getElementById('pause').getAttribute('aria-pressed') === 'true'");
    browser.until("/[1-9][0-9]* slots missed/.test(document.getElementById('line-text').innerText)");
    // And back, by keys alone.
    browser.press("\u{E00C}");
    browser.press(" ");
    browser.until("document.getElementById('pause').getAttribute('aria-pressed') === 'false'");
    browser.until("document.getElementById('channel-none').hidden === false");
}

#[test]
fn values_are_plotted() {
    let Some((_hub, mut rover, _server, browser)) = rover() else { return };
    browser.until("document.querySelectorAll('#channel-table tbody button').length > 5");
    browser.run("[...document.querySelectorAll('#channel-table tbody button')].find(it => it.innerText === 'attitude').click()");
    rover.run(1_000);
    browser.until("/roll: [0-9]{2,} values in 10 s, from -2 to .* °, now/.test(document.getElementById('plot-text').innerText)");
    let ink = "const canvas = document.getElementById('plot');
        const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        return pixels.filter((value, at) => at % 4 === 3 && value > 0).length";
    assert!(browser.run(ink).as_u64().unwrap() > 500, "a line is drawn");
}

#[test]
fn a_lost_connection_is_told_and_comes_back_by_itself() {
    let Some((hub, mut rover, server, browser)) = rover() else { return };
    let address = server.address;
    let before = browser.number("count-frames");
    drop(server);
    browser.until("document.getElementById('connection').innerText.includes('connection lost')");
    let _again = Server::start_at(&hub, address);
    browser.until("document.documentElement.dataset.connection === 'live'");
    let fresh = rover.run(300) as u64;
    browser
        .until(&format!("Number(document.getElementById('count-frames').innerText) >= {}", before + fresh));
    // A server that was started anew knows nothing of what was before, and the page forgets it too.
    drop(_again);
    browser.until("document.documentElement.dataset.connection === 'lost'");
    let other = Hub::new(Config { title: "Another".to_owned(), ..Config::default() });
    let mut rover = Rover::of(&other, "second");
    let _third = Server::start_at(&other, address);
    browser.until("document.getElementById('title').innerText === 'Another'");
    rover.run(400);
    browser.until("document.getElementById('segments').innerText.includes('second')");
    assert!(!browser.text("segments").contains("rover"));
}

/// 1 000 events a second of 100 nodes on each of two segments, as time goes by: nothing is lost, whatever else the
/// machine has to do meanwhile; the queue of a browser has room for seconds.
#[test]
fn a_thousand_events_a_second_and_two_hundred_nodes_are_shown_without_loss() {
    let hub = Hub::new(Config::default());
    let segments: Vec<_> = ["front", "rear"]
        .map(|name| hub.segment(name, "sim:", Monitor::new(BitRate::MAX, Instant::EPOCH)))
        .into_iter()
        .collect();
    let server = Server::start(&hub);
    let Some(browser) = open(&server.url(), &DESK) else { return };
    browser.until("document.documentElement.dataset.connection === 'live'");
    let stop = Arc::new(AtomicBool::new(false));
    let feeder = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || {
            let begun = std::time::Instant::now();
            let mut number = 0;
            while !stop.load(Ordering::Relaxed) {
                // 500 a second of each segment.
                while number < begun.elapsed().as_millis() as u64 / 2 {
                    segments.iter().for_each(|segment| segment.on_tapped(&event(number)));
                    number += 1;
                }
                std::thread::sleep(Duration::from_millis(5));
            }
            2 * number
        }
    });
    browser.until("Number(document.getElementById('count-frames').innerText) >= 8000");
    // Meanwhile a person works with it.
    browser.press("/");
    browser.press("node 2A");
    browser.until("[...document.querySelectorAll('#node-table tbody tr')].length === 1");
    browser.press("\u{E00C}");
    browser.until("document.querySelectorAll('#maps .spot').length >= 2 * (100 + 20)");
    stop.store(true, Ordering::Relaxed);
    let sent = feeder.join().unwrap();
    browser.until(&format!("Number(document.getElementById('count-frames').innerText) === {sent}"));
    assert_eq!((browser.number("count-lost"), browser.number("count-untold")), (0, 0));
    eprintln!("the page has worked {} % of the time", browser.text("busy"));
}

#[test]
fn a_phone_shows_all_of_it_in_one_column() {
    let hub = Hub::new(Config::default());
    let mut rover = Rover::of(&hub, "rover");
    rover.run(800);
    let server = Server::start(&hub);
    let Some(browser) = open(&server.url(), &Screen::Phone(390, 844)) else { return };
    browser.until("document.querySelectorAll('#maps .spot').length > 10");
    let widths = browser.run(
        "return [document.documentElement.scrollWidth, window.innerWidth,
            Math.max(...[...document.querySelectorAll('section, header *, main button')].map(it => it.getBoundingClientRect().right))]",
    );
    let width = |at: usize| widths[at].as_f64().unwrap();
    assert!(width(0) <= width(1) && width(2) <= width(1), "nothing stands beside the screen: {widths}");
    // A finger chooses.
    browser.click("#maps .spot");
    browser.until("document.querySelectorAll('.spot.chosen').length > 0");
}

#[test]
fn every_control_has_a_name_and_is_reached_by_keys() {
    let Some((_hub, mut rover, _server, browser)) = rover() else { return };
    rover.run(300);
    browser.until("document.querySelectorAll('#maps .spot').length > 10");
    let nameless = browser.run(
        "return [...document.querySelectorAll('button, select, input, canvas, [role=button]')].filter(it =>
            it.offsetParent !== null && !(it.innerText || it.getAttribute('aria-label') || it.labels?.length || it.textContent))
            .map(it => it.outerHTML)",
    );
    assert_eq!(nameless, serde_json::json!([]));
    for (key, section) in [("1", "map"), ("2", "feed"), ("8", "events")] {
        browser.press(key);
        browser.until(&format!("document.activeElement.id === '{section}'"));
    }
    browser.press("?");
    browser.until("document.getElementById('help').open");
}
