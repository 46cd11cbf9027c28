// The panels that are curves.

import { chart } from "./chart.js";
import { byId, make, say } from "./dom.js";
import { panel } from "./stream.js";
import { measured, number } from "./words.js";

const column = (rows, pick) => rows.map(pick);
const n = (digits) => (value) => number(value, digits);

export function curves() {
  load();
  drift();
  stress();
  converge();
  quality();
}

function load() {
  let run = null;
  const plot = chart(byId("load"), {
    series: [{ label: "extension mm", colour: "b", width: 3, side: true, span: 0.02, format: n(4) }, { label: "target N", colour: "c", dash: [4, 4], format: n(4) },
      { label: "load N", colour: "a", band: true, span: 30, format: n(4) }],
    axes: { x: "min since start", y: "load N", side: "extension mm", span: 0.2 },
    limits: () => (run?.limits.force_max_n === undefined ? [] : [
      { at: run.limits.force_max_n, text: "max. force" }, { at: run.limits.force_min_n, text: "min. force" },
      { at: run.limits.extension_max_mm, text: "max. extension", scale: "side" }, { at: run.limits.extension_min_mm, text: "min. extension", scale: "side" }]),
  });
  panel(["load", "reading", "run"], ({ load: { rows }, reading, run: told }) => {
    run = told;
    // A load frame without an extensometer reports exactly zero, always: there is nothing to draw.
    const extended = rows.some((row) => row[3] !== 0);
    const words = !reading || reading.force_n === null ? "no reading of the load frame yet" : [
      `${number(reading.force_n, 4)} N of ${number(reading.target_n, 4)} N, ${reading.motion}`, extended ? `extension ${number(reading.extension_mm, 4)} mm` : null,
      reading.gage_strain === null ? null : `gage ${number(1e6 * reading.gage_strain)} 1e-6`,
    ].filter(Boolean).join("; ");
    say(byId("load-now"), words);
    say(byId("h-load"), extended ? "Load and extension" : "Load");
    plot.show([column(rows, (r) => r[0] / 60), column(rows, (r) => (extended ? r[3] : null)), column(rows, (r) => r[4]), column(rows, (r) => r[1]), column(rows, (r) => r[2]),
      column(rows, (r) => (r[1] + r[2]) / 2)], `Load${extended ? " and extension" : ""} over time: ${words}`);
  });
}

function drift() {
  const plot = chart(byId("drift"), {
    series: [{ label: "x px ± 1σ", colour: "a", band: true, span: 0.2, format: n(4) }, { label: "y px ± 1σ", colour: "b", band: true, format: n(4) },
      { label: "x forecast", colour: "a", dash: [5, 4], format: n(4) }, { label: "y forecast", colour: "b", dash: [5, 4], format: n(4) }],
    axes: { x: "min since frame 0", y: "drift px", span: 0.2 },
  });
  panel(["drift"], ({ drift: told }) => {
    const known = told.frames.flatMap((frame) => frame.rows);
    const ahead = told.forecast.slice(0, 6);
    const all = [...known, ...ahead.slice(1)];
    const first = known.length - 1;
    const past = (pick) => all.map((row, at) => (at <= first ? pick(row) : null));
    const next = (pick) => all.map((row, at) => (at >= first && ahead.length ? pick(row) : null));
    say(byId("drift-now"), told.verdict);
    const last = known.at(-1);
    const words = last ? `Drift is ${number(last[1])} px in x and ${number(last[2])} px in y; ${told.verdict}` : "no drift estimate yet";
    plot.show([column(all, (r) => r[0] / 60), column(all, (r) => r[1] - r[3]), column(all, (r) => r[1] + r[3]), past((r) => r[1]),
      column(all, (r) => r[2] - r[4]), column(all, (r) => r[2] + r[4]), past((r) => r[2]), next((r) => r[1]), next((r) => r[2])], words);
  });
}

