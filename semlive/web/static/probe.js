// Measuring on a map: value at a point, profile along a line, statistics of a region; by pointer or by keys.

import { chart } from "./chart.js";
import { byId, say } from "./dom.js";
import { FIELDS } from "./fields.js";
import { inside, profile, statistics } from "./regions.js";
import { measured, number, plain } from "./words.js";

/**
 * Measure on a canvas. `context()` gives {values, sigma, name, entry, grid, pixelUm, view, picture} or null; `changed()` draws again.
 * Ends are points of the grid [column, row].
 */
export function probe(canvas, { changed, context }) {
  let tool = "point", dragging = false, saved = {};
  const ends = { point: [null, null], line: [null, null], region: [null, null] };
  const axes = { x: "distance px", y: "value", span: 1 };
  const plot = chart(byId("profile"), { series: [{ label: "along the line ± 1σ", colour: "a", band: true, format: (value) => number(value, 4) }], axes,
    instead: () => (tool === "line" ? null : { csv: () => [["quantity", "value"], Object.entries(saved)], png: () => context()?.picture() ?? null }) });

  const set = (from, to) => { ends[tool] = [from, to]; changed(); update(); };

  /** Point of the grid under a pointer. */
  function under(event) {
    const now = context();
    if (!now) return null;
    const box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width, [x0, y0, step, nx, ny] = now.grid;
    const place = [(event.clientX - box.left) * ratio - now.view.left, (event.clientY - box.top) * ratio - now.view.top].map((v) => v / now.view.scale - 0.5);
    const point = [Math.round((place[0] - x0) / step), Math.round((place[1] - y0) / step)];
    return [Math.min(nx - 1, Math.max(0, point[0])), Math.min(ny - 1, Math.max(0, point[1]))];
  }

  canvas.addEventListener("pointerdown", (event) => {
    const at = under(event);
    if (!at) return;
    dragging = true;
    canvas.setPointerCapture(event.pointerId);
    set(at, tool === "point" ? null : at);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (tool === "point" ? event.pointerType !== "mouse" && !dragging : !dragging) return;
    const at = under(event);
    if (at) set(tool === "point" ? at : ends[tool][0], tool === "point" ? null : at);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { dragging = false; });
  canvas.addEventListener("pointerleave", () => { if (tool === "point" && !dragging) set(null, null); });
  canvas.addEventListener("keydown", (event) => {
    const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key], now = context();
    if (event.key === "Escape") set(null, null);
    if (!move || !now) return;
    event.preventDefault();
    const [, , , nx, ny] = now.grid, centre = [Math.floor(nx / 2), Math.floor(ny / 2)];
    const moved = (end) => [Math.min(nx - 1, Math.max(0, end[0] + move[0])), Math.min(ny - 1, Math.max(0, end[1] + move[1]))];
    const [from, to] = ends[tool];
    if (tool === "point") set(moved(from ?? centre), null);
    else if (event.shiftKey) set(from ?? [0, centre[1]], moved(to ?? [nx - 1, centre[1]]));
    else set(moved(from ?? [0, centre[1]]), to ?? [nx - 1, centre[1]]);
  });
  for (const button of document.querySelectorAll("[data-tool]")) {
    button.addEventListener("click", () => {
      tool = button.dataset.tool;
      // A finger on the map scrolls the page, unless it draws a line or a region.
      canvas.style.touchAction = tool === "point" ? "pan-y" : "none";
      for (const each of document.querySelectorAll("[data-tool]")) each.setAttribute("aria-pressed", String(each === button));
      changed();
      update();
    });
  }

  const places = ({ grid: [x0, y0, step] }, [x, y]) => [x0 + step * x, y0 + step * y];

  /** A value with its uncertainty in the unit shown, and on the specimen. */
  function valueText({ name, pixelUm }, value, sigma) {
    const { unit, scale } = FIELDS[name];
    if (!Number.isFinite(value)) return "not valid";
    const shown = `${sigma ? measured(scale * value, scale * sigma) : number(scale * value, 4)}${unit ? ` ${unit}` : ""}`;
    return unit === "px" && pixelUm ? `${shown} (${number(value * pixelUm)} µm)` : shown;
  }

  /** Write the readings of the present map. */
  function update() {
    const now = context();
    byId("profile").hidden = tool !== "line" || !now;
    if (!now) return;
    const { values, sigma, name, entry, grid } = now, { label, unit, scale } = FIELDS[name], [, , , nx] = grid;
    const suffix = unit ? ` ${unit}` : "", all = statistics(values), mean = all ? `mean ${number(scale * all.mean)}${suffix}` : "no valid point";
    const [from, to] = ends[tool];
    const at = tool === "point" && from ? from[1] * nx + from[0] : null;
    say(byId("map-now"), at === null ? `${label}, frame ${entry.frame}: ${mean}; ${all?.points ?? 0} of ${values.length} points valid`
      : `at (${places(now, from).join(", ")}) px: ${valueText(now, values[at], sigma(at))}; ${mean}`);
    if (tool === "line") line(now, from, to);
    else region(now, tool === "region" ? from : null, to, all);
  }

  /** Statistics of the region, or of all points. */
  function region(now, from, to, all) {
    const { values, sigma, name, grid } = now, { scale, unit } = FIELDS[name], suffix = unit ? ` ${unit}` : "";
    const indices = from && to ? inside(from, to, grid[3]) : null;
    const found = indices ? statistics(indices.map((i) => values[i])) : all;
    const one = sigma(indices ? indices[indices.length >> 1] : values.length >> 1);
    const scaled = Object.entries(found ?? {}).map(([key, value]) => [key, key === "points" ? value : scale * value]);
    saved = { map: name, frame: now.entry.frame, unit, ...(indices ? { x0_px: places(now, from)[0], y0_px: places(now, from)[1], x1_px: places(now, to)[0], y1_px: places(now, to)[1] } : {}), ...Object.fromEntries(scaled) };
    const where = indices ? `(${places(now, from).join(", ")}) to (${places(now, to).join(", ")}) px` : "all points";
    const hint = tool === "region" && !indices ? " Drag a rectangle on the image." : tool === "point" ? " Point at the image." : "";
    say(byId("region-now"), found ? `${where}: ${found.points} valid, mean ${number(scale * found.mean, 4)}, median ${number(scale * found.median, 4)}, standard deviation ${number(scale * found.sd)}, `
      + `${number(scale * found.low)} to ${number(scale * found.high)}${suffix}${one ? `; σ of one point ${number(scale * one, 2)}${suffix}` : ""}.${hint}` : `${where}: no valid point.${hint}`);
  }

  function line(now, from, to) {
    if (!from || !to) { say(byId("region-now"), "Drag a line on the image."); return plot.show([[], [], [], []], "no line"); }
    const { values, sigma, name, grid, pixelUm } = now, { label, scale, unit } = FIELDS[name], [, , step, nx, ny] = grid;
    const rows = profile(values, nx, ny, from, to), per = step * (pixelUm ?? 1);
    axes.x = pixelUm ? "distance µm" : "distance px";
    axes.y = unit || "ZNCC";
    const value = rows.map(([, v]) => (Number.isFinite(v) ? scale * v : null)), around = (sign) => rows.map(([, v, i]) => (Number.isFinite(v) ? scale * (v + sign * (sigma(i) ?? 0)) : null));
    const text = `${label} from (${places(now, from).join(", ")}) to (${places(now, to).join(", ")}) px, ${plain(Number((rows.at(-1)[0] * per).toPrecision(4)))} ${pixelUm ? "µm" : "px"} long`;
    say(byId("region-now"), text);
    plot.show([rows.map(([distance]) => distance * per), around(-1), around(1), value], text);
  }

  return { tool: () => tool, ends: () => ends[tool], update };
}
