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

/** Set text only where it changed, so that screen readers say only news. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A custom property of the style sheet, as it is in light or dark now. */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** Call once when light becomes dark or back. */
export const onColours = (call) => matchMedia("(prefers-color-scheme: dark)").addEventListener("change", call);
