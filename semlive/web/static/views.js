// The three views, light and dark, and keys.

import { byId, isDark, onColours, recall, remember, say, toggleTheme } from "./dom.js";

const VIEW = "semlive view", KEYS = "semlive keys";
const VIEWS = ["steer", "see", "check"];

/** Show one of the views; the choice lasts for this tab. */
export function show(view) {
  document.body.dataset.view = view;
  try {
    sessionStorage.setItem(VIEW, view);
  } catch { /* a view that is not stored is shown all the same */ }
  for (const button of document.querySelectorAll("nav [data-view]")) button.setAttribute("aria-pressed", String(button.dataset.view === view));
}

const actions = new Map();

/** Do something at a key, outside of text fields. */
export const onKey = (key, act) => actions.set(key, act);

const dialogs = () => document.querySelectorAll("dialog[open]");

/** Open a dialog and close the others. No dialog is modal: the rest of the page stays usable, above all Stop. */
export function openDialog(id) {
  for (const other of dialogs()) if (other.id !== id) other.close();
  byId(id).show();
}

/** Open or close a dialog. */
export function toggleDialog(id) {
  if (byId(id).open) byId(id).close();
  else openDialog(id);
}

function pressed(event) {
  const typing = event.target.closest?.("input:not([type=range]):not([type=checkbox]), select, textarea, dialog");
  if (typing || event.ctrlKey || event.metaKey || event.altKey || !byId("keys-on").checked) return;
  const act = actions.get(event.key);
  if (!act) return;
  event.preventDefault();
  act();
}

export function views() {
  for (const button of document.querySelectorAll("nav [data-view]")) button.addEventListener("click", () => show(button.dataset.view));
  VIEWS.forEach((view, at) => onKey(String(at + 1), () => show(view)));
  let stored = null;
  try {
    stored = sessionStorage.getItem(VIEW);
  } catch { /* the first view */ }
  show(VIEWS.includes(stored) ? stored : "steer");

  const name = () => say(byId("theme"), isDark() ? "light" : "dark");
  byId("theme").addEventListener("click", toggleTheme);
  onKey("d", toggleTheme);
  onColours(name);
  name();

  byId("help").addEventListener("click", () => toggleDialog("keys"));
  onKey("?", () => toggleDialog("keys"));
  addEventListener("keydown", (event) => event.key === "Escape" && dialogs().forEach((dialog) => dialog.close()));
  byId("keys-on").checked = recall(KEYS, "on") === "on";
  byId("keys-on").addEventListener("change", () => remember(KEYS, byId("keys-on").checked ? "on" : "off"));
  addEventListener("keydown", pressed);
}
