// What is drawn when, and what keys and buttons do.

/** What is drawn anew when something has changed, and how often at most, in milliseconds. */
const DRAWERS = [
  { draw: drawTabs, on: ["hello", "state", "choice"], every: 200, at: 0 },
  { draw: drawMaps, on: ["hello", "state", "crossings", "choice"], every: 200, at: 0 },
  { draw: drawFindings, on: ["state", "choice"], every: 200, at: 0 },
  { draw: drawNotices, on: ["notices", "choice", "state"], every: 200, at: 0 },
  { draw: drawWays, on: ["hello", "crossings", "choice"], every: 200, at: 0 },
  { draw: drawLoad, on: ["state", "choice"], every: 200, at: 0 },
  { draw: drawChannels, on: ["state", "choice"], every: 200, at: 0 },
  { draw: drawNodes, on: ["state", "choice"], every: 200, at: 0 },
  { draw: drawLine, on: ["frames", "state", "choice"], every: 80, at: 0 },
  { draw: drawEvents, on: ["frames", "choice"], every: 250, at: 0 },
  { draw: drawPlot, on: ["frames", "state", "choice"], every: 150, at: 0 },
  { draw: drawCounts, on: ["frames", "state", "hello"], every: 200, at: 0 },
];

function frame(now) {
  const fresh = new Set(stale);
  stale.clear();
  for (const drawer of DRAWERS) {
    drawer.due ||= drawer.on.some((what) => fresh.has(what));
    // What was chosen shows at once.
    if (drawer.due && (now - drawer.at >= drawer.every || fresh.has("choice"))) {
      [drawer.due, drawer.at] = [false, now];
      working(drawer.draw);
    }
  }
  requestAnimationFrame(frame);
}

function drawTabs() {
  if (store.hello === null) return;
  write(byId("title"), store.hello.title);
  document.title = store.hello.title;
  const items = store.segments.map((segment, number) => ({ segment, number }));
  keyed(byId("segments"), items, (it) => it.number,
    ({ number }) => el("button", { type: "button", onclick: () => choose({ chosen: number, node: null, etag: null, notice: null }) }),
    (button, { segment, number }) => {
      const state = segment.state;
      const sign = state === null ? "◌" : state.trouble !== null ? "▲" : state.findings.some((it) => it.severity === "error") ? "✖" : "●";
      write(button, `${sign} ${segment.name}${state === null ? "" : ` ${percent(shareOf(state.snapshot.load.now))}`}`);
      button.setAttribute("aria-pressed", number === store.chosen);
    });
}

function drawCounts() {
  write(byId("count-frames"), store.frames);
  write(byId("count-lost"), store.lost);
  write(byId("count-untold"), store.untold);
  write(byId("busy"), (workShare() * 100).toFixed(0));
}

const SECTIONS = ["map", "feed", "line", "channel", "load", "channels", "nodes", "events", "ways"];

function onKey(event) {
  const typed = event.target.closest("input, select, textarea");
  if (event.ctrlKey || event.metaKey || event.altKey || byId("help").open) return;
  if (event.key === "Escape") {
    byId("filter").value = "";
    store.filter = "";
    choose({ node: null, etag: null, notice: null });
    event.target.blur();
    return;
  }
  if (typed) return;
  const onButton = event.target.closest("button, [role=button]");
  const actions = {
    "/": () => byId("filter").focus(),
    "?": () => byId("help").showModal(),
    "+": () => zoom(-1),
    "-": () => zoom(1),
    ArrowLeft: () => pan(-1),
    ArrowRight: () => pan(1),
    s: () => choose({ chosen: (store.chosen + 1) % Math.max(1, store.segments.length), node: null, etag: null, notice: null }),
  };
  if (!onButton) actions[" "] = () => pause(!store.paused);
  const section = SECTIONS[Number(event.key) - 1];
  if (event.key >= "1" && section !== undefined) actions[event.key] = () => byId(section).focus();
  const action = actions[event.key];
  if (action === undefined) return;
  event.preventDefault();
  action();
}

function begin() {
  makeHeads();
  byId("filter").addEventListener("input", (event) => {
    store.filter = event.target.value.trim().toLowerCase();
    changed("choice");
  });
  byId("control").addEventListener("change", (event) => choose({ control: event.target.checked }));
  byId("feed-kind").addEventListener("change", () => changed("choice"));
  byId("plot-field").addEventListener("change", () => changed("choice"));
  byId("plot-span").addEventListener("change", () => changed("choice"));
  byId("pause").addEventListener("click", () => pause(!store.paused));
  byId("keys").addEventListener("click", () => byId("help").showModal());
  byId("zoom-in").addEventListener("click", () => zoom(-1));
  byId("zoom-out").addEventListener("click", () => zoom(1));
  byId("publish").addEventListener("submit", publishNow);
  const canvas = byId("line-canvas");
  const point = (event) => {
    line.under = frameAt(event);
    changed("choice");
  };
  canvas.addEventListener("pointermove", point);
  canvas.addEventListener("click", (event) => {
    const found = frameAt(event);
    if (found !== null && found[ETAG] !== null) choose({ etag: found[ETAG] >= 100 ? found[ETAG] : null, node: null });
  });
  canvas.addEventListener("pointerleave", () => {
    line.under = null;
    changed("choice");
  });
  document.addEventListener("keydown", onKey);
  window.addEventListener("resize", () => changed("choice"));
  // The token may come with the address that was printed. It stays here: a browser sends no fragment.
  const token = /token=([0-9a-f]+)/.exec(location.hash);
  if (token !== null) {
    byId("publish-token").value = token[1];
    history.replaceState(null, "", location.pathname);
  }
  turn("connecting");
  connect();
  setInterval(watchConnection, 250);
  requestAnimationFrame(frame);
}

begin();
