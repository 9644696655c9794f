//! The server without a browser: what it tells, whom it refuses, whom it lets publish.

mod common;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::sync::{Arc, Mutex};

use common::{PATIENCE, Rover, Server, event, until};
use cosmic_core::can::BitRate;
use cosmic_core::time::Instant;
use cosmic_monitor::Monitor;
use cosmic_page::{Config, Hub, MOST_FRAMES, PublishRequest, Publishing, QUEUE, Token};
use serde_json::Value;

/// Asks, and returns the whole answer.
fn ask(server: &Server, request: &str) -> String {
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

fn get(server: &Server, path: &str, host: &str) -> String {
    ask(server, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"))
}

fn status(answer: &str) -> u16 {
    answer.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap()
}

fn body(answer: &str) -> &str {
    answer.split_once("\r\n\r\n").unwrap().1
}

/// The JSON in a body, which may come in chunks.
fn json(answer: &str) -> Value {
    let text = body(answer);
    let (first, last) = (text.find('{').unwrap(), text.rfind('}').unwrap());
    serde_json::from_str(&text[first..=last]).unwrap()
}

/// A stream of events: kind and value.
struct Stream(BufReader<TcpStream>);

impl Stream {
    fn open(server: &Server) -> Self {
        let mut stream = TcpStream::connect(server.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        Self(BufReader::new(stream))
    }

    fn next(&mut self) -> (String, Value) {
        let mut kind = String::new();
        loop {
            let mut line = String::new();
            assert!(self.0.read_line(&mut line).unwrap() > 0, "the stream has ended");
            if let Some(rest) = line.strip_prefix("event: ") {
                rest.trim().clone_into(&mut kind);
            } else if let Some(rest) = line.strip_prefix("data: ") {
                return (kind, serde_json::from_str(rest).unwrap());
            }
        }
    }

    fn next_of(&mut self, wanted: &str) -> Value {
        loop {
            let (kind, value) = self.next();
            if kind == wanted {
                return value;
            }
        }
    }
}

fn empty_hub(config: Config) -> (Hub, cosmic_page::Segment) {
    let hub = Hub::new(config);
    let segment = hub.segment("bench", "log:none", Monitor::new(BitRate::MAX, Instant::EPOCH));
    (hub, segment)
}

#[test]
fn a_browser_is_told_what_there_is_and_then_what_happens() {
    let hub = Hub::new(Config { title: "Rovers".to_owned(), ..Config::default() });
    let mut rover = Rover::of(&hub, "rover");
    rover.run(500);
    let server = Server::start(&hub);
    let mut stream = Stream::open(&server);
    let (kind, hello) = stream.next();
    assert_eq!(
        (kind.as_str(), &hello["title"], &hello["may_publish"]),
        ("hello", &"Rovers".into(), &false.into())
    );
    assert_eq!(hello["segments"][0]["name"], "rover");
    let (kind, state) = stream.next();
    assert_eq!((kind.as_str(), &state["snapshot"]["nodes"][0]["name"]), ("state", &"base".into()));
    let notices = stream.next_of("notices");
    assert!(notices["notices"].as_array().unwrap().iter().any(|notice| notice["kind"] == "node-appeared"));
    let told = rover.run(100);
    // The first ones may have been told to nobody, before this browser came.
    let mut frames = Vec::new();
    while frames.len() < told {
        frames.extend(stream.next_of("frames")["frames"].as_array().unwrap().clone());
    }
    let attitude = frames.iter().find(|frame| frame[5] == 16_383).unwrap();
    assert_eq!((&attitude[2], &attitude[7][3]), (&1.into(), &"9".into()), "class, and the field `quality`");
    assert!(attitude[1].as_f64().unwrap() > 100.0, "its bits at 500 kbit/s, in microseconds");
}

#[test]
fn the_state_is_there_for_programs_too() {
    let hub = Hub::new(Config::default());
    let mut rover = Rover::of(&hub, "rover");
    rover.run(1_500);
    let server = Server::start(&hub);
    let state = json(&get(&server, "/api/state", "127.0.0.1:1"));
    assert_eq!(state["hello"]["title"], "COSMIC");
    let snapshot = &state["states"][0]["snapshot"];
    assert_eq!((snapshot["nodes"].as_array().unwrap().len(), &snapshot["clock"]["master"]), (6, &1.into()));
    assert!(state["notices"][0]["notices"].is_array());
}

#[test]
fn more_frames_than_can_be_told_are_counted() {
    let (hub, segment) = empty_hub(Config::default());
    (0..MOST_FRAMES as u64 + 7).for_each(|number| segment.on_tapped(&event(number)));
    let server = Server::start(&hub);
    let mut stream = Stream::open(&server);
    // Unless they were told before this browser came.
    segment.on_tapped(&event(9_000));
    let frames = stream.next_of("frames");
    let (total, untold) = (frames["total"].as_u64().unwrap(), frames["untold"].as_u64().unwrap());
    assert_eq!(total, MOST_FRAMES as u64 + 8);
    let state = json(&get(&server, "/api/state", "localhost"));
    assert_eq!(state["states"][0]["snapshot"]["link"]["received"], total, "all of them count");
    assert!(untold == 8 || untold == 0, "{untold}");
}

/// The kernel's buffers take megabytes before the queue of a browser fills, so its messages are large.
#[test]
fn a_browser_that_does_not_read_holds_up_nobody() {
    let (hub, segment) = empty_hub(Config::default());
    let server = Server::start(&hub);
    let mut slow = Stream::open(&server);
    let mut quick = Stream::open(&server);
    assert_eq!((slow.next().0, quick.next().0), ("hello".to_owned(), "hello".to_owned()));
    let mut number = 0;
    let mut pulse = || {
        (0..MOST_FRAMES).for_each(|_| {
            number += 1;
            segment.on_tapped(&event(number));
        });
        hub.pulse();
        number
    };
    // Some 150 kB each: far beyond what a kernel keeps for a connection.
    let mut last = 0;
    for _ in 0..8 * QUEUE {
        last = pulse();
        while quick.next_of("frames")["total"] != last {}
    }
    let mut seen = 0;
    let lost = loop {
        let (kind, value) = slow.next();
        match kind.as_str() {
            "frames" => seen += value["frames"].as_array().unwrap().len() as u64,
            "lost" => break value["frames"].as_u64().unwrap(),
            _ => {}
        }
    };
    assert!(lost > 0);
    assert_eq!(seen + lost, last, "all that it was not told are counted");
}

#[test]
fn the_page_may_do_nothing_but_run_its_own_script() {
    let (hub, _) = empty_hub(Config::default());
    let server = Server::start(&hub);
    let page = get(&server, "/", &server.address.to_string());
    assert_eq!(status(&page), 200);
    let head = page.split_once("\r\n\r\n").unwrap().0.to_lowercase();
    for line in [
        "content-security-policy: default-src 'none'; script-src 'nonce-",
        "x-content-type-options: nosniff",
        "referrer-policy: no-referrer",
        "cache-control: no-store",
        "cross-origin-resource-policy: same-origin",
    ] {
        assert!(head.contains(line), "{line}: {head}");
    }
    let nonce = head.split("script-src 'nonce-").nth(1).unwrap().split('\'').next().unwrap().to_owned();
    assert!(body(&page).contains(&format!("<script nonce=\"{nonce}\">")));
    assert!(!head.contains("unsafe"));
}

#[test]
fn who_asks_for_another_name_is_refused() {
    let (hub, _) = empty_hub(Config { hosts: vec!["bench.example".to_owned()], ..Config::default() });
    let server = Server::start(&hub);
    for (host, code) in [("bench.example:80", 200), ("[::1]:80", 200), ("evil.example", 421), ("", 421)] {
        for path in ["/", "/api/state"] {
            assert_eq!(status(&get(&server, path, host)), code, "{host} {path}");
        }
    }
    assert_eq!(
        status(&ask(&server, "GET /events HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n")),
        421
    );
}

fn publish(server: &Server, token: &str, body: &str) -> String {
    let length = body.len();
    ask(
        server,
        &format!(
            "POST /api/publish HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n\
         {token}Content-Length: {length}\r\n\r\n{body}"
        ),
    )
}

const EVENT: &str = r#"{"segment":0,"channel":"gripper","content":["state=open","force=1"]}"#;

#[test]
fn nothing_is_published_unless_it_is_allowed() {
    let (hub, _) = empty_hub(Config::default());
    let server = Server::start(&hub);
    let answer = publish(&server, "Authorization: Bearer \r\n", EVENT);
    assert_eq!(status(&answer), 403);
    assert!(json(&answer)["why"].as_str().unwrap().contains("--allow-publish"));
}

#[test]
fn who_has_the_token_publishes() {
    let token = Token::draw();
    let published = Arc::new(Mutex::new(Vec::<PublishRequest>::new()));
    let list = Arc::clone(&published);
    let publishing = Publishing::new(token.clone(), move |request| {
        let list = Arc::clone(&list);
        async move {
            if request.channel == "nothing" {
                return Err("there is no channel \"nothing\"".to_owned());
            }
            list.lock().unwrap().push(request);
            Ok(())
        }
    });
    let (hub, _) = empty_hub(Config { publishing: Some(publishing), ..Config::default() });
    let server = Server::start(&hub);
    let header = format!("Authorization: Bearer {}\r\n", token.as_str());
    for wrong in ["", "Authorization: Bearer 00\r\n", &header.replace("Bearer", "Basic")] {
        assert_eq!(status(&publish(&server, wrong, EVENT)), 401, "{wrong}");
    }
    assert!(published.lock().unwrap().is_empty());
    let answer = publish(&server, &header, EVENT);
    assert_eq!((status(&answer), &json(&answer)["published"]), (200, &true.into()));
    assert_eq!(published.lock().unwrap()[0].content, ["state=open", "force=1"]);
    assert_eq!(status(&publish(&server, &header, "{}")), 400);
    let answer = publish(&server, &header, &EVENT.replace("gripper", "nothing"));
    assert_eq!((status(&answer), &json(&answer)["why"]), (422, &"there is no channel \"nothing\"".into()));
    let long = "x".repeat(5_000);
    assert_eq!(status(&publish(&server, &header, &EVENT.replace("gripper", &long))), 400);
    assert_eq!(published.lock().unwrap().len(), 1);
}

#[test]
fn what_is_wrong_with_the_link_is_told_at_once() {
    let (hub, segment) = empty_hub(Config::default());
    let server = Server::start(&hub);
    let mut stream = Stream::open(&server);
    assert_eq!(stream.next_of("state")["trouble"], Value::Null);
    segment.trouble(Some("the cable is out".to_owned()));
    until("the trouble is told", || stream.next_of("state")["trouble"] == "the cable is out");
    drop(stream);
    until("the server knows that the browser has left", || {
        hub.pulse();
        hub.browsers() == 0
    });
}
