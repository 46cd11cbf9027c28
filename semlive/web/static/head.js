// The head of the page: state, countdown, what is next, remaining time, load against its limits, E, and the connection.

import { byId, make, say } from "./dom.js";
import { nameFiles } from "./save.js";
import { panel, silence, timeNow } from "./stream.js";
import { FINAL, STATES, countdown, duration, measured, number, plain, stepText, timeOfDay } from "./words.js";

const LONG_WORD = 12;
// Part of the way from zero to a limit at which the gauge shows attention.
const NEAR_LIMIT = 0.9;
let latest = null;

export function head() {
  panel(["run", "protocol", "schedule", "progress", "desk", "now"], state);
  panel(["reading", "run"], load);
  panel(["strength"], modulus);
  setInterval(tick, 250);
}

function state(told) {
  const { run, protocol, schedule, desk } = told;
  latest = told;
  if (!protocol) return;
  // A load frame that a person moves is "moving" until the answer: across the room that reads as if nothing were to be done.
  const [word, mood] = protocol.state === "ramping" && desk?.questions.length && !protocol.asks ? ["question", "wait"] : STATES[protocol.state] ?? [protocol.state, "calm"];
  say(byId("state-word"), word);
  const sign = byId("state");
  sign.dataset.mood = mood;
  sign.dataset.state = protocol.state;
  sign.toggleAttribute("data-long", word.length > LONG_WORD);
  say(byId("run"), run?.name ?? "semlive");
  if (run) nameFiles(run.name);
  document.title = run ? `${word} – ${run.name}` : "semlive";
  const step = schedule.steps[protocol.step];
  say(byId("step"), protocol.step === null || !step ? "" : `step ${protocol.step + 1} of ${schedule.steps.length}, ${stepText(step)}`);
  // The line above names the step already.
  say(byId("message"), protocol.asks || /^step \d+ of /.test(protocol.message) ? "" : protocol.message);
  say(byId("next"), next(told) || "–");
  say(byId("about"), run ? `semlive ${run.version} on ${run.host}` : "");
  const trouble = byId("trouble");
  trouble.hidden = !protocol.asks;
  trouble.dataset.mood = mood;
  if (protocol.asks && trouble.dataset.shown !== protocol.message + protocol.advice) {
    trouble.dataset.shown = protocol.message + protocol.advice;
    trouble.replaceChildren(make("b", {}, `${word}: ${protocol.message}`), protocol.advice);
  }
  tick();
}

/** What happens after the present state. */
function next({ run, protocol, schedule, desk }) {
  if (desk?.questions.length) return "your answer to the question below";
  const at = protocol.step ?? 0, steps = schedule.steps, numbered = (i) => (steps[i] ? `step ${i + 1}: ${stepText(steps[i])}` : "");
  switch (protocol.state) {
    case "idle": case "connecting": case "ready": return numbered(0);
    case "ramping": case "settling": return run?.hold_s ? `hold for ${duration(run.hold_s)}, then a pair of frames` : "a pair of frames";
    case "holding": return "a pair of frames";
    case "imaging": return numbered(at + 1) || "the end of the run";
    case "step_done": return numbered(Math.max(at, schedule.done)) || "the end of the run";
    case "judging": return "the first load, if the calibration is good enough";
    case "warming": return `${numbered(at)}, when the drift is slow enough`;
    case "paused": case "fault": case "estopped": case "recover": return `your decision: Resume repeats ${numbered(at) || "the step"}`;
    case "stopping": return "the end, when nothing moves";
    case "complete": return "nothing";
    case "aborted": return "nothing: the run has ended";
    default: return "";
  }
}

/** Update what changes without messages: the countdown, the remaining time and the state of the connection. */
function tick() {
  if (!latest?.protocol) return connection("waiting for the log");
  const { protocol, now, run } = latest;
  const left = protocol.hold_end_s === null ? null : protocol.hold_end_s - timeNow();
  const extended = run && run.max_hold_s > run.hold_s && left !== null && left <= 0 && now.live;
  say(byId("countdown"), left === null || !now.live ? "" : left > 0 ? `${countdown(left)} left` : extended ? "extended" : "0 s");
  say(byId("extended"), extended ? `until drift and load are stable, at most ${duration(run.max_hold_s)}` : "");
  remaining(latest);
  const over = FINAL.includes(protocol.state);
  if (silence() > 6) connection(`no connection for ${duration(silence())}; the page shows old values`);
  else if (now.trouble) connection(now.trouble);
  else if (now.reading) connection("reading the log");
  else if (now.orphaned && !over && now.silent_s > 10) connection(`the log has not grown for ${duration(now.silent_s)}: check whether semlive run is still running`);
  else connection("");
}

