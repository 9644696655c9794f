// What this browser knows, and how it is told.

const MOST_FRAMES = 30000;
const MOST_NOTICES = 500;

/** Positions in the array of a frame; see `messages.rs`. */
const [END, LENGTH, CLASS, PRIORITY, TX, ETAG, BYTES, SAID] = [0, 1, 2, 3, 4, 5, 6, 7];

const store = {
  hello: null,
  crossings: null,
  segments: [],
  chosen: 0,
  node: null,
  etag: null,
  notice: null,
  filter: "",
  control: false,
  paused: false,
  frames: 0,
  lost: 0,
  untold: 0,
};

function segmentOf(head) {
  return { ...head, state: null, frames: [], notices: new Map(), sequence: 0, offset: null, names: new Map(), channels: new Map() };
}

const chosenSegment = () => store.segments[store.chosen] ?? null;

const receive = {
  hello(hello) {
    const isAnother = store.hello === null || store.hello.instance !== hello.instance;
    store.hello = hello;
    if (isAnother) {
      store.segments = hello.segments.map(segmentOf);
      store.chosen = Math.min(store.chosen, Math.max(0, store.segments.length - 1));
      Object.assign(store, { node: null, etag: null, notice: null, crossings: null, frames: 0, lost: 0, untold: 0 });
    } else {
      hello.segments.slice(store.segments.length).forEach((head) => store.segments.push(segmentOf(head)));
    }
    changed("hello");
  },
  state(state) {
    const segment = store.segments[state.segment];
    if (segment === undefined) return;
    segment.state = state;
    const global = state.snapshot.clock.global_ns;
    segment.offset = global === null ? null : global - state.now_ns;
    segment.names = new Map(state.snapshot.nodes.map((node) => [node.tx_node, node.name]));
    segment.channels = new Map(state.snapshot.channels.filter((it) => it.etag !== null).map((it) => [it.etag, it]));
    changed("state");
  },
  frames({ segment: number, untold, frames }) {
    const segment = store.segments[number];
    if (segment === undefined) return;
    for (const frame of frames) segment.frames.push(frame);
    if (segment.frames.length > 1.3 * MOST_FRAMES) segment.frames.splice(0, segment.frames.length - MOST_FRAMES);
    store.frames += frames.length;
    store.untold += untold;
    if (number === store.chosen) remember(frames);
    changed("frames");
  },
  notices({ segment: number, notices }) {
    const segment = store.segments[number];
    if (segment === undefined) return;
    for (const notice of notices) {
      const known = segment.notices.get(notice.id);
      if (known !== undefined && known.sequence >= notice.sequence) continue;
      segment.notices.delete(notice.id);
      segment.notices.set(notice.id, notice);
    }
    while (segment.notices.size > MOST_NOTICES) segment.notices.delete(segment.notices.keys().next().value);
    changed("notices");
  },
  crossings(crossings) {
    store.crossings = crossings;
    changed("crossings");
  },
  lost({ frames }) {
    store.lost += frames;
    changed("frames");
  },
};

/** What is to be drawn anew. */
const stale = new Set();
function changed(what) {
  stale.add(what);
}

// The connection.

const SILENCE_MS = 6000;
const link = { source: null, state: "connecting", since: Date.now(), heard: 0, pause: 500, retry: 0 };

function connect() {
  link.source?.close();
  const source = new EventSource("events");
  link.source = source;
  link.heard = Date.now();
  for (const [kind, take] of Object.entries(receive)) {
    source.addEventListener(kind, (event) => {
      if (source !== link.source) return;
      working(() => {
        link.heard = Date.now();
        if (link.state !== "live") turn("live");
        link.pause = 500;
        take(JSON.parse(event.data));
      });
    });
  }
  source.onerror = () => {
    if (source === link.source) lose();
  };
}

function lose() {
  link.source?.close();
  link.source = null;
  if (link.state !== "lost") turn("lost");
  link.retry = Date.now() + link.pause;
  link.pause = Math.min(5000, link.pause * 2);
}

function turn(state) {
  [link.state, link.since] = [state, Date.now()];
  document.documentElement.dataset.connection = state;
  changed("connection");
}

function watchConnection() {
  const now = Date.now();
  if (link.source === null && now >= link.retry) connect();
  // A connection may die without a word: the server says something every second.
  else if (link.source !== null && now - link.heard > SILENCE_MS) lose();
  const seconds = Math.round((now - link.since) / 1000);
  const words = {
    connecting: "connecting",
    live: "live",
    lost: `connection lost ${seconds} s ago; trying again`,
  };
  write(byId("connection"), words[link.state] + (store.paused && link.state === "live" ? ", paused" : ""));
}

// Names, and what the filter lets through.

const nodeName = (segment, tx) => (tx === null ? "–" : (segment.names.get(tx) ?? `node ${hex(tx)}`));

function channelName(segment, etag) {
  if (etag === null) return "–";
  const channel = segment.channels.get(etag);
  return channel?.name ?? channel?.subject ?? `etag ${etag}`;
}

/** Returns whether each word of the filter occurs in one of these. */
function passes(...words) {
  if (store.filter === "") return true;
  const text = words.join(" ").toLowerCase();
  return store.filter.split(/\s+/).every((word) => text.includes(word));
}

function choose(part) {
  Object.assign(store, part);
  if ("etag" in part || "chosen" in part) recall();
  changed("choice");
}
