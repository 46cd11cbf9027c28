// Pictures: the newest frame with its grid of points, and maps with colour bar and inspection.

import { byId, make, say } from "./dom.js";
import { panel } from "./stream.js";
import { FIELDS, number, plain, scaleOf } from "./words.js";

// Viridis, every sixteenth colour; between them it is straight enough to the eye.
const VIRIDIS = ["440154", "481a6c", "472f7d", "414487", "39568c", "31688e", "2a788e", "23888e", "1f988b", "22a884", "35b779", "54c568", "7ad151", "a5db36", "d2e21b", "fde725"]
  .map((hex) => [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16)));

function ramp(part) {
  const at = Math.min(0.99999, Math.max(0, part)) * (VIRIDIS.length - 1);
  const low = Math.floor(at);
  return VIRIDIS[low].map((value, i) => value + (at - low) * (VIRIDIS[low + 1][i] - value));
}

let grid = null;
let maps = null;

export function pictures() {
  newestFrame();
  mapPanel();
}

function newestFrame() {
  const canvas = byId("frame");
  let shown = null;
  let busy = false;
  let image = null;
  let size = [1, 1];
  let told = null;
  let thinned = 1;

  function draw() {
    if (!image) return;
    canvas.hidden = !(byId("frame-none").hidden = true);
    [canvas.width, canvas.height] = [image.width, image.height];
    const pen = canvas.getContext("2d");
    pen.drawImage(image, 0, 0);
    if (!grid) return;
    const [x0, y0, step, nx, ny, subset] = grid, scale = image.width / size[0];
    // Of the page's own pixels: dots of three, twelve apart, bright in a dark frame; thinner ones are lost in the speckle.
    const fine = image.width / (canvas.clientWidth || 400), every = Math.max(1, Math.ceil((12 * fine) / (step * scale)));
    for (const [edge, fill] of [[5 * fine, "#0009"], [3 * fine, "#ffd60a"]]) {
      pen.fillStyle = fill;
      for (let j = 0; j < ny; j += every) for (let i = 0; i < nx; i += every) pen.fillRect((x0 + i * step) * scale - edge / 2, (y0 + j * step) * scale - edge / 2, edge, edge);
    }
    thinned = every;
    pen.strokeStyle = "#ffd60a";
    pen.lineWidth = 1.5 * fine;
    pen.strokeRect((x0 - subset / 2) * scale, (y0 - subset / 2) * scale, ((nx - 1) * step + subset) * scale, ((ny - 1) * step + subset) * scale);
  }

  function about(name) {
    const where = grid ? `, grid of ${grid[3]} × ${grid[4]} points${thinned > 1 ? `, one in ${thinned} drawn` : ""}, subset ${grid[5]} px` : "";
    say(byId("frame-now"), `${name}, ${size[0]} × ${size[1]} px${where}`);
    canvas.setAttribute("aria-label", `Newest frame, ${byId("frame-now").textContent}`);
  }

  async function fetchNewest() {
    if (busy || document.hidden || told?.newest === null || told?.newest === shown) return;
    busy = true;
    const export_ = told.newest, name = told.name;
    try {
      const reply = await fetch(`frame/${export_}.png`);
      if (reply.ok) {
        size = reply.headers.get("x-frame-size").split(" ").map(Number);
        const next = await createImageBitmap(await reply.blob());
        image?.close();
        image = next;
        draw();
        shown = export_;
        about(name);
      } else if (reply.status === 422) {
        say(byId("frame-now"), (await reply.text()) || `${name} cannot be shown`);
        shown = export_;
      }
    } catch { /* the connection is broken; the next news comes when it is back */ }
    busy = false;
    if (told.newest !== export_) fetchNewest();
  }

  panel(["frames"], ({ frames }) => { told = frames; fetchNewest(); });
  panel(["maps"], ({ maps: now }) => { grid = now.grid; draw(); if (image && told?.newest === shown) about(told.name); });
  document.addEventListener("visibilitychange", fetchNewest);
}