function stress() {
  let bars = [];
  const plot = chart(byId("stress"), {
    errors: () => bars,
    series: [{ label: "stress MPa, strain ± 1σ", colour: "a", points: true, span: 1, format: n(4) }, { label: "E × strain ± 2σ", colour: "b", band: true, gaps: true, format: n(4) }],
    axes: { x: "axial strain 1e-6", y: "stress MPa", span: 20 },
  });
  panel(["strength"], ({ strength }) => {
    const points = strength.points.filter((one) => one.stress_mpa !== null).sort((a, b) => a.axial - b.axial);
    const found = strength.elastic.filter((one) => one.modulus_gpa !== null).at(-1);
    const pulled = points.filter((one) => one.phase === "tension");
    bars = points.map((one) => [one.stress_mpa, 1e6 * (one.axial - one.axial_sigma), 1e6 * (one.axial + one.axial_sigma)]);
    const mean = (pick) => pulled.reduce((sum, one) => sum + pick(one), 0) / Math.max(1, pulled.length);
    const at = mean((one) => one.axial), middle = mean((one) => one.stress_mpa);
    const line = (sigmas) => points.map((one) => (found ? middle + 1000 * (found.modulus_gpa + sigmas * found.modulus_sigma_gpa) * (one.axial - at) : null));
    const [low, high] = [line(-2), line(2)];
    plot.show([column(points, (p) => 1e6 * p.axial), column(points, (p) => p.stress_mpa), low.map((v, i) => (v === null ? null : Math.min(v, high[i]))),
      high.map((v, i) => (v === null ? null : Math.max(v, low[i]))), line(0)], `${pulled.length} frames under load; ${found ? `E is ${measured(found.modulus_gpa, found.modulus_sigma_gpa)} GPa` : "no E yet"}`);
    const last = strength.points.at(-1);
    const rows = [["E", found ? `${measured(found.modulus_gpa, found.modulus_sigma_gpa)} GPa` : "no result yet"], ["ν", found ? measured(found.ratio, found.ratio_sigma) : "no result yet"]];
    if (strength.dic_over_gage) rows.push(["DIC / gage", measured(...strength.dic_over_gage)]);
    if (last) rows.push(["axial strain", `${measured(1e6 * last.axial, 1e6 * last.axial_sigma)} 1e-6`], ["scatter", `${number(1e6 * last.sd_axial)} 1e-6 at a gauge of ${strength.vsg_px} px`]);
    byId("elastic").replaceChildren(...rows.map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value))));
  });
}

function converge() {
  const plot = chart(byId("converge"), {
    series: [{ label: "E GPa ± 2σ", colour: "a", band: true, dots: true, gaps: true, span: 1, format: n(4) }, { label: "ν ± 2σ", colour: "b", band: true, dots: true, side: true, gaps: true, span: 0.02, format: n(3) }],
    axes: { x: "pairs", y: "E GPa", side: "ν", whole: true, span: 2 }, x: (_, v) => (v === null ? "–" : String(v)),
  });
  panel(["strength"], ({ strength }) => {
    const known = strength.elastic.filter((one) => one.modulus_gpa !== null);
    const spread = (value, sigma) => [column(known, (r) => r[value] - 2 * r[sigma]), column(known, (r) => r[value] + 2 * r[sigma]), column(known, (r) => r[value])];
    plot.show([column(known, (r) => r.pairs), ...spread("modulus_gpa", "modulus_sigma_gpa"), ...spread("ratio", "ratio_sigma")],
      known.length ? `E after ${known.at(-1).pairs} pairs: ${measured(known.at(-1).modulus_gpa, known.at(-1).modulus_sigma_gpa)} GPa` : "E and Poisson's ratio need two loads");
  });
}

function quality() {
  const plot = chart(byId("quality"), {
    series: [{ label: "noise of a point px", colour: "a", span: 0.004, points: true, format: n(3) }, { label: "ZNCC, median", colour: "b", side: true, span: 0.02, most: 1, points: true, format: n(4) }],
    axes: { x: "frame", y: "noise px", side: "ZNCC", whole: true, span: 2 }, x: (_, v) => (v === null ? "–" : String(v)),
  });
  panel(["quality"], ({ quality: all }) => {
    const maps = all.filter((one) => one.reference === 0);
    const last = maps.at(-1);
    const share = (one) => `${one.converged} of ${one.points} points (${((100 * one.converged) / one.points).toFixed(1)} %)`;
    const words = last ? `frame ${last.current} from frame 0: ${share(last)}, noise ${number(last.noise_px)} px, ZNCC ${number(last.zncc, 4)}` : "no map yet";
    say(byId("quality-now"), words);
    plot.show([column(maps, (m) => m.current), column(maps, (m) => m.noise_px), column(maps, (m) => m.zncc)], words);
  });
}
