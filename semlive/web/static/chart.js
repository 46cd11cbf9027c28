// uPlot in the page's colours, as large as its panel, with a key, and as PNG or CSV.

import { colour, make, onColours } from "./dom.js";
import { picture, saves } from "./save.js";

/** Numbers of an axis with as many places as tell neighbours apart; very small and large ones with a power of ten. */
export function ticks(_, splits) {
  const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
  const largest = Math.max(...splits.map((value) => Math.abs(value ?? 0)));
  if (largest >= 1e6 || largest < 1e-3) {
    const digits = Math.min(8, Math.max(1, Math.ceil(Math.log10(largest / step))));
    return splits.map((value) => (value === null ? "" : value === 0 ? "0" : value.toExponential(digits).replaceAll("-", "−")));
  }
  let places = Math.min(9, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  // Of the steps of uPlot (1, 2, 2.5 and 5 times a power of ten) 2.5 has one place more; without it 2.5 was shown as 3.
  if (places < 9 && Math.abs(step * 10 ** places - Math.round(step * 10 ** places)) > 0.01) places += 1;
  return splits.map((value) => (value === null ? "" : value.toFixed(places).replace("-", "−")));
}

/** A range with some room, never so narrow that noise or rounding fills it; `lift` moves the curves up or down by a part of the range, so that those of two axes do not hide each other. */
export const atLeast = (span, room, lift = 0) => (_, low, high) => {
  if (low === null || high === null || !Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  const middle = (low + high) / 2, half = Math.max(room * (high - low), span ?? 0, high === low ? Math.max(0.1 * Math.abs(middle), 1e-3) : 1e-6 * Math.abs(middle)) / 2;
  return [middle - half * (1 + Math.max(0, lift)), middle + half * (1 - Math.min(0, lift))];
};

/**
 * A chart in an element.
 * `series`: {label, colour, side, dash, width, points, dots, gaps, span, band, format}; `span`: its axis shows at least that much; `most`: its axis has no label above it; a band is two further columns, lower and upper, behind the line.
 * `axes`: {x, y, side?, span?} labels; `whole`: x counts. `limits` gives horizontal lines: {at, text, scale?}; `errors` gives bars along x: [y, low, high].
 * `instead()` gives {csv, png} to save while the chart is hidden.
 * A series without any value is neither drawn nor in the key, nor has it an axis.
 */
export function chart(element, { series, axes, x = null, limits = () => [], errors = () => [], instead = () => null }) {
  let plot = null, data = null, zoomed = false, built = "";
  const box = make("div", { class: "plotbox" }), host = make("div", { class: "plot" }), key = make("p", { class: "key" });
  const nothing = make("p", { class: "nothing" }, "nothing yet");
  box.append(host, nothing);
  element.append(box, key);

  const columnOf = [];
  let count = 1;
  for (const one of series) columnOf.push((count += one.band ? 3 : 1) - 1);
  const present = () => series.map((_, at) => data[columnOf[at]].some((value) => value !== null && value !== undefined && !Number.isNaN(value)));

  const signature = (there) => [...there, axes.x, axes.y].join();

  function build(there) {
    plot?.destroy();
    zoomed = false;
    built = signature(there);
    const ink = colour("soft"), grid = { stroke: colour("grid"), width: 1 };
    const axis = (label, more = {}) => ({ label, stroke: ink, grid, ticks: { ...grid, size: 4 }, labelSize: 16, labelGap: 0, gap: 3, size: 46, space: 34, values: ticks, font: "11px system-ui", labelFont: "11px system-ui", ...more });
    const lines = [{ label: axes.x, value: x ?? ((_, v) => (v === null ? "–" : v.toFixed(1))) }];
    const bands = [], spans = {}, most = {};
    series.forEach((one, at) => {
      const scale = one.side ? "side" : "y", show = there[at];
      if (one.band) {
        const hidden = { stroke: "transparent", scale, show, points: { show: false } };
        lines.push({ ...hidden, label: `${one.label} −` }, { ...hidden, label: `${one.label} +` });
        if (show) bands.push({ series: [lines.length - 1, lines.length - 2], fill: colour(`band-${one.colour}`) });
      }
      lines.push({ label: one.label, show, stroke: colour(one.colour), width: one.points ? 0 : one.width ?? 1.8, dash: one.dash, scale, spanGaps: Boolean(one.gaps),
        points: { show: Boolean(one.points || one.dots), size: one.points ? 7 : 5, fill: colour(one.colour), stroke: colour(one.colour) }, ...(one.points ? { paths: () => null } : {}) });
      if (one.span) spans[scale] = one.span;
      if (one.most) most[scale] = one.most;
    });
    const two = Boolean(axes.side) && series.some((one, at) => one.side && there[at]), lift = two ? 0.35 : 0;
    const sides = two ? [axis(axes.side, { scale: "side", side: 1, size: 50, grid: { show: false }, filter: (_, splits) => splits.map((value) => (value > (most.side ?? Infinity) + 1e-9 ? null : value)) })] : [];
    plot = new uPlot({
      width: host.clientWidth, height: host.clientHeight, series: lines, bands, padding: [6, sides.length ? 0 : 10, 0, 0],
      axes: [axis(axes.x, { size: 22, space: 50, labelSize: 15, ...(axes.whole ? { incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000] } : {}) }), axis(axes.y), ...sides],
      scales: { x: { time: false, range: atLeast(axes.span, 1) }, y: { range: atLeast(spans.y, 1.1, -lift) }, side: { range: atLeast(spans.side, 1.1, lift) } }, legend: { show: false }, cursor: { drag: { x: true, y: false } },
      hooks: { setSelect: [(u) => { zoomed = u.select.width > 0; }], draw: [(u) => drawLimits(u, limits()), (u) => drawErrors(u, errors()), (u) => drawSpreads(u, series.flatMap((one, at) => (one.dots && one.band && there[at] ? [[one, columnOf[at]]] : [])))], setCursor: [(u) => readOut(u.cursor.idx, there)] },
    }, data, host);
    readOut(null, there);
  }

  /** The key, with the values under the cursor. */
  function readOut(idx, there) {
    const at = idx === null || idx === undefined || !data ? null : idx;
    const entries = series.map((one, i) => {
      if (!there[i]) return null;
      const value = at === null ? null : data[columnOf[i]][at];
      return make("span", { class: `${one.colour}${one.dash ? " dash" : ""}${one.points ? " dot" : ""}` }, make("i"), one.label, value === null || value === undefined ? null : make("b", {}, ` ${one.format(value)}`));
    });
    if (at !== null) entries.unshift(make("span", {}, `${axes.x} `, make("b", {}, axes.whole ? String(data[0][at]) : data[0][at].toFixed(2))));
    key.replaceChildren(...entries.filter(Boolean));
  }

  function draw() {
    if (!data || host.clientWidth < 60 || host.clientHeight < 40 || nothing.hidden === false) return;
    const there = present();
    if (plot === null || signature(there) !== built) return build(there);
    plot.setData(data, !zoomed);
    if (zoomed) plot.redraw();
  }

  new ResizeObserver(() => {
    if (plot && host.clientWidth >= 60 && host.clientHeight >= 40) plot.setSize({ width: host.clientWidth, height: host.clientHeight });
    else draw();
  }).observe(host);
  onColours(() => plot && build(present()));
  element.addEventListener("dblclick", () => { zoomed = false; });

  const panel = element.closest(".panel");
  const names = () => [axes.x, ...series.flatMap((one) => (one.band ? [`${one.label} lower`, `${one.label} upper`, one.label] : [one.label]))];
  saves(panel, element.id, {
    csv: () => instead()?.csv() ?? [names(), data ? Array.from(data[0], (_, row) => data.map((column) => column[row])) : []],
    png: () => instead()?.png() ?? (plot && picture(plot.ctx.canvas, panel.querySelector("h2").textContent, [series.filter((_, at) => present()[at]).map((one) => one.label).join("   "), element.getAttribute("aria-label") ?? ""])),
  });
  return {
    /** Columns: x, then for each series its band's lower and upper, if it has one, and itself. */
    show(columns, words) {
      data = columns;
      nothing.hidden = columns[0].length > 0;
      host.hidden = key.hidden = !nothing.hidden;
      draw();
      element.setAttribute("role", "img");
      element.setAttribute("aria-label", words);
    },
  };
}

/** Horizontal lines with a word each, only where the scale reaches them. */
function drawLimits(u, limits) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour("limit");
  ctx.setLineDash([6, 4]);
  ctx.font = `${11 * devicePixelRatio}px system-ui`;
  for (const { at, text, scale = "y" } of limits) {
    const { min, max } = u.scales[scale] ?? {};
    if (min === undefined || min === null || at === undefined || at < min || at > max) continue;
    const y = u.valToPos(at, scale, true);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
    ctx.textAlign = scale === "y" ? "left" : "right";
    const x = scale === "y" ? bbox.left + 4 * devicePixelRatio : bbox.left + bbox.width - 4 * devicePixelRatio;
    // The chart leaves another baseline behind; a label at the upper edge is below its line.
    const above = y - 15 * devicePixelRatio > bbox.top;
    ctx.textBaseline = above ? "bottom" : "top";
    ctx.fillText(text, x, y + (above ? -2 : 3) * devicePixelRatio);
  }
  ctx.restore();
}