function mapPanel() {
  const canvas = byId("map"), slider = byId("map-frame"), select = byId("map-field");
  let newest = true;
  let wanted = "eyy";
  let values = null, frameOf = 0, fieldOf = "";
  let point = null;
  let range = [0, 1];
  let key = "";

  const field = () => select.value;
  const frame = () => maps?.frames[Number(slider.value)];

  async function show() {
    const one = frame(), name = field();
    if (!one) return;
    const there = one.fields.includes(name);
    say(byId("map-which"), `${one.frame}: ${one.phase}${one.load_n === null ? "" : ` ${plain(one.load_n)} N`}${there ? "" : ", without this map"}`);
    slider.setAttribute("aria-valuetext", byId("map-which").textContent);
    const asked = `${one.frame}/${name}?v=${one.version}`;
    if (!there || asked === key) return;
    key = asked;
    const reply = await fetch(`field/${asked}`).catch(() => null);
    const fetched = reply?.ok ? await reply.arrayBuffer().catch(() => null) : null;
    if (asked !== key) return;
    if (fetched === null) { key = ""; return; }
    [values, frameOf, fieldOf] = [new Float32Array(fetched), one.frame, name];
    draw();
  }

  function draw() {
    if (!values || !maps.grid) return;
    const [, , , nx, ny] = maps.grid, scale = scaleOf(fieldOf);
    if (values.length !== nx * ny) return;
    const sorted = Float32Array.from(values.filter((v) => !Number.isNaN(v))).sort();
    // One point in a hundred at each end may be an outlier; it must not take the colours of all others.
    range = sorted.length ? [sorted[Math.floor(0.01 * sorted.length)], sorted[Math.floor(0.99 * (sorted.length - 1))]] : [0, 1];
    if (range[0] === range[1]) range = [range[0] - 1e-9, range[1] + 1e-9];
    [canvas.width, canvas.height] = [nx, ny];
    const pen = canvas.getContext("2d"), picture = pen.createImageData(nx, ny);
    values.forEach((value, at) => {
      if (!Number.isNaN(value)) picture.data.set([...ramp((value - range[0]) / (range[1] - range[0])), 255], 4 * at);
    });
    pen.putImageData(picture, 0, 0);
    if (point) mark(pen);
    bar(scale);
    inspect();
  }

  function bar(scale) {
    const strip = byId("bar"), pen = strip.getContext("2d");
    [strip.width, strip.height] = [1, 128];
    for (let y = 0; y < 128; y++) { pen.fillStyle = `rgb(${ramp(1 - y / 127).join()})`; pen.fillRect(0, y, 1, 1); }
    const unit = FIELDS[fieldOf][1];
    const labels = [1, 0.5, 0].map((part) => make("span", {}, `${number(scale * (range[0] + part * (range[1] - range[0])))} ${unit}`));
    byId("bar-labels").replaceChildren(...labels);
    strip.setAttribute("aria-label", `Colours from ${labels[2].textContent} to ${labels[0].textContent}`);
  }

  function mark(pen) {
    pen.fillStyle = "#fff";
    for (const [dx, dy] of [[-2, 0], [2, 0], [0, -2], [0, 2]]) pen.fillRect(point[0] + dx, point[1] + dy, 1, 1);
  }

  function inspect() {
    const [x0, y0, step, nx] = maps.grid, [name, unit] = FIELDS[fieldOf], scale = scaleOf(fieldOf);
    const valid = values.filter((v) => !Number.isNaN(v));
    const mean = valid.reduce((sum, v) => sum + v, 0) / Math.max(1, valid.length);
    let text = `${name}, frame ${frameOf}: mean ${number(scale * mean)} ${unit}; ${valid.length} of ${values.length} points valid`;
    if (point) {
      const value = values[point[1] * nx + point[0]];
      text = `at (${x0 + step * point[0]}, ${y0 + step * point[1]}) px: ${Number.isNaN(value) ? "not valid" : `${number(scale * value, 4)} ${unit}`}; mean ${number(scale * mean)} ${unit}`;
    }
    say(byId("map-now"), text);
    canvas.setAttribute("aria-label", `Map: ${text}`);
  }

  function choose(x, y) {
    if (!maps?.grid || !values) return;
    const [, , , nx, ny] = maps.grid;
    point = x === null ? null : [Math.min(nx - 1, Math.max(0, x)), Math.min(ny - 1, Math.max(0, y))];
    draw();
  }

  canvas.addEventListener("pointerdown", at);
  canvas.addEventListener("pointermove", (event) => (event.pointerType === "mouse" || event.buttons) && at(event));
  function at(event) {
    const box = canvas.getBoundingClientRect(), shown = Math.min(box.width / canvas.width, box.height / canvas.height);
    choose(Math.floor((event.clientX - box.left) / shown), Math.floor((event.clientY - box.top) / shown));
  }
  canvas.addEventListener("pointerleave", () => choose(null, null));
  canvas.addEventListener("keydown", (event) => {
    const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (event.key === "Escape") choose(null, null);
    if (!move || !maps?.grid) return;
    event.preventDefault();
    const from = point ?? [Math.floor(maps.grid[3] / 2), Math.floor(maps.grid[4] / 2)];
    choose(from[0] + move[0], from[1] + move[1]);
  });
  slider.addEventListener("input", () => { newest = Number(slider.value) === Number(slider.max); show(); });
  select.addEventListener("change", () => { wanted = field(); show(); });

  panel(["maps"], ({ maps: now }) => {
    maps = now;
    const known = Object.keys(FIELDS).filter((name) => now.frames.some((one) => one.fields.includes(name)));
    if ([...select.options].map((one) => one.value).join() !== known.join()) {
      select.replaceChildren(...known.map((name) => make("option", { value: name, selected: name === wanted }, FIELDS[name][0])));
    }
    byId("map-box").hidden = byId("map-row").hidden = !(byId("map-none").hidden = now.frames.length > 0);
    slider.max = String(Math.max(0, now.frames.length - 1));
    if (newest) slider.value = slider.max;
    show();
  });
}
