// The newest image with a map over it: what is shown, and how it is drawn.

import { COLOUR_MAPS, automaticRange } from "./colours.js";
import { byId, make, onColours, recall, remember, say } from "./dom.js";
import { FIELDS, available, fieldOf } from "./fields.js";
import { imageOf, maskOf, newestImage } from "./image.js";
import { barLabels, barPicture, drawBar, drawGrid, drawMap, drawMask, drawProbe, drawScaleBar, fit } from "./overlay.js";
import { probe } from "./probe.js";
import { picture, saves } from "./save.js";
import { panel } from "./stream.js";
import { onKey } from "./views.js";
import { plain } from "./words.js";

const COLOURS = "semlive colours";

export function see() {
  const canvas = byId("map"), slider = byId("map-frame"), select = byId("map-field");
  let maps = { frames: [], grid: null }, gauges = new Map(), pixelUm = null, scanSize = null;
  let image = null, every = 1;
  // The image of the frame whose map is shown, while an earlier frame is chosen; otherwise the newest image.
  let own = null, mask = null;
  let newest = true, wanted = "eyy", key = "";
  // Values, frame and field are set together when all have arrived, so that no map has the name of another.
  let shown = null, range = [0, 1];
  const measure = probe(canvas, { changed: draw, context: () => shown && maps.grid && { ...shown, grid: maps.grid, pixelUm, view: mapView(), picture: saved } });

  const below = () => own ?? image;
  const size = () => below()?.size ?? scanSize ?? (maps.grid ? [maps.grid[0] * 2 + maps.grid[2] * (maps.grid[3] - 1), maps.grid[1] * 2 + maps.grid[2] * (maps.grid[4] - 1)] : [4, 3]);
  const viewNow = () => fit(canvas, size());
  /** Where the points of frame 0 are in the image below: in the image of a frame they are moved with the specimen. */
  const mapView = () => {
    const view = viewNow(), [u, v] = (own && shown?.entry.shift_px) || [0, 0];
    return { ...view, left: view.left + view.scale * u, top: view.top + view.scale * v };
  };
  const frame = () => maps.frames[Number(slider.value)];
  const fine = () => Math.max(1, devicePixelRatio);

  async function load() {
    const one = frame(), name = select.value;
    if (!one || !name) return;
    const there = available(name, one, maps.frames);
    say(byId("map-which"), `${one.frame}: ${one.phase}${one.load_n === null ? "" : ` ${plain(one.load_n)} N`}${there ? "" : ", without this map"}`);
    slider.setAttribute("aria-valuetext", byId("map-which").textContent);
    byId("frame-back").disabled = Number(slider.value) === 0;
    byId("frame-on").disabled = slider.value === slider.max;
    const other = maps.frames.find((each) => each.frame === (one.frame ^ 1));
    const alone = !newest && one.image;
    const asked = `${one.frame}/${name}/${one.version}/${other?.version}/${gauges.get(one.frame)}/${alone}`;
    if (!there || asked === key) return;
    key = asked;
    const [field, taken] = await Promise.all([fieldOf(name, one, maps.frames, gauges.get(one.frame)), alone ? imageOf(one.frame) : null]);
    if (asked !== key) return;
    if (field === null) { key = ""; return; }
    shown = { ...field, name, entry: one };
    own = taken;
    redraw();
    measure.update();
  }

  const style = () => ({ map: byId("colour-map").value || "viridis", range, opacity: byId("opacity").valueAsNumber / 100 });

  function draw() {
    const stage = byId("stage"), width = Math.round(stage.clientWidth * fine()), height = Math.round(stage.clientHeight * fine());
    byId("map-none").hidden = Boolean(below()) || maps.frames.length > 0;
    if (width < 20 || height < 20) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const pen = canvas.getContext("2d"), view = viewNow(), placed = mapView();
    pen.clearRect(0, 0, width, height);
    if (below()) pen.drawImage(below().bitmap, view.left, view.top, view.width, view.height);
    if (mask && below() && byId("mask-on").checked) drawMask(pen, view, placed, mask);
    const usable = shown && maps.grid && shown.values.length === maps.grid[3] * maps.grid[4];
    byId("scale").hidden = !usable;
    if (usable) {
      setRange();
      drawMap(pen, placed, maps.grid, shown.values, style());
      drawBar(byId("bar"), style().map);
      const { scale, unit } = FIELDS[shown.name], labels = barLabels(range.map((value) => scale * value), unit);
      byId("bar-labels").replaceChildren(...labels.map((label) => make("span", {}, label)));
      byId("bar").setAttribute("aria-label", `Colours from ${labels[2]} to ${labels[0]}`);
    }
    if (maps.grid && byId("grid-dots").checked) every = drawGrid(pen, placed, maps.grid, fine());
    if (usable) drawProbe(pen, placed, maps.grid, measure.tool(), ...measure.ends(), fine());
    if (below() || maps.grid) drawScaleBar(pen, view, pixelUm, fine());
    canvas.setAttribute("aria-label", `${own ? `Image of frame ${own.frame}` : image ? "Newest image" : "No image"}${usable ? `, with the map: ${byId("map-now").textContent}` : ""}`);
  }

  /** The range of colours: as entered, or automatic. */
  function setRange() {
    const { scale, unit } = FIELDS[shown.name], automatic = automaticRange(shown.values, style().map === "diverging");
    const entered = ["range-low", "range-high"].map((id) => byId(id).valueAsNumber / scale);
    range = automatic.map((value, at) => (Number.isFinite(entered[at]) ? entered[at] : value));
    if (!(range[0] < range[1])) range = automatic;
    byId("range-unit").textContent = unit ? `to (${unit})` : "to";
  }

  function about() {
    if (!below()) return;
    const { grid } = maps, points = grid ? `, grid of ${grid[3]} × ${grid[4]} points${byId("grid-dots").checked && every > 1 ? `, one in ${every} drawn` : ""}, subset ${grid[5]} px` : "";
    const pixel = pixelUm ? `, ${plain(pixelUm)} µm per px` : "";
    const place = own ? "moved with the specimen" : "drawn at the points of frame 0";
    const map = shown ? `; map: ${FIELDS[shown.name].label}, frame ${shown.entry.frame}, ${place}` : "";
    say(byId("frame-now"), `${own ? `image of frame ${own.frame}` : image.name}, ${size()[0]} × ${size()[1]} px${points}${pixel}${map}`);
  }

  function redraw() { draw(); about(); }

  newestImage((next) => { image = next; redraw(); }, (text) => say(byId("frame-now"), text));
  new ResizeObserver(draw).observe(byId("stage"));
  onColours(draw);

  const step = (by) => { slider.value = String(Number(slider.value) + by); slider.dispatchEvent(new Event("input")); };
  slider.addEventListener("input", () => { newest = slider.value === slider.max; load(); });
  byId("frame-back").addEventListener("click", () => step(-1));
  byId("frame-on").addEventListener("click", () => step(1));
  onKey("[", () => step(-1));
  onKey("]", () => step(1));
  select.addEventListener("change", () => { wanted = select.value; byId("range-low").value = byId("range-high").value = ""; load(); });
  byId("colour-map").replaceChildren(...Object.entries(COLOUR_MAPS).map(([value, label]) => make("option", { value, selected: value === recall(COLOURS, "viridis") }, label)));
  byId("colour-map").addEventListener("change", () => remember(COLOURS, style().map));
  for (const id of ["colour-map", "opacity", "range-low", "range-high", "grid-dots", "mask-on"]) byId(id).addEventListener("input", redraw);
  let opacity = "70";
  onKey("o", () => {
    const control = byId("opacity");
    if (control.value !== "0") opacity = control.value;
    control.value = control.value === "0" ? opacity : "0";
    redraw();
  });

  panel(["maps", "scan", "run", "strength"], ({ maps: now, scan, run, strength }) => {
    pixelUm = scan?.pixel_um ?? run?.pixel_um ?? null;
    scanSize = scan?.size_px ?? null;
    if (run) byId("mask-row").hidden = !run.mask;
    if (run?.mask && !mask) maskOf().then((bitmap) => { mask = bitmap; draw(); });
    if (strength) gauges = new Map(strength.points.map((one) => [one.frame, one.gauge_sigma]));
    if (!now) return;
    maps = now;
    const known = Object.keys(FIELDS).filter((name) => now.frames.some((one) => available(name, one, now.frames)));
    if ([...select.options].map((one) => one.value).join() !== known.join()) {
      const groups = [...new Set(known.map((name) => FIELDS[name].group))];
      select.replaceChildren(...groups.map((group) => make("optgroup", { label: group },
        ...known.filter((name) => FIELDS[name].group === group).map((name) => make("option", { value: name, selected: name === wanted }, FIELDS[name].label)))));
      if (known.includes(wanted)) select.value = wanted;
    }
    slider.max = String(Math.max(0, now.frames.length - 1));
    if (newest) slider.value = slider.max;
    redraw();
    load().then(about);
  });

  saves(byId("map-box").closest(".panel"), "map", {
    csv: () => [["x_px", "y_px", ...(shown ? [`${shown.name}_${FIELDS[shown.name].unit || "1"}`, "sigma"] : [])], shown ? rows() : []],
    png: saved,
  });

  /** The image with the map, colour bar and texts. */
  function saved() {
    const title = shown ? `${FIELDS[shown.name].label}, frame ${shown.entry.frame}` : own ? `image of frame ${own.frame}` : "newest image", labels = [...byId("bar-labels").children].map((label) => label.textContent);
    return picture(canvas, title, [byId("map-now").textContent, byId("frame-now").textContent], shown ? barPicture(style().map, labels, canvas.height, fine()) : null);
  }

  function rows() {
    const [x0, y0, spacing, nx] = maps.grid, { scale } = FIELDS[shown.name];
    return Array.from(shown.values, (value, at) => {
      const sigma = shown.sigma(at);
      return [x0 + spacing * (at % nx), y0 + spacing * Math.floor(at / nx), scale * value, sigma === null ? null : scale * sigma];
    });
  }
}
