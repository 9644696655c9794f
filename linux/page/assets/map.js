// The map: nodes that publish, channels, nodes that subscribe, of each segment.

const ROW = 22;
const drawn = new Map();

function drawMaps() {
  keyed(byId("maps"), store.segments.map((segment, number) => ({ segment, number })), (it) => it.number, makeMap, updateMap);
}

function makeMap({ number }) {
  const pick = el("button", { type: "button", onclick: () => choose({ chosen: number, node: null, etag: null }) });
  return el("div", {}, el("h3", {}, pick), svg("svg", { role: "group" }));
}

function updateMap(place, { segment, number }) {
  const [head, picture] = place.children;
  const state = segment.state;
  const load = state === null ? "" : `: ${percent(shareOf(state.snapshot.load.now))} of the bus`;
  write(head.firstChild, `${segment.name}${load}`);
  if (state === null) return;
  const width = Math.max(260, place.clientWidth);
  const plan = layOut(state.snapshot, width);
  const key = JSON.stringify([width, plan.spots.map((it) => [it.id, it.label]), plan.wires.map((it) => [it.from, it.to])]);
  if (drawn.get(number)?.key !== key) {
    paint(picture, plan, width, number);
    drawn.set(number, { key, spots: [...picture.querySelectorAll(".spot")], wires: [...picture.querySelectorAll(".wire")] });
  }
  mark(drawn.get(number), plan, segment, number);
}

const shareOf = (share) => share.hard + share.soft + share.non_real_time + share.foreign;

/** Where each node and channel stands, and what joins them. */
function layOut(snapshot, width) {
  const nodes = new Map(snapshot.nodes.map((node) => [node.tx_node, node]));
  // A gateway knows names that no plan of the segment does.
  const crossing = new Map((store.crossings?.ways ?? []).map((it) => [it.subject, it.channel]));
  const columns = [[], [], []];
  const wires = [];
  const seen = [new Set(), new Set()];
  const node = (side, member) => {
    if (!seen[side].has(member.tx_node)) {
      seen[side].add(member.tx_node);
      const known = nodes.get(member.tx_node);
      const label = member.name ?? `node ${hex(member.tx_node)}`;
      columns[2 * side].push({ id: `${"ps"[side]}${member.tx_node}`, label, tx: member.tx_node, absent: !known?.alive });
    }
    return `${"ps"[side]}${member.tx_node}`;
  };
  snapshot.channels.forEach((channel, at) => {
    const id = `c${channel.etag ?? `-${at}`}`;
    const crosses = crossing.has(channel.subject);
    const name = channel.name ?? crossing.get(channel.subject) ?? channel.subject ?? `etag ${channel.etag}`;
    const label = `${name}${crosses ? " ⇄" : ""}`;
    const style = CLASSES.find((it) => it.name === channel.class)?.style ?? "";
    columns[1].push({ id, label, etag: channel.etag, style, words: `${channel.class ?? ""}${crosses ? ", crosses between segments" : ""}`, absent: channel.frames === 0 });
    channel.publishers.forEach((it) => wires.push({ from: node(0, it), to: id }));
    channel.subscribers.forEach((it) => wires.push({ from: id, to: node(1, it) }));
  });
  for (const column of [columns[0], columns[2]]) column.sort((a, b) => a.tx - b.tx);
  // Nodes that take part in no channel stand below those that publish.
  snapshot.nodes
    .filter((it) => !seen[0].has(it.tx_node) && !seen[1].has(it.tx_node))
    .forEach((it) => columns[0].push({ id: `p${it.tx_node}`, label: it.name ?? `node ${hex(it.tx_node)}`, tx: it.tx_node, absent: !it.alive }));
  const rows = Math.max(...columns.map((column) => column.length), 1);
  const size = Math.min(190, Math.floor((width - 60) / 3));
  const lefts = [1, (width - size) / 2, width - size - 1];
  columns.forEach((column, at) =>
    column.forEach((spot, row) => {
      // A shorter column is spread over the height.
      const stretch = column.length > 1 ? (rows - 1) / (column.length - 1) : 1;
      Object.assign(spot, { x: lefts[at], y: 18 + ROW * (column.length > 1 ? row * stretch : (rows - 1) / 2), size });
    }),
  );
  return { spots: columns.flat(), wires, height: 18 + ROW * rows, lefts };
}

