// What the server tells, kept as one state; panels are called with it when their parts change.

const state = { load: { rows: [] }, now: { time_s: 0, rate: 0, live: false, reading: true, silent_s: 0, start_ms: 0, trouble: "" } };
const panels = [];
let nowAt = performance.now();
let heardAt = performance.now();
let pending = new Set();
let lineCount = 0;
const MAX_LINES = 60;

/** Call `draw(state)` when one of these parts changed; many changes at once are one call. */
export function panel(parts, draw) {
  panels.push({ parts, draw });
}

/** Experiment time now, seconds after the start of the run. */
export const timeNow = () => state.now.time_s + (state.now.rate * (performance.now() - nowAt)) / 1000;

/** Seconds since the server said anything. */
export const silence = () => (performance.now() - heardAt) / 1000;

// A browser has six connections to a server, and each tab that listens holds one: those that nobody looks at give theirs back, so that
// Stop always finds one.
const ASLEEP_MS = 30000;

/** Listen until the page is left; the browser itself comes back after a break, and gets everything anew. */
export function listen(onBroken) {
  let source = null, sleep = 0;

  function open() {
    source = new EventSource("events");
    source.onmessage = (event) => {
      heardAt = performance.now();
      take(JSON.parse(event.data));
    };
    source.onerror = () => {
      onBroken();
      // A server that answered with an error is not asked again by the browser.
      if (source?.readyState === EventSource.CLOSED) setTimeout(() => source?.readyState === EventSource.CLOSED && open(), 3000);
    };
  }

  document.addEventListener("visibilitychange", () => {
    clearTimeout(sleep);
    if (document.hidden) sleep = setTimeout(() => { source?.close(); source = null; }, ASLEEP_MS);
    else if (source === null) open();
  });
  open();
}

function take(told) {
  for (const [name, value] of Object.entries(told)) {
    if (name === "whole") continue;
    if (name === "load") {
      state.load.rows.length = Math.min(state.load.rows.length, value.from);
      for (const row of value.rows) state.load.rows.push(row);
    } else if (name === "lines") {
      // A new array, so that lists see the change; rows follow those that are known, or replace them.
      state.lines = [...(value.from === lineCount ? state.lines ?? [] : []), ...value.rows].slice(-MAX_LINES);
      lineCount = value.from + value.rows.length;
    } else state[name] = value;
    pending.add(name);
  }
  nowAt = performance.now();
  if (pending.size) requestDraw();
}

let asked = false;
function requestDraw() {
  if (asked) return;
  asked = true;
  // A hidden tab is drawn when it is looked at; words are said at once, charts with the next picture.
  (document.hidden ? (call) => setTimeout(call, 250) : requestAnimationFrame)(draw);
}

function draw() {
  asked = false;
  const changed = pending;
  pending = new Set();
  for (const one of panels) {
    if (one.parts.some((part) => changed.has(part))) one.draw(state);
  }
}
