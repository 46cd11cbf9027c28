// The few things that every panel needs of a document.

export const byId = (id) => document.getElementById(id);

/** Make an element; text is never read as markup. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Set text only where it changed, so that screen readers report changes only. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A custom property of the style sheet, as it is in light or dark now. */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

const THEME = "semlive theme";
const dark = matchMedia("(prefers-color-scheme: dark)");
const listeners = [];

/** Call after each change between light and dark. */
export const onColours = (call) => listeners.push(call);

const coloursChanged = () => listeners.forEach((call) => call());
dark.addEventListener("change", coloursChanged);

/** Whether the page is dark now. */
export const isDark = () => (document.documentElement.dataset.theme ?? (dark.matches ? "dark" : "light")) === "dark";

/** Change between light and dark; the choice is stored in this browser. */
export function toggleTheme() {
  document.documentElement.dataset.theme = isDark() ? "light" : "dark";
  remember(THEME, document.documentElement.dataset.theme);
  coloursChanged();
}

/** Stored settings of this browser; a browser that stores nothing still shows everything. */
export function recall(key, otherwise) {
  try {
    return localStorage.getItem(key) ?? otherwise;
  } catch {
    return otherwise;
  }
}

export function remember(key, value) {
  try {
    localStorage.setItem(key, value);
  } catch { /* private windows may refuse */ }
}

const stored = recall(THEME, "");
if (stored) document.documentElement.dataset.theme = stored;