function paint(picture, plan, width, number) {
  picture.setAttribute("viewBox", `0 0 ${width} ${plan.height}`);
  picture.setAttribute("height", plan.height);
  const places = new Map(plan.spots.map((spot) => [spot.id, spot]));
  const heads = ["publish", "channels", "subscribe"].map((text, at) => svg("text", { class: "head", x: plan.lefts[at], y: 11 }, text));
  const wires = plan.wires.map(({ from, to }) => {
    const [a, b] = [places.get(from), places.get(to)];
    const [x1, y1, x2, y2] = [a.x + a.size, a.y + 9, b.x, b.y + 9];
    const bend = (x2 - x1) / 2;
    return svg("path", { class: "wire", d: `M${x1} ${y1}C${x1 + bend} ${y1} ${x2 - bend} ${y2} ${x2} ${y2}` });
  });
  const letters = Math.floor((places.values().next().value?.size ?? 100) / 6.9) - 1;
  const spots = plan.spots.map((spot) => {
    const text = spot.label.length > letters ? `${spot.label.slice(0, letters - 1)}…` : spot.label;
    const pick = () => {
      const part = spot.tx === undefined ? { etag: spot.etag, node: null } : { node: spot.tx };
      const again = store.chosen === number && (spot.tx === undefined ? store.etag === spot.etag : store.node === spot.tx);
      choose(again ? { node: null, etag: null } : { chosen: number, ...part });
    };
    const onkeydown = (event) => {
      if (event.key === "Enter") pick();
    };
    const attributes = { class: "spot", tabindex: 0, role: "button", onclick: pick, onkeydown };
    return svg("g", attributes, svg("title"), svg("rect", { x: spot.x, y: spot.y, width: spot.size, height: 18, rx: spot.tx === undefined ? 9 : 2 }),
      svg("text", { x: spot.x + 6, y: spot.y + 13 }, text));
  });
  picture.replaceChildren(...heads, ...wires, ...spots);
}

/** Sets off what is chosen, and what is joined to it. */
function mark({ spots, wires }, plan, segment, number) {
  const isHere = store.chosen === number;
  const origins = new Set();
  if (isHere && store.node !== null) ["p", "s"].forEach((side) => origins.add(side + store.node));
  if (isHere && store.etag !== null) origins.add(`c${store.etag}`);
  const lit = new Set(origins);
  plan.wires.forEach(({ from, to }, at) => {
    const on = origins.has(from) || origins.has(to);
    if (on) [from, to].forEach((id) => lit.add(id));
    wires[at].setAttribute("class", `wire${on ? " on" : origins.size > 0 ? " faint" : ""}`);
  });
  plan.spots.forEach((spot, at) => {
    const faint = origins.size > 0 ? !lit.has(spot.id) : !passes(spot.label, spot.words ?? "", segment.name);
    const names = ["spot", spot.style ?? "", spot.absent ? "absent" : "", origins.has(spot.id) ? "chosen" : "", faint ? "faint" : ""];
    spots[at].setAttribute("class", names.join(" "));
    const title = spot.tx === undefined ? `channel ${spot.label} ${spot.words}` : `node ${spot.label}, TxNode ${hex(spot.tx)}`;
    write(spots[at].firstChild, spot.absent ? `${title}, not heard` : title);
    spots[at].setAttribute("aria-label", spots[at].firstChild.textContent);
    spots[at].setAttribute("aria-pressed", origins.has(spot.id));
  });
}
