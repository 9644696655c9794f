// Tables: channels with their deadlines, nodes, events; and load, clock, link.

const CHANNEL_HEADS = ["channel", "class", "events/s", "deadline", "latest", "left", "missed", "publishers", "subscribers", "last value"];
const NODE_HEADS = ["node", "TxNode", "state", "role", "frames/s", "exceptions", "errors", "restarts", "up"];
const EVENT_HEADS = ["time", "class", "priority", "node", "channel", "content"];
/** Columns that a phone has no room for. */
const WIDE = new Set(["deadline", "left", "publishers", "subscribers", "TxNode", "errors", "restarts", "up", "priority", "role"]);
const NUMBERS = new Set(["events", "left at least", "events/s", "deadline", "latest", "left", "missed", "frames/s", "exceptions", "restarts", "up", "priority", "time"]);
const MOST_ROWS = 40;

const style = (head) => [WIDE.has(head) ? "wide" : "", NUMBERS.has(head) ? "number" : ""].join(" ").trim();

function makeHeads() {
  const tables = [["channel-table", CHANNEL_HEADS], ["node-table", NODE_HEADS], ["event-table", EVENT_HEADS], ["way-table", WAY_HEADS],
    ["crossing-table", CROSSING_HEADS]];
  for (const [id, heads] of tables) {
    byId(id).tHead.replaceChildren(el("tr", {}, ...heads.map((head) => el("th", { scope: "col", class: style(head) }, head))));
  }
}

/** A row whose first cell is a button that chooses. */
function makeRow(heads, pick) {
  const cells = heads.map((head, at) => el("td", { class: style(head) }, at === 0 ? el("button", { type: "button", onclick: pick }) : null));
  return el("tr", {}, ...cells);
}

function fillRow(row, values, isChosen) {
  row.classList.toggle("chosen", isChosen);
  values.forEach((value, at) => {
    const cell = row.children[at];
    write(at === 0 ? cell.firstChild : cell, value);
  });
}

function drawChannels() {
  const segment = chosenSegment();
  if (segment?.state == null) return;
  const { channels, slots } = segment.state.snapshot;
  const rows = channels.map((channel) => ({ channel, ...deadlines(channel, slots) }))
    .filter(({ channel }) => passes(channel.name ?? "", channel.subject ?? "", channel.class ?? "", `etag ${channel.etag}`,
      ...channel.publishers.map((it) => it.name ?? ""), ...channel.subscribers.map((it) => it.name ?? "")));
  const named = (members) => members.map((it) => it.name ?? hex(it.tx_node)).join(", ");
  keyed(byId("channel-table").tBodies[0], rows, ({ channel }) => channel.etag ?? channel.subject,
    ({ channel }) => makeRow(CHANNEL_HEADS, () => choose({ etag: channel.etag, node: null })),
    (row, { channel, limit, latest: late, left, missed }) => {
      const last = channel.last;
      const value = last === null ? "–" : last.fields.length > 0 ? last.fields.map(fieldWords).join(" ") : last.data;
      fillRow(row, [channel.name ?? channel.subject ?? `etag ${channel.etag}`, channel.class ?? "–", channel.rate.toFixed(1), span(limit),
        span(late), span(left), missed, named(channel.publishers), named(channel.subscribers), value],
      store.etag !== null && store.etag === channel.etag);
      row.children[1].className = channel.class ?? "";
      row.children[6].classList.toggle("bad", missed !== "0" && missed !== "–");
    });
}

const fieldWords = (field) => `${field.name}=${field.value}${field.unit ? ` ${field.unit}` : ""}`;

/** How near a channel came to its deadlines: hard ones by their slots, soft ones by the priorities of their frames. */
function deadlines(channel, slots) {
  if (channel.class === "HRT") {
    const own = slots.filter((slot) => slot.etag === channel.etag);
    const most = (of) => own.reduce((found, slot) => (of(slot) === null ? found : Math.max(found ?? -Infinity, of(slot))), null);
    const missed = own.reduce((sum, slot) => sum + slot.missed + slot.outside, 0);
    const late = most((slot) => slot.latest_ns);
    const limit = own.length > 0 ? own[0].deadline_ns : null;
    return { limit, latest: late, left: late === null || limit === null ? null : limit - late, missed: own.length > 0 ? String(missed) : "–" };
  }
  const latency = channel.latency;
  if (latency === null) return { limit: channel.deadline_ns, latest: null, left: null, missed: "–" };
  return { limit: channel.deadline_ns, latest: latency.oldest_ns, left: latency.least_left_ns, missed: latency.at_the_limit > 0 ? `≤ ${latency.at_the_limit}` : "0" };
}

