// What crosses between segments, as a gateway tells it.

const WAY_HEADS = ["channel", "class", "from", "to", "what became of it", "events", "events/s", "left", "left at least"];
const CROSSING_HEADS = ["time", "class", "channel", "from", "to", "what became of it", "left"];

/** In words what the gateway says in one: "CeilingExceeded". */
const outcomeWords = (outcome) => outcome.replaceAll(/(?<=[a-z])(?=[A-Z])/g, " ").toLowerCase();

const placeName = (from, tx) => (from === "" ? "–" : tx === null ? from : `${from}/${hex(tx)}`);

function drawWays() {
  const { crossings } = store;
  byId("ways").hidden = crossings === null;
  if (crossings === null) return;
  const ways = crossings.ways.filter((it) => passes(it.channel, it.class, it.from, it.to, outcomeWords(it.outcome)))
    .sort((a, b) => b.went - a.went);
  keyed(byId("way-table").tBodies[0], ways, (it) => JSON.stringify([it.subject, it.class, it.from, it.to, it.outcome]),
    (it) => makeRow(WAY_HEADS, () => chooseSubject(it)),
    (row, it) => {
      fillRow(row, [it.channel, it.class, placeName(it.from, null), it.to, outcomeWords(it.outcome), it.count, it.rate.toFixed(1),
        span(it.left_ns), span(it.least_left_ns)], false);
      row.children[1].className = it.class;
      row.children[4].classList.toggle("bad", !it.went);
    });
  const last = crossings.last.filter((it) => passes(it.channel, it.class, it.from, it.to, outcomeWords(it.outcome)));
  const rows = last.map((it) => {
    const at = new Date(it.at_ms);
    const time = `${at.toLocaleTimeString("en-GB")}.${String(it.at_ms % 1000).padStart(3, "0")}`;
    const values = [time, it.class, it.channel, placeName(it.from, it.node), it.to, outcomeWords(it.outcome), span(it.left_ns)];
    return el("tr", {}, ...values.map((value, at) => el("td", { class: style(CROSSING_HEADS[at]) }, value)));
  });
  byId("crossing-table").tBodies[0].replaceChildren(...rows);
}

/** Sets the channel off in the segment where it enters or leaves, if this page shows that. */
function chooseSubject({ subject, from, to }) {
  const places = store.segments.map((segment, number) => ({ segment, number }))
    .filter(({ segment }) => segment.name === to || segment.name === from);
  for (const { segment, number } of places) {
    const found = [...segment.channels.values()].find((it) => it.subject === subject);
    if (found !== undefined) return choose({ chosen: number, etag: found.etag, node: null });
  }
  return undefined;
}
