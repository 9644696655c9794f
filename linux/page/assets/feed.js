// What went wrong: what the doctor finds now, and what happened.

const KIND_WORDS = (kind) => kind.replaceAll("-", " ");

function drawFindings() {
  const segment = chosenSegment();
  if (segment?.state == null) return;
  const { findings, trouble } = segment.state;
  byId("trouble").hidden = trouble === null;
  write(byId("trouble"), trouble === null ? "" : `The link of ${segment.name}: ${trouble}`);
  const cards = findings.map((finding) =>
    el("div", { class: `finding ${finding.severity}` },
      el("b", {}, `${finding.severity === "error" ? "✖ error" : "▲ warning"}: ${KIND_WORDS(finding.rule)} `), finding.what,
      el("div", { class: "dim" }, finding.remedy)));
  byId("findings").replaceChildren(...(cards.length > 0 ? cards : [el("p", { class: "aside" }, "✔ Nothing is wrong now.")]));
}

function noticeWords(segment, notice) {
  const where = [];
  if (notice.tx_node !== null) where.push(nodeName(segment, notice.tx_node));
  if (notice.etag !== null) where.push(channelName(segment, notice.etag));
  return where.join(", ");
}

function drawNotices() {
  const segment = chosenSegment();
  if (segment === null) return;
  const select = byId("feed-kind");
  const kinds = [...new Set([...segment.notices.values()].map((it) => it.kind))].sort();
  if (kinds.some((kind) => ![...select.options].some((option) => option.value === kind))) {
    const before = select.value;
    select.replaceChildren(el("option", { value: "" }, "all"), ...kinds.map((kind) => el("option", { value: kind }, KIND_WORDS(kind))));
    select.value = before;
  }
  const shown = [...segment.notices.values()].reverse().filter((notice) =>
    (select.value === "" || notice.kind === select.value)
    && (store.node === null || notice.tx_node === store.node || store.notice !== null)
    && passes(KIND_WORDS(notice.kind), noticeWords(segment, notice), notice.text, ...notice.exceptions.map((it) => it.name)));
  write(byId("feed-count"), `${shown.length} of ${segment.notices.size}`);
  keyed(byId("notices"), shown.slice(0, 100), (notice) => notice.id, makeNotice, (item, notice) => updateNotice(segment, item, notice));
}

function makeNotice(notice) {
  const pick = () => follow(notice.id);
  return el("li", {}, el("button", { type: "button", onclick: pick }, el("span", { class: "mono dim" }), " ", el("span", { class: "badge" }), " ", el("b"), " ", el("span")),
    el("div", { class: "more", hidden: true }));
}

function updateNotice(segment, item, notice) {
  const [head, more] = item.children;
  const [at, kind, where, text] = head.children;
  write(at, `${(notice.at_ns / 1e9).toFixed(3)} s`);
  write(kind, KIND_WORDS(notice.kind) + (notice.count > 1 ? ` ×${notice.count}` : ""));
  write(where, noticeWords(segment, notice));
  write(text, notice.text);
  const isChosen = store.notice === notice.id;
  head.setAttribute("aria-expanded", isChosen);
  more.hidden = !isChosen;
  if (isChosen && more.dataset.sequence !== String(notice.sequence)) {
    more.dataset.sequence = notice.sequence;
    const meanings = notice.exceptions.map((it) => el("p", {}, el("b", {}, it.name), `: ${it.meaning}`));
    const none = el("p", { class: "dim" }, "No exception of the middleware is known that explains it.");
    more.replaceChildren(...(meanings.length > 0 ? meanings : [none]),
      el("button", { type: "button", onclick: () => showInstant(notice.at_ns / 1000) }, "Show it on the time line"));
  }
}

/** An exception is followed to its node, its channel and its instant. */
function follow(id) {
  const segment = chosenSegment();
  const notice = segment?.notices.get(id);
  if (notice === undefined) return;
  if (store.notice === id) {
    choose({ notice: null, node: null, etag: null });
    pause(false);
    return;
  }
  choose({ notice: id, node: notice.tx_node, etag: notice.etag });
  const oldest = segment.frames[0];
  if (oldest !== undefined && oldest[END] <= notice.at_ns / 1000) showInstant(notice.at_ns / 1000);
}
