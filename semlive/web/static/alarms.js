// Alarms: the lamp in the head, the list, acknowledgement by hand, and sound.

import { byId, make, recall, remember, say } from "./dom.js";
import { saves } from "./save.js";
import { panel } from "./stream.js";
import { onKey } from "./views.js";
import { timeOfDay } from "./words.js";

const SOUND = "semlive sound";
const REPEAT_MS = 8000;
let audio = null;
let sounding = recall(SOUND, "off") === "on";
let open = [];
let announced = null;
let asking = 0;

/** Alarms that are not acknowledged, oldest first. */
export const openAlarms = () => open;

/** The alarm that is shown: the newest that needs a person, else the newest. */
export const shownAlarm = () => open.findLast((one) => one.level === "error") ?? open.at(-1);

export function alarms() {
  panel(["alarms", "desk", "now"], draw);
  panel(["alarms"], list);
  panel(["desk"], question);
  byId("sound").addEventListener("click", toggleSound);
  onKey("m", toggleSound);
  for (const gesture of ["pointerdown", "keydown"]) addEventListener(gesture, () => sounding && ready()?.resume(), { passive: true });
  setInterval(() => open.some((one) => one.level === "error") && beep([880, 660, 880]), REPEAT_MS);
  drawSound();
}

const many = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;

/** Alarms stay visible until a person acknowledges them; a machine that does not obey its stop is shown above everything else. */
function draw({ alarms: all, desk, now }) {
  if (!all) return;
  const questions = desk?.questions.length ?? 0;
  open = all.filter((one) => one.identity && one.acknowledged_s === null);
  const worst = open.findLast((one) => one.disobeyed), newest = shownAlarm();
  const dangers = open.filter((one) => one.level === "error").length, checks = open.length - dangers, warnings = all.filter((one) => !one.identity).length;
  const lamp = byId("lamp");
  lamp.dataset.mood = dangers ? "bad" : checks || questions ? "wait" : "good";
  say(byId("lamp-sign"), dangers ? "▲" : questions ? "?" : checks ? "●" : "✓");
  say(byId("lamp-text"), [dangers ? many(dangers, "ALARM") : null, questions ? many(questions, "question") : null, checks ? `${checks} to check` : null, !open.length && !questions ? "no alarm" : null, warnings ? many(warnings, "warning") : null].filter(Boolean).join(" · "));
  byId("disobeyed").hidden = !worst;
  say(byId("disobeyed"), worst ? `THE MACHINE DOES NOT OBEY ITS STOP: press the machine's own emergency stop now. ${worst.text}` : "");
  byId("open-alarms").hidden = !newest;
  byId("open-alarms").classList.toggle("warn", newest?.level !== "error");
  const word = newest?.level === "error" ? "Alarm" : "To be checked";
  const which = open.length > 1 ? `${word}, one of ${open.length} not acknowledged: ` : `${word}: `;
  say(byId("open-alarm"), newest ? `${which}${timeOfDay(now.start_ms, newest.time_s)} ${newest.text}` : "");
  const identities = new Set(open.map((one) => one.identity));
  if (announced !== null || !now.reading) {
    const fresh = open.filter((one) => !announced?.has(one.identity));
    if (fresh.length) beep(fresh.some((one) => one.level === "error") ? [880, 660, 880] : [520]);
    announced = identities;
  }
}

function question({ desk }) {
  const count = desk?.questions.length ?? 0;
  if (count > asking) beep([660, 520]);
  asking = count;
}

const stamp = (now, seconds) => make("time", {}, timeOfDay(now.start_ms, seconds));
const acknowledged = (one, now) => one.acknowledged_s === null ? "not acknowledged"
  : `acknowledged ${timeOfDay(now.start_ms, one.acknowledged_s)}${one.acknowledged_by ? `, ${one.acknowledged_by}` : ""}`;
let listed = [];

function list({ alarms: all, now }) {
  listed = all.map((one) => [timeOfDay(now.start_ms, one.time_s), one.level, one.code, one.text, one.advice, one.identity ? acknowledged(one, now) : ""]);
  const row = (one) => make("li", { class: one.level }, stamp(now, one.time_s), make("b", {}, one.text), one.code ? make("code", {}, one.code) : null,
    one.advice ? make("span", { class: "advice" }, one.advice) : null, one.identity ? make("span", { class: "advice" }, acknowledged(one, now)) : null);
  byId("alarms").replaceChildren(...(all.length ? all.toReversed().map(row) : [make("li", {}, "none")]));
}

saves(byId("alarms").closest(".panel"), "alarms", { csv: () => [["time", "level", "code", "text", "advice", "acknowledged"], listed] });

function toggleSound() {
  sounding = !sounding;
  remember(SOUND, sounding ? "on" : "off");
  drawSound();
  beep([660]);
}

function drawSound() {
  byId("sound").setAttribute("aria-pressed", String(sounding));
  say(byId("sound"), sounding ? "sound on" : "sound off");
}

const ready = () => (audio ??= typeof AudioContext === "undefined" ? null : new AudioContext());

/** Play tones of a fifth of a second each; browsers play nothing before the first key or click. */
function beep(tones) {
  if (!sounding || ready()?.state !== "running") return;
  tones.forEach((hertz, at) => {
    const tone = audio.createOscillator(), volume = audio.createGain(), begin = audio.currentTime + 0.22 * at;
    tone.frequency.value = hertz;
    volume.gain.setValueAtTime(0.0001, begin);
    volume.gain.exponentialRampToValueAtTime(0.3, begin + 0.02);
    volume.gain.exponentialRampToValueAtTime(0.0001, begin + 0.2);
    tone.connect(volume).connect(audio.destination);
    tone.start(begin);
    tone.stop(begin + 0.2);
  });
}
