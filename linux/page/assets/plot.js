// The values of a channel over time; and publishing on it.

const MOST_POINTS = 20000;
const plot = { frames: [], segment: -1, etag: null, fields: "" };

/** Frames have come on the segment that is looked at. */
function remember(frames) {
  if (store.etag === null) return;
  for (const frame of frames) if (frame[ETAG] === store.etag) plot.frames.push(frame);
  if (plot.frames.length > 1.2 * MOST_POINTS) plot.frames.splice(0, plot.frames.length - MOST_POINTS);
}

/** Another channel is looked at: what is still known of it. */
function recall() {
  if (plot.etag === store.etag && plot.segment === store.chosen) return;
  Object.assign(plot, { etag: store.etag, segment: store.chosen, fields: "" });
  plot.frames = store.etag === null ? [] : (chosenSegment()?.frames.filter((frame) => frame[ETAG] === store.etag) ?? []);
}

/** What can be plotted: fields, or single bytes where nobody says what they mean. */
function plottable(channel) {
  if (channel.last === null) return [];
  if (channel.last.fields.length > 0) return channel.last.fields.map(({ name, unit }) => ({ name, unit }));
  return Array.from({ length: channel.last.data.length / 2 }, (_, at) => ({ name: `byte ${at}`, unit: null }));
}

function drawPlot() {
  const segment = chosenSegment();
  const channel = segment?.channels.get(store.etag);
  byId("channel-none").hidden = channel !== undefined;
  byId("channel-some").hidden = channel === undefined;
  if (channel === undefined) return;
  const named = (members) => members.map((it) => it.name ?? hex(it.tx_node)).join(", ") || "nobody";
  const last = channel.last === null ? "nothing yet" : channel.last.fields.length > 0 ? channel.last.fields.map(fieldWords).join(", ") : channel.last.data;
  write(byId("channel-words"), `${channelName(segment, store.etag)} (${channel.class ?? "?"}, etag ${channel.etag}, subject ${channel.subject ?? "?"}): `
    + `${named(channel.publishers)} → ${named(channel.subscribers)}. Last: ${last}`);
  byId("publish").hidden = !store.hello.may_publish || channel.class === "HRT";
  const fields = plottable(channel);
  const key = JSON.stringify(fields);
  const select = byId("plot-field");
  if (plot.fields !== key) {
    plot.fields = key;
    select.replaceChildren(...fields.map((it, at) => el("option", { value: at }, it.name + (it.unit ? ` (${it.unit})` : ""))));
  }
  drawValues(segment, fields[Number(select.value)], Number(select.value), channel.last?.fields.length > 0);
}

function valueOf(frame, at, hasFields) {
  if (!hasFields) {
    const byte = parseInt(frame[BYTES].slice(2 * at, 2 * at + 2), 16);
    return Number.isNaN(byte) ? null : byte;
  }
  return Array.isArray(frame[SAID]) ? (frame[SAID][at] ?? null) : null;
}

function drawValues(segment, field, at, hasFields) {
  const { context, width, height } = surface(byId("plot"));
  const seconds = Number(byId("plot-span").value);
  const end = store.paused ? line.edge : latest(segment);
  const from = end - seconds * 1e6;
  const points = [];
  for (let i = Math.max(0, firstFrom(plot.frames, from) - 1); i < plot.frames.length && plot.frames[i][END] <= end; i++) {
    const value = valueOf(plot.frames[i], at, hasFields);
    if (value !== null) points.push([plot.frames[i][END], value]);
  }
  if (field === undefined || points.length === 0) {
    write(byId("plot-now"), "");
    write(byId("plot-text"), "No event in this time.");
    return;
  }
  // Words and truth values get places of their own on the axis.
  const words = [];
  const number = (value) => {
    const parsed = Number(value);
    if (!Number.isNaN(parsed)) return parsed;
    if (!words.includes(value)) words.push(value);
    return words.indexOf(value);
  };
  const values = points.map(([time, value]) => [time, number(value)]);
  let [low, high] = [Infinity, -Infinity];
  for (const [, value] of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
  const [shownLow, shownHigh] = high > low ? [low, high] : [low - 1, high + 1];
  const left = 64;
  const x = (time) => left + ((time - from) / (seconds * 1e6)) * (width - left - 6);
  const y = (value) => height - 16 - ((value - shownLow) / (shownHigh - shownLow)) * (height - 28);
  context.fillStyle = colour("dim");
  const label = (value) => words[value] ?? (Math.abs(value) >= 1e5 ? value.toExponential(2) : String(Number(value.toFixed(4))));
  const marks = words.length > 0 ? words.map((_, place) => place) : [shownLow, (shownLow + shownHigh) / 2, shownHigh];
  for (const mark of marks) {
    context.fillText(label(mark), 3, y(mark) + 4, left - 6);
    context.globalAlpha = 0.3;
    context.fillRect(left, y(mark), width - left, 1);
    context.globalAlpha = 1;
  }
  context.fillText(`${seconds} s ago`, left, height - 3);
  context.fillText("now", width - 26, height - 3);
  context.strokeStyle = colour("hard");
  context.lineWidth = 1.5;
  context.beginPath();
  values.forEach(([time, value], place) => {
    // A value holds until the next event.
    if (place > 0) context.lineTo(Math.max(left, x(time)), y(values[place - 1][1]));
    context[place === 0 ? "moveTo" : "lineTo"](Math.max(left, x(time)), y(value));
  });
  context.lineTo(x(end), y(values.at(-1)[1]));
  context.stroke();
  const unit = field.unit ? ` ${field.unit}` : "";
  write(byId("plot-now"), `${points.at(-1)[1]}${unit}`);
  write(byId("plot-text"), `${field.name}: ${points.length} values in ${seconds} s, from ${label(low)} to ${label(high)}${unit}, now ${points.at(-1)[1]}${unit}.`);
}

async function publishNow(event) {
  event.preventDefault();
  const segment = chosenSegment();
  const answer = byId("publish-answer");
  const channel = segment.channels.get(store.etag);
  const body = { segment: store.chosen, channel: channel.name ?? channel.subject, content: byId("publish-content").value.split(/\s+/).filter(Boolean) };
  write(answer, "…");
  try {
    const headers = { "content-type": "application/json", authorization: `Bearer ${byId("publish-token").value}` };
    const response = await fetch("api/publish", { method: "POST", headers, body: JSON.stringify(body) });
    const told = await response.json();
    write(answer, told.published ? "Published." : told.why);
  } catch {
    write(answer, "The server does not answer.");
  }
}
