// PNG and CSV of what is shown.

import { colour, make } from "./dom.js";

let runName = "semlive";

/** Name of the run, with which files are named. */
export function nameFiles(name) {
  runName = name.replace(/[^\w.-]+/g, "_");
}

function download(blob, what, ending) {
  const link = make("a", { download: `${runName}_${what}.${ending}`, href: URL.createObjectURL(blob) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

const cell = (value) => {
  if (value === null || value === undefined || Number.isNaN(value)) return "";
  const text = String(value);
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

/** Rows as CSV with a line of names; numbers have a decimal point, missing values are empty. */
export const csvText = (names, rows) => [names, ...rows].map((row) => row.map(cell).join(",")).join("\n") + "\n";

/** A picture of a canvas with a title above and lines of text below it, in the colours of the page. */
export function picture(canvas, title, lines, right = null) {
  const unit = Math.max(1, devicePixelRatio), pad = 10 * unit, text = 14 * unit;
  const out = make("canvas"), extra = right ? right.width + pad : 0;
  out.width = Math.max(canvas.width + extra, 420 * unit) + 2 * pad;
  out.height = canvas.height + (lines.length + 1) * 1.45 * text + 3 * pad;
  const pen = out.getContext("2d");
  pen.fillStyle = colour("panel");
  pen.fillRect(0, 0, out.width, out.height);
  pen.fillStyle = colour("ink");
  pen.font = `600 ${text}px system-ui, sans-serif`;
  pen.fillText(title, pad, pad + text);
  pen.drawImage(canvas, pad, 2 * pad + text);
  if (right) pen.drawImage(right, 2 * pad + canvas.width, 2 * pad + text);
  pen.fillStyle = colour("soft");
  pen.font = `${0.9 * text}px system-ui, sans-serif`;
  lines.forEach((line, at) => pen.fillText(line, pad, 2 * pad + text + canvas.height + (at + 1.2) * 1.35 * text, out.width - 2 * pad));
  return out;
}

/** Buttons beside the title of a panel: `csv()` returns [names, rows], `png()` a canvas; either may be null. */
export function saves(panel, what, { csv = null, png = null }) {
  const title = panel.querySelector("h2"), buttons = make("span", { class: "saves" });
  const row = make("div", { class: "title" });
  title.replaceWith(row);
  row.append(title, buttons);
  const button = (name, act) => {
    const one = make("button", { type: "button", "aria-label": `${title.textContent} as ${name}`, title: `Save as ${name}` }, name);
    one.addEventListener("click", act);
    buttons.append(one);
  };
  if (png) button("PNG", () => png()?.toBlob((blob) => download(blob, what, "png"), "image/png"));
  if (csv) button("CSV", () => download(new Blob([csvText(...csv())], { type: "text/csv" }), what, "csv"));
}
