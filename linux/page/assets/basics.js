// Small helpers that the rest shares.

const byId = (id) => document.getElementById(id);

/** An element with attributes, listeners (`on…`) and children. */
function el(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/** The same for drawings. */
function svg(tag, attributes = {}, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== null));
  return node;
}

/** Sets a text only when it is another, so that nothing is laid out in vain. */
function write(node, text) {
  const words = String(text);
  if (node.textContent !== words) node.textContent = words;
}

/** Makes the children of `parent` those of `items`: elements are kept by key, so that focus stays where it is. */
function keyed(parent, items, keyOf, make, update) {
  const old = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  let place = parent.firstElementChild;
  for (const item of items) {
    const key = String(keyOf(item));
    let child = old.get(key);
    if (child === undefined) {
      child = make(item);
      child.dataset.key = key;
    } else {
      old.delete(key);
    }
    update(child, item);
    if (child === place) place = place.nextElementSibling;
    else parent.insertBefore(child, place);
  }
  for (const child of old.values()) child.remove();
}

/** A span of nanoseconds, short. */
function span(ns) {
  if (ns === null || ns === undefined) return "–";
  const size = Math.abs(ns);
  if (size < 1e3) return `${Math.round(ns)} ns`;
  if (size < 1e6) return `${Math.round(ns / 1e3)} µs`;
  if (size < 1e9) return `${(ns / 1e6).toFixed(1)} ms`;
  return `${(ns / 1e9).toFixed(1)} s`;
}

const percent = (share) => `${(share * 100).toFixed(1)} %`;
const hex = (number, digits = 2) => number.toString(16).toUpperCase().padStart(digits, "0");

const CLASSES = [
  { name: "HRT", words: "hard real-time", share: "hard", style: "hard" },
  { name: "SRT", words: "soft real-time", share: "soft", style: "soft" },
  { name: "NRT", words: "non real-time", share: "non_real_time", style: "non" },
  { name: "foreign", words: "foreign", share: "foreign", style: "foreign" },
];

/** The value of a colour of the style sheet, for canvases. */
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** A canvas as sharp as the screen; returns its context, width and height in CSS pixels. */
function surface(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { width, height } = canvas.getBoundingClientRect();
  const [w, h] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = '11px system-ui, "DejaVu Sans", sans-serif';
  return { context, width, height };
}

/** How much of the last seconds this page has worked. */
const work = { spent: 0, since: performance.now(), share: 0 };
function working(what) {
  const begun = performance.now();
  try {
    return what();
  } finally {
    work.spent += performance.now() - begun;
  }
}
function workShare() {
  const now = performance.now();
  if (now - work.since >= 2000) {
    work.share = work.spent / (now - work.since);
    [work.spent, work.since] = [0, now];
  }
  return work.share;
}
