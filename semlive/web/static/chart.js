// uPlot in the page's colours, as wide as its panel.

import { colour, make, onColours } from "./dom.js";

const HEIGHT = 215;

/** Numbers of an axis with as many places as tell neighbours apart. */
function ticks(_, splits) {
  const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
  const places = Math.min(8, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  return splits.map((value) => (value === null ? "" : value.toFixed(places).replace("-", "−")));
}

/**
 * A chart in an element.
 * `series`: {label, colour, side, dash, width, points, dots, gaps, span, band}; `span`: its axis shows at least that much; a band is two further columns, lower and upper, behind the line.
 * `axes`: {x, y, side?} labels; `whole`: x counts. `limits` gives horizontal lines: {at, text, scale?}; `errors` gives bars along x: [y, low, high].
 */
export function chart(element, { series, axes, x = null, limits = () => [], errors = () => [] }) {
  let plot = null;
  let data = null, zoomed = false;
  const nothing = make("p", { class: "nothing" }, "nothing yet");
  element.append(nothing);

  function build() {
    plot?.destroy();
    zoomed = false;
    const ink = colour("soft"), grid = { stroke: colour("grid"), width: 1 };
    const axis = (label, more = {}) => ({ label, stroke: ink, grid, ticks: grid, labelSize: 18, size: 58, values: ticks, font: "12px system-ui", labelFont: "12px system-ui", ...more });
    const lines = [{ label: axes.x, value: x ?? ((_, v) => (v === null ? "–" : v.toFixed(1))) }];
    const bands = [], spans = {};
    for (const one of series) {
      const scale = one.side ? "side" : "y";
      if (one.band) {
        const hidden = { stroke: "transparent", scale, class: "u-band", points: { show: false } };
        lines.push({ ...hidden, label: `${one.label} −` }, { ...hidden, label: `${one.label} +` });
        bands.push({ series: [lines.length - 1, lines.length - 2], fill: colour(`band-${one.colour}`) });
      }
      lines.push({ label: one.label, stroke: colour(one.colour), width: one.points ? 0 : one.width ?? 1.6, dash: one.dash, scale, spanGaps: Boolean(one.gaps),
        points: { show: Boolean(one.points || one.dots), size: one.points ? 6 : 5, fill: colour(one.colour), stroke: colour(one.colour) }, value: (_, v) => (v === null || v === undefined ? "–" : one.format(v)),
        ...(one.points ? { paths: () => null } : {}) });
      if (one.span) spans[scale] = one.span;
    }
    const sides = axes.side ? [axis(axes.side, { scale: "side", side: 1, size: 66, grid: { show: false } })] : [];
    plot = new uPlot({
      width: Math.max(200, element.clientWidth), height: HEIGHT, series: lines, bands,
      axes: [axis(axes.x, { size: 30, ...(axes.whole ? { incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000] } : {}) }), axis(axes.y), ...sides],
      scales: { x: { time: false }, y: { range: atLeast(spans.y) }, side: { range: atLeast(spans.side) } }, legend: { live: true }, cursor: { drag: { x: true, y: false } },
      hooks: { setSelect: [(u) => { zoomed = u.select.width > 0; }], draw: [(u) => drawLimits(u, limits()), (u) => drawErrors(u, errors())] },
    }, data, element);
  }

  new ResizeObserver(() => plot && plot.setSize({ width: Math.max(200, element.clientWidth), height: HEIGHT })).observe(element);
  onColours(() => plot && build());
  element.addEventListener("dblclick", () => { zoomed = false; });
  return {
    /** Columns: x, then for each series its band's lower and upper, if it has one, and itself. */
    show(columns, words) {
      data = columns;
      const some = columns[0].length > 0;
      nothing.hidden = some;
      if (some && plot === null) build();
      else if (some) plot.setData(columns, !zoomed);
      if (some && zoomed) plot.redraw();
      element.setAttribute("role", "img");
      element.setAttribute("aria-label", words);
    },
  };
}

/** A range with some room, never so narrow that noise fills it. */
const atLeast = (span = 0) => (_, low, high) => {
  if (low === null || high === null) return [0, 1];
  const room = Math.max(1.1 * (high - low), span, 1e-12) / 2, middle = (low + high) / 2;
  return [middle - room, middle + room];
};

/** Horizontal lines with a word each, only where the scale reaches them. */
function drawLimits(u, limits) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour("limit");
  ctx.setLineDash([6, 4]);
  ctx.font = `${11 * devicePixelRatio}px system-ui`;
  for (const { at, text, scale = "y" } of limits) {
    const { min, max } = u.scales[scale] ?? {};
    if (min === undefined || min === null || at < min || at > max) continue;
    const y = u.valToPos(at, scale, true);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
    ctx.textAlign = scale === "y" ? "left" : "right";
    const x = scale === "y" ? bbox.left + 4 * devicePixelRatio : bbox.left + bbox.width - 4 * devicePixelRatio;
    ctx.fillText(text, x, y - 4 * devicePixelRatio);
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
