// Control of the run: the token, the buttons, and the answers to questions. The other modules only show.

import { openAlarms, shownAlarm } from "./alarms.js";
import { byId, make, say } from "./dom.js";
import { drawQr } from "./qr.js";
import { panel } from "./stream.js";
import { openDialog, toggleDialog } from "./views.js";
import { FINAL } from "./words.js";

const KEY = "semlive token";
const CAN = {
  start: ["ready"], pause: ["ramping", "settling", "holding", "imaging", "judging", "warming"], resume: ["paused", "fault", "estopped", "recover"],
};
let here = true;

const token = () => sessionStorage.getItem(KEY) ?? "";

/** Remove the token from the address, so that it is neither visible nor copied with it. */
function takeToken() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (!found) return;
  sessionStorage.setItem(KEY, found);
  history.replaceState(null, "", location.pathname);
}

async function ask(body) {
  if (!token() && !(await askToken())) return false;
  const own = token();
  let reply;
  try {
    reply = await fetch("say", {
      method: "POST", headers: { "content-type": "application/json", authorization: `Bearer ${own}` }, body: JSON.stringify(body),
    });
  } catch {
    return answered("the server of the page does not reply; control the run at its terminal", false);
  }
  const { text } = await reply.json().catch(() => ({ text: `refused (${reply.status})` }));
  if (reply.status === 403 && token() === own) sessionStorage.removeItem(KEY);
  return answered(text, reply.ok);
}

function answered(text, ok) {
  const bar = byId("answer");
  bar.hidden = ok;
  say(bar, ok ? "" : text);
  return ok;
}

let settle = () => {};

/** Ask for the token; returns whether there is one. One dialog at a time: an earlier one counts as cancelled. */
function askToken() {
  settle(false);
  // What is typed already stays, if Stop is pressed meanwhile.
  if (!byId("ask-token").open) byId("token-text").value = token();
  openDialog("ask-token");
  byId("token-text").focus();
  return new Promise((resolve) => { settle = resolve; });
}

/** Handle the result of the dialog. Its close event arrives late and may belong to an earlier dialog; it counts only while the dialog is closed. */
function takeAnswers() {
  const dialog = byId("ask-token"), text = byId("token-text");
  dialog.addEventListener("submit", ({ submitter }) => {
    const given = text.value.trim();
    if (submitter?.value === "keep" && given) sessionStorage.setItem(KEY, given);
    if (submitter?.value === "forget") sessionStorage.removeItem(KEY);
    settle(Boolean(token()));
  });
  dialog.addEventListener("close", () => {
    if (dialog.open) return;
    text.value = "";
    settle(Boolean(token()));
  });
}

function drawButtons({ protocol }) {
  if (!protocol) return;
  for (const button of document.querySelectorAll("[data-say]")) {
    const verb = button.dataset.say;
    button.disabled = verb in CAN ? !CAN[verb].includes(protocol.state) : FINAL.includes(protocol.state);
  }
  byId("start").hidden = protocol.state !== "ready";
}

function drawAcknowledge() {
  byId("acknowledge").hidden = !here;
  byId("acknowledge-all").hidden = !here || openAlarms().length < 2;
}

/** Acknowledge alarms one by one; the first that is refused ends it. Alarms of the same instant are acknowledged together. */
async function acknowledge(alarms) {
  for (const identity of new Set(alarms.map((one) => one.identity))) if (!(await ask({ acknowledge: identity }))) return;
}

/** One form for each open question; a form stays the same element while its question is open, so that the text typed is not lost. */
function drawDesk({ desk }) {
  if (!desk) return;
  const bar = byId("desk");
  const open = new Map(desk.questions.map((one) => [one.question, one]));
  for (const form of [...bar.querySelectorAll("form")]) if (!open.has(form.dataset.question)) form.remove();
  for (const one of open.values()) if (![...bar.children].some((form) => form.dataset.question === one.question)) bar.append(question(one));
  let told = byId("told");
  if (!told) bar.prepend((told = make("p", { id: "told" })));
  say(told, desk.told);
  bar.hidden = !open.size && !desk.told;
}

function question({ question: name, text, wanted }) {
  const load = wanted === "load_n";
  const shown = text.replace(/(, then|;) press enter( when it is there)?$/, "").replace(/type the load in N and press enter when it is there$/, "enter the load");
  const id = `answer-${name}`;
  const field = load ? make("input", { id, inputmode: "decimal", required: true, autocomplete: "off" }) : null;
  const form = make("form", { "data-question": name }, make("label", { for: load ? id : null }, shown),
    field, load ? "N" : null, make("button", { class: "main" }, load ? "Enter load" : "Done"));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    await ask({ question: name, answer: field ? field.value : "" });
    if (field) field.select();
  });
  for (const one of form.querySelectorAll("input, button")) one.disabled = !here;
  return form;
}

/** Enable the controls, or hide them if the server is read-only. */
export async function control() {
  takeToken();
  addEventListener("hashchange", takeToken);
  panel(["protocol"], drawButtons);
  panel(["desk"], drawDesk);
  panel(["alarms"], drawAcknowledge);
  byId("acknowledge").addEventListener("click", () => acknowledge([shownAlarm()].filter(Boolean)));
  byId("acknowledge-all").addEventListener("click", () => acknowledge(openAlarms()));
  for (const button of document.querySelectorAll("[data-say]")) {
    button.addEventListener("click", () => (button.dataset.say === "abort" ? openDialog("ask-abort") : ask({ say: button.dataset.say })));
  }
  // Its submit, not the dialog's close: that comes later, and after a quick "Continue" and "Abort…" it would answer the second question.
  byId("ask-abort").addEventListener("submit", ({ submitter }) => submitter?.value === "yes" && ask({ say: "abort" }));
  byId("token").addEventListener("click", askToken);
  byId("phone").addEventListener("click", () => { toggleDialog("qr-box"); drawQr(token()); });
  takeAnswers();
  here = await fetch("about").then((reply) => reply.json()).then((told) => told.controls).catch(() => true);
  byId("controls").hidden = !here;
  drawAcknowledge();
  for (const one of byId("desk").querySelectorAll("input, button")) one.disabled = !here;
}
