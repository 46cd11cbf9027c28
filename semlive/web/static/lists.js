// Panels of text: steps, plan, log, frames that are not used.

import { byId, make, say } from "./dom.js";
import { saves } from "./save.js";
import { panel } from "./stream.js";
import { FINAL, plain, stepText, timeOfDay } from "./words.js";

let state = null;

export function lists() {
  panel(["protocol", "schedule"], (told) => { state = told; plan(told); steps(told); });
  panel(["frames", "now"], refused);
  panel(["lines", "now"], log);
  const planRows = () => state?.schedule?.steps.map((step, at) => [at + 1, step.warm_up ? "warm-up" : step.phase, ...step.shift_px, step.load_n, at < state.schedule.done]) ?? [];
  for (const id of ["plan", "steps"]) saves(byId(id).closest(".panel"), id, { csv: () => [["step", "phase", "shift_x_px", "shift_y_px", "load_n", "taken"], planRows()] });
  saves(byId("refused").closest(".panel"), "frames_not_used", { csv: () => [["time", "name", "reason"], tables.refused] });
  saves(byId("log").closest(".panel"), "log", { csv: () => [["time", "level", "text"], tables.log] });
}

const tables = { refused: [], log: [] };

/** Keep the current row in the middle, unless a person scrolls. */
function follow(list, box) {
  const here = list.querySelector("[aria-current]");
  if (here && !box.matches(":hover, :focus-within")) box.scrollTop = here.offsetTop - box.offsetTop - box.clientHeight / 2;
}

function plan({ protocol, schedule }) {
  if (!protocol) return;
  const rows = schedule.steps.map((step, at) => {
    const current = at === protocol.step && protocol.state !== "complete";
    const shift = step.shift_px.some(Boolean) ? step.shift_px.map(plain).join(", ") : "–";
    return make("tr", { class: at < schedule.done ? "done" : null, "aria-current": current ? "step" : null }, make("td", {}, String(at + 1)),
      make("td", {}, step.warm_up ? "warm-up" : step.phase), make("td", {}, shift), make("td", {}, step.load_n === null ? "–" : plain(step.load_n)),
      make("td", {}, at < schedule.done ? "✓ taken" : current ? "now" : ""));
  });
  byId("plan").replaceChildren(...rows);
  follow(byId("plan"), byId("plan").closest(".scroll"));
}

function steps({ protocol, schedule }) {
  if (!protocol) return;
  const rows = schedule.steps.map((step, at) => {
    const current = at === protocol.step && !FINAL.includes(protocol.state);
    return make("li", { class: at < schedule.done ? "done" : null, "aria-current": current ? "step" : null },
      make("span", {}, at < schedule.done ? "✓" : current ? "▶" : ""), `${at + 1}. ${stepText(step)}`);
  });
  byId("steps").replaceChildren(...(rows.length ? rows : [make("li", {}, "no plan in the log")]));
  follow(byId("steps"), byId("steps"));
}

const stamp = (now, seconds) => make("time", {}, timeOfDay(now.start_ms, seconds));
const shownRows = { refused: null, log: null };

/** Draw rows again only if they are others: the time changes with every message. */
function fill(id, all, now, row, table) {
  if (shownRows[id] === all) return;
  shownRows[id] = all;
  tables[id] = all.map((one) => [timeOfDay(now.start_ms, one.time_s), ...table(one)]);
  byId(id).replaceChildren(...(all.length ? (id === "log" ? all.toReversed() : all).map((one) => row(one, now)) : [make("li", {}, "none")]));
}

function refused({ frames, now }) {
  if (!frames) return;
  say(byId("refused-now"), `${frames.arrived} files arrived, ${frames.paired} frames are in pairs, ${frames.refused_count} are not used`);
  const text = (one) => (one.name && !one.reason.includes(one.name) ? `${one.name}: ${one.reason}` : one.reason);
  fill("refused", frames.refused, now, (one) => make("li", {}, stamp(now, one.time_s), text(one)), (one) => [one.name, one.reason]);
}

function log({ lines, now }) {
  if (!lines) return;
  const row = (one) => make("li", { class: one.level === "state" ? "done" : one.level }, stamp(now, one.time_s), make("b", {}, one.text));
  fill("log", lines, now, row, (one) => [one.level, one.text]);
}