/** Remaining time of the run. It stops while the protocol does not work, and never falls below the time of the later steps. */
function remaining({ protocol, progress, now }) {
  if (FINAL.includes(protocol.state)) return [say(byId("left"), protocol.state === "complete" ? "none" : "–"), say(byId("left-note"), "the run is over")];
  if (!progress || progress.remaining_s === null) return [say(byId("left"), "–"), say(byId("left-note"), "known after the first frame")];
  const moving = progress.working && now.live;
  const left = Math.max(progress.floor_s, progress.remaining_s - (moving ? timeNow() - progress.since_s : 0));
  say(byId("left"), duration(left));
  say(byId("left-note"), moving ? `ends about ${timeOfDay(now.start_ms, timeNow() + left, {})}` : now.live ? "stopped" : "when it continues");
}

function connection(text) {
  byId("connection").hidden = !text;
  say(byId("connection"), text);
}

export function broken() {
  if (silence() > 1) connection("no connection; trying again");
}

function load({ reading, run }) {
  const known = reading && reading.force_n !== null;
  byId("load-fact").hidden = !known;
  byId("gauges").hidden = !known || run?.limits.force_max_n === undefined;
  if (!known) return;
  const limits = run?.limits ?? {}, limit = limits.force_max_n === undefined ? "" : `, limit ${plain(limits.force_max_n)} N`;
  say(byId("load-value"), `${number(reading.force_n, Math.abs(reading.force_n) < 100 ? 3 : 4)} N`);
  say(byId("load-of"), `of ${plain(Number(reading.target_n.toPrecision(4)))} N${limit}${reading.motion === "stopped" ? "" : `, ${reading.motion}`}`);
  if (byId("gauges").hidden) return;
  gauge("load", "N", reading.force_n, reading.target_n, limits.force_min_n, limits.force_max_n);
  if (reading.extension_mm && limits.extension_max_mm !== undefined) gauge("ext.", "mm", reading.extension_mm, null, limits.extension_min_mm, limits.extension_max_mm);
}

/** A bar between two limits, from zero to the value, with the target as a mark. */
function gauge(name, unit, value, target, low, high) {
  const box = byId("gauges"), id = `gauge-${unit}`, part = (v) => `${100 * Math.min(1, Math.max(0, (v - low) / (high - low)))}%`;
  let bar = byId(id);
  if (!bar) {
    const track = make("div", { class: "track" }, make("div", { class: "fill" }), make("div", { class: "zero" }), make("div", { class: "target" }));
    box.append((bar = make("div", { id, class: "gauge", role: "img" }, make("span", {}, name), make("span"), track, make("span"))));
  }
  const [, from, track, to] = bar.children, [fill, zero, mark] = track.children;
  say(from, `${plain(low)} ${unit}`);
  say(to, `${plain(high)} ${unit}`);
  const begin = Math.min(0, value), end = Math.max(0, value);
  fill.style.left = part(begin);
  fill.style.right = `${100 - Number.parseFloat(part(end))}%`;
  zero.style.left = part(0);
  mark.hidden = target === null;
  if (target !== null) mark.style.left = part(target);
  const beyond = value > high || value < low, near = value > 0 ? value > NEAR_LIMIT * high : value < NEAR_LIMIT * low;
  bar.dataset.mood = beyond ? "bad" : near ? "wait" : "good";
  bar.setAttribute("aria-label", `${name} ${number(value)} ${unit} between ${plain(low)} and ${plain(high)} ${unit}${beyond ? ", beyond the limit" : near ? ", near the limit" : ""}`);
}

function modulus({ strength }) {
  const found = strength.elastic.findLast((one) => one.modulus_gpa !== null);
  say(byId("modulus"), found ? `${measured(found.modulus_gpa, found.modulus_sigma_gpa)} GPa` : "no result yet");
  say(byId("ratio"), found ? `ν ${measured(found.ratio, found.ratio_sigma)}` : "");
}