function drawNodes() {
  const segment = chosenSegment();
  if (segment?.state == null) return;
  const nodes = segment.state.snapshot.nodes.filter((node) =>
    passes(node.name ?? "", `node ${hex(node.tx_node)}`, node.uid ?? "", node.state ?? "", node.alive ? "" : "silent"));
  keyed(byId("node-table").tBodies[0], nodes, (node) => node.tx_node,
    (node) => makeRow(NODE_HEADS, () => choose({ node: node.tx_node, etag: null })),
    (row, node) => {
      const state = node.alive ? (node.state ?? "heard") : node.silent_ns === null ? "never heard" : `silent for ${span(node.silent_ns)}`;
      const role = [node.is_master ? "time master" : "", node.is_broker ? "broker" : "", node.planned ? "" : "not planned"];
      const errors = node.transmit_errors === null ? "–" : `tx ${node.transmit_errors} rx ${node.receive_errors}`;
      fillRow(row, [node.name ?? `node ${hex(node.tx_node)}`, hex(node.tx_node), state, role.filter(Boolean).join(", "), node.frames_per_second.toFixed(0),
        node.exceptions, errors, node.restarts, node.uptime_s === null ? "–" : `${node.uptime_s} s`], store.node === node.tx_node);
      row.children[2].classList.toggle("bad", !node.alive);
      row.children[5].classList.toggle("bad", node.exceptions > 0);
    });
}

/** The newest events that the filter and the choice let through. */
function drawEvents() {
  const segment = chosenSegment();
  if (segment === null || store.paused) return;
  const rows = [];
  const { frames } = segment;
  const end = Math.max(0, frames.length - MOST_FRAMES);
  for (let at = frames.length - 1; at >= end && rows.length < MOST_ROWS; at--) {
    const frame = frames[at];
    if (!isOfChoice(frame)) continue;
    const isControl = frame[ETAG] !== null && frame[ETAG] < 100;
    if (isControl && !store.control) continue;
    const names = [CLASSES[frame[CLASS]].name, nodeName(segment, frame[TX]), isControl ? "" : channelName(segment, frame[ETAG])];
    if (passes(...names, store.filter === "" ? "" : saidWords(segment, frame))) rows.push([frame, names]);
  }
  const body = byId("event-table").tBodies[0];
  while (body.rows.length < rows.length) body.append(el("tr", {}, ...EVENT_HEADS.map((head) => el("td", { class: style(head) }))));
  while (body.rows.length > rows.length) body.lastChild.remove();
  rows.forEach(([frame, [kind, node, channel]], at) => {
    const values = [`${(frame[END] / 1e6).toFixed(6)} s`, kind, frame[PRIORITY] ?? "", node, channel, saidWords(segment, frame)];
    values.forEach((value, column) => write(body.rows[at].children[column], value));
    body.rows[at].children[1].className = kind;
  });
}

function drawLoad() {
  const segment = chosenSegment();
  if (segment?.state == null) return;
  const { load, clock, link: wire } = segment.state.snapshot;
  const bar = el("div", { class: "bar", role: "img", "aria-label": `load ${percent(shareOf(load.now))}` });
  CLASSES.forEach((it) => {
    const part = el("span", { class: `fill-${it.style}` });
    part.style.width = percent(load.now[it.share]).replace(" ", "");
    bar.append(part);
  });
  const words = CLASSES.map((it) => el("span", {}, el("span", { class: `key fill-${it.style}` }), `${it.name} ${percent(load.now[it.share])}  `));
  byId("load-now").replaceChildren(el("b", {}, `${percent(shareOf(load.now))} of ${load.bits_per_second / 1000} kbit/s, ${load.frames_per_second.toFixed(0)} frames/s`), bar, ...words);
  drawHistory(load.history);
  const facts = [
    ["link", segment.link],
    ["received", `${wire.received} frames, ${wire.foreign} foreign, ${wire.lost} lost by the link`],
    ["time master", clock.master === null ? "none is heard" : `${nodeName(segment, clock.master)}, rank ${clock.rank}`],
    ["clock", clock.global_ns === null ? "not known" : `to ${span(clock.uncertainty_ns)}, ${clock.steps} steps`],
    ["calendar", clock.calendar === null ? "none" : clock.calendar === clock.planned_calendar ? `${clock.calendar}, as planned` : clock.calendar],
    ["brokers", segment.state.snapshot.brokers.map((it) => nodeName(segment, it)).join(", ") || "none"],
  ];
  byId("facts").replaceChildren(...facts.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
}

/** The last minute, one class upon the other. */
function drawHistory(history) {
  const picture = byId("load-history");
  picture.setAttribute("viewBox", "0 0 60 100");
  picture.setAttribute("preserveAspectRatio", "none");
  const floor = history.map(() => 100);
  const areas = CLASSES.map((it) => {
    const x = (at) => 60 - history.length + at + 1;
    const below = floor.map((y, at) => `${x(at)} ${y}`).reverse();
    history.forEach((share, at) => {
      floor[at] -= 100 * share[it.share];
    });
    const above = floor.map((y, at) => `${x(at)} ${y}`);
    return svg("polygon", { class: `fill-${it.style}`, points: [...above, ...below].join(" ") });
  });
  picture.replaceChildren(...areas);
}
