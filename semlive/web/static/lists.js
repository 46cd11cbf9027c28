// Panels of text: state of the run, plan, alarms, frames that are not used.

import { byId, make, say } from "./dom.js";
import { panel, silence, timeNow } from "./stream.js";
import { STATES, duration, plain, timeOfDay } from "./words.js";

let latest = null;

export function lists() {
  panel(["run", "protocol", "schedule", "now"], head);
  panel(["protocol", "schedule"], plan);
  panel(["alarms"], ({ alarms, now }) => fill("alarms", alarms.toReversed(), now, alarm, "none"));
  panel(["frames"], refused);
  setInterval(tick, 250);
}

function head(state) {
  const { run, protocol, schedule } = state;
  latest = state;
  if (!protocol) return;
  const [word, mood] = STATES[protocol.state] ?? [protocol.state, "calm"];
  say(byId("state-word"), word);
  byId("state").dataset.mood = mood;
  byId("state").dataset.state = protocol.state;
  say(byId("run"), run?.name ?? "semlive");
  document.title = run ? `${word} – ${run.name}` : "semlive";
  const step = schedule.steps[protocol.step];
  say(byId("step"), protocol.step === null || !step ? "" : `step ${protocol.step + 1} of ${schedule.steps.length}, ${step.warm_up ? "warm-up" : step.phase}`);
  say(byId("message"), protocol.asks ? "" : protocol.message);
  say(byId("about"), run ? `semlive ${run.version} on ${run.host}` : "");
  const trouble = byId("trouble");
  trouble.hidden = !protocol.asks;
  if (protocol.asks && trouble.dataset.shown !== protocol.message + protocol.advice) {
    trouble.dataset.shown = protocol.message + protocol.advice;
    trouble.replaceChildren(make("b", {}, `${word}: ${protocol.message}`), protocol.advice);
  }
  tick();
}

/** Update what changes without messages: the countdown and the state of the connection. */
function tick() {
  if (!latest?.protocol) return connection("waiting for the log");
  const { protocol, now, run } = latest;
  const left = protocol.hold_end_s === null ? null : protocol.hold_end_s - timeNow();
  const longer = run && run.max_hold_s > run.hold_s ? `extended until drift and load are stable, at most ${duration(run.max_hold_s)}` : "0 s";
  say(byId("countdown"), left === null || !now.live ? "" : left > 0 ? `${Math.ceil(left)} s left` : longer);
  const over = protocol.state === "complete" || protocol.state === "aborted";
  if (silence() > 6) connection(`no connection for ${duration(silence())}; the page shows old values`);
  else if (now.trouble) connection(now.trouble);
  else if (now.reading) connection("reading the log");
  else if (now.orphaned && !over && now.silent_s > 10) connection(`the log has not grown for ${duration(now.silent_s)}: check whether semlive run is still running`);
  else connection("");
}

function connection(text) {
  byId("connection").hidden = !text;
  say(byId("connection"), text);
}

export function broken() {
  if (silence() > 1) connection("no connection; trying again");
}

function plan({ protocol, schedule }) {
  const over = protocol.state === "complete";
  const rows = schedule.steps.map((step, at) => {
    const current = at === protocol.step && !over;
    const shift = step.shift_px.some(Boolean) ? step.shift_px.map(plain).join(", ") : "–";
    return make("tr", { class: at < schedule.done ? "done" : null, "aria-current": current ? "step" : null }, make("td", {}, String(at + 1)),
      make("td", {}, step.warm_up ? "warm-up" : step.phase), make("td", {}, shift), make("td", {}, step.load_n === null ? "–" : plain(step.load_n)),
      make("td", {}, at < schedule.done ? "✓ taken" : current ? "now" : ""));
  });
  byId("plan").replaceChildren(...rows);
  const here = byId("plan").querySelector("[aria-current]");
  const box = byId("plan").closest(".scroll");
  if (here && !box.matches(":hover, :focus-within")) box.scrollTop = here.offsetTop - box.clientHeight / 2;
}

function fill(id, all, now, one, none) {
  byId(id).replaceChildren(...(all.length ? all.map((item) => one(item, now)) : [make("li", {}, none)]));
}

const stamp = (now, seconds) => make("time", {}, timeOfDay(now.start_ms, seconds));

const alarm = (one, now) => make("li", { class: one.level }, stamp(now, one.time_s), make("b", {}, one.text), one.code ? make("code", {}, one.code) : null,
  one.advice ? make("span", { class: "advice" }, one.advice) : null, one.identity ? make("span", { class: "advice" }, acknowledged(one, now)) : null);

const acknowledged = (one, now) => one.acknowledged_s === null ? "not acknowledged"
  : `acknowledged ${timeOfDay(now.start_ms, one.acknowledged_s)}${one.acknowledged_by ? `, ${one.acknowledged_by}` : ""}`;

function refused({ frames, now }) {
  say(byId("refused-now"), `${frames.arrived} files arrived, ${frames.paired} frames are in pairs, ${frames.refused_count} are not used`);
  fill("refused", frames.refused, now, (one) => make("li", {}, stamp(now, one.time_s), one.name && !one.reason.includes(one.name) ? `${one.name}: ${one.reason}` : one.reason), "none");
}
