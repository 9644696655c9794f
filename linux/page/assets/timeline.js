// The time line of the bus: frames by class, against the windows of the calendar.

const WINDOWS_MS = [2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
const line = { zoom: 5, edge: 0, under: null };
const LEFT = 58;
const MOST_WINDOWS = 3000;

const windowUs = () => WINDOWS_MS[line.zoom] * 1000;

/** The latest instant of a segment, in microseconds of its link's clock. */
function latest(segment) {
  const last = segment.frames.at(-1);
  return Math.max(last === undefined ? 0 : last[END], segment.state === null ? 0 : segment.state.now_ns / 1000);
}

/** Where the first frame is that ends at `at` or later. */
function firstFrom(frames, at) {
  let [low, high] = [0, frames.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (frames[middle][END] < at) low = middle + 1;
    else high = middle;
  }
  return low;
}

function drawLine() {
  const segment = chosenSegment();
  write(byId("line-window"), `${WINDOWS_MS[line.zoom]} ms`);
  if (segment === null || segment.state === null) return;
  if (!store.paused) {
    const last = segment.frames.at(-1);
    line.edge = last === undefined ? latest(segment) : last[END];
  }
  const { context, width, height } = surface(byId("line-canvas"));
  const [to, size] = [line.edge, windowUs()];
  const from = to - size;
  const scale = (width - LEFT - 4) / size;
  const x = (at) => LEFT + (at - from) * scale;
  const lane = (height - 18) / 4;
  const view = { context, segment, from, to, scale, x, lane, width, height };
  drawLanes(view);
  const windows = drawWindows(view);
  const counts = drawFrames(view);
  drawScale(view);
  describe(view, counts, windows);
}

function drawLanes({ context, lane, width }) {
  CLASSES.forEach((it, at) => {
    context.fillStyle = colour("dim");
    context.fillText(it.name, 4, at * lane + lane / 2 + 4);
    context.fillStyle = colour("rule");
    context.fillRect(LEFT, (at + 1) * lane, width - LEFT, 1);
  });
}

/** Windows of the calendar, from ready to delivery, with a line at the deadline. */
function drawWindows({ context, segment, from, to, scale, x, lane }) {
  const { slots } = segment.state.snapshot;
  if (slots.length === 0) return "no calendar is known: give the cluster file";
  if (segment.offset === null) return "the clock of the cluster is not known yet";
  let left = MOST_WINDOWS;
  const fresh = colour("window");
  const edge = colour("hard");
  for (const slot of slots) {
    const local = (ns) => (ns - segment.offset) / 1000;
    const first = Math.ceil((from * 1000 + segment.offset - slot.phase_ns - slot.delivery_ns) / slot.period_ns);
    for (let number = first; left > 0; number++, left--) {
      const ready = slot.phase_ns + number * slot.period_ns;
      const start = x(local(ready));
      if (local(ready) > to) break;
      const [size, deadline] = [Math.max(1, (slot.delivery_ns / 1000) * scale), (slot.deadline_ns / 1000) * scale];
      const isChosen = store.etag === null || store.etag === slot.etag;
      context.globalAlpha = isChosen ? 1 : 0.3;
      context.fillStyle = fresh;
      context.fillRect(Math.max(start, LEFT), 1, size - Math.max(0, LEFT - start), lane - 2);
      context.fillStyle = edge;
      if (start + deadline > LEFT && size > 3) context.fillRect(start + deadline, 1, 1, lane - 2);
      if (size > 50 && start > LEFT) {
        context.fillStyle = colour("text");
        context.fillText(slot.name, start + 3, 12, size - 6);
      }
    }
  }
  context.globalAlpha = 1;
  return null;
}

function drawFrames({ context, segment, from, to, scale, x, lane }) {
  const counts = [0, 0, 0, 0];
  const colours = CLASSES.map((it) => colour(it.style));
  const { frames } = segment;
  for (let at = firstFrom(frames, from); at < frames.length && frames[at][END] - frames[at][LENGTH] <= to; at++) {
    const frame = frames[at];
    const kind = frame[CLASS];
    counts[kind]++;
    const start = Math.max(LEFT, x(frame[END] - frame[LENGTH]));
    const size = Math.max(1, x(frame[END]) - start - 0.3);
    context.globalAlpha = isOfChoice(frame) ? 1 : 0.18;
    context.fillStyle = colours[kind];
    context.fillRect(start, kind * lane + lane * 0.28, size, lane * 0.6);
    // What is set off is so by its shape, too.
    if (store.etag !== null && frame[ETAG] === store.etag) context.fillRect(start, kind * lane + lane * 0.1, size, lane * 0.1);
  }
  context.globalAlpha = 1;
  if (line.under !== null) {
    const frame = line.under;
    context.strokeStyle = colour("text");
    context.lineWidth = 2;
    const start = x(frame[END] - frame[LENGTH]);
    context.strokeRect(start - 1, frame[CLASS] * lane + lane * 0.2, Math.max(3, frame[LENGTH] * scale + 2), lane * 0.72);
  }
  return counts;
}

const isOfChoice = (frame) =>
  (store.etag === null || frame[ETAG] === store.etag) && (store.node === null || frame[TX] === store.node);

function drawScale({ context, from, to, x, width, height }) {
  const step = niceStep((to - from) / Math.max(2, Math.min(10, width / 110)));
  context.fillStyle = colour("dim");
  for (let at = Math.ceil(from / step) * step; at < to; at += step) {
    context.fillRect(x(at), height - 18, 1, 4);
    context.fillText(`${(at / 1000).toFixed(step < 1000 ? 1 : 0)} ms`, x(at) + 2, height - 5);
  }
}

function niceStep(rough) {
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((it) => it * power).find((it) => it >= rough);
}

function describe({ segment }, counts, windows) {
  const frame = line.under;
  if (frame !== null) {
    write(byId("line-text"), `${(frame[END] / 1000).toFixed(3)} ms: ${eventWords(segment, frame)}`);
    return;
  }
  const told = CLASSES.map((it, at) => `${counts[at]} ${it.words}`).join(", ");
  const missed = segment.state.snapshot.slots.reduce((sum, slot) => sum + slot.missed, 0);
  const against = windows ?? `${missed} slots missed so far`;
  write(byId("line-text"), `Frames in the last ${WINDOWS_MS[line.zoom]} ms: ${told}; ${against}.`);
}

function eventWords(segment, frame) {
  const kind = CLASSES[frame[CLASS]];
  if (frame[CLASS] === 3) return `a frame that is not COSMIC's ${frame[BYTES]}`;
  return `${kind.name} ${frame[PRIORITY]}, ${nodeName(segment, frame[TX])}, ${channelName(segment, frame[ETAG])} ${saidWords(segment, frame)}`;
}

/** What the bytes of a frame mean. */
function saidWords(segment, frame) {
  const said = frame[SAID];
  if (said === null) return frame[BYTES];
  if (typeof said === "string") return said;
  const fields = fieldsOf(segment, frame[ETAG]);
  return said.map((value, at) => `${fields[at]?.name ?? "?"}=${value}${fields[at]?.unit ? ` ${fields[at].unit}` : ""}`).join(" ");
}

const fieldsOf = (segment, etag) => segment.channels.get(etag)?.last?.fields ?? [];

function zoom(by) {
  line.zoom = Math.min(WINDOWS_MS.length - 1, Math.max(0, line.zoom + by));
  changed("choice");
}

function pan(by) {
  const segment = chosenSegment();
  if (segment === null) return;
  pause(true);
  line.edge = Math.min(latest(segment), Math.max(windowUs(), line.edge + by * windowUs() * 0.25));
  line.under = null;
  changed("choice");
}

/** Pauses where this instant is in the middle. */
function showInstant(us) {
  pause(true);
  line.edge = us + windowUs() / 2;
  changed("choice");
}

function pause(isPaused) {
  if (store.paused === isPaused) return;
  store.paused = isPaused;
  if (!isPaused) line.under = null;
  byId("pause").setAttribute("aria-pressed", isPaused);
  write(byId("pause"), isPaused ? "Go on" : "Pause");
  watchConnection();
  changed("choice");
}

/** The frame at a place of the canvas. */
function frameAt(event) {
  const segment = chosenSegment();
  if (segment === null) return null;
  const box = byId("line-canvas").getBoundingClientRect();
  const at = line.edge - windowUs() * (1 - (event.clientX - box.left - LEFT) / (box.width - LEFT - 4));
  const kind = Math.min(3, Math.floor((event.clientY - box.top) / ((box.height - 18) / 4)));
  const reach = windowUs() / 80;
  let best = null;
  const { frames } = segment;
  for (let i = firstFrom(frames, at - reach); i < frames.length && frames[i][END] - frames[i][LENGTH] < at + reach; i++) {
    const distance = (frame) => Math.max(0, at - frame[END], frame[END] - frame[LENGTH] - at);
    if (frames[i][CLASS] === kind && (best === null || distance(frames[i]) < distance(best))) best = frames[i];
  }
  return best;
}