/** Bars from the lower to the upper end of a band at each dot. */
function drawSpreads(u, drawn) {
  const { ctx, data } = u;
  ctx.save();
  for (const [one, column] of drawn) {
    ctx.strokeStyle = colour(one.colour);
    ctx.lineWidth = 1.2 * devicePixelRatio;
    ctx.beginPath();
    data[0].forEach((x, at) => {
      if (data[column][at] === null) return;
      const scale = one.side ? "side" : "y", left = u.valToPos(x, "x", true) + (one.side ? 4 * devicePixelRatio : 0);
      ctx.moveTo(left, u.valToPos(data[column - 2][at], scale, true));
      ctx.lineTo(left, u.valToPos(data[column - 1][at], scale, true));
    });
    ctx.stroke();
  }
  ctx.restore();
}

/** Bars along x, in the first line's colour. */
function drawErrors(u, errors) {
  const { left, top, width, height } = u.bbox;
  u.ctx.save();
  u.ctx.beginPath();
  u.ctx.rect(left, top, width, height);
  u.ctx.clip();
  u.ctx.strokeStyle = colour("a");
  u.ctx.beginPath();
  for (const [y, low, high] of errors) {
    u.ctx.moveTo(u.valToPos(low, "x", true), u.valToPos(y, "y", true));
    u.ctx.lineTo(u.valToPos(high, "x", true), u.valToPos(y, "y", true));
  }
  u.ctx.stroke();
  u.ctx.restore();
}
