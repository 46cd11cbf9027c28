// Drawing: the image, a map over it, the grid of points, what is measured, scale bar and colour bar.

import { colourAt, paint } from "./colours.js";
import { colour, make } from "./dom.js";
import { roundLength } from "./regions.js";
import { number, onSpecimen } from "./words.js";

const MARK = "#ffd60a";
const SHADE = "#000a";

/** Scale and offset that fit an image of a size (px) into a canvas. */
export function fit(canvas, [width, height]) {
  const scale = Math.min(canvas.width / width, canvas.height / height);
  return { scale, left: (canvas.width - scale * width) / 2, top: (canvas.height - scale * height) / 2, width: scale * width, height: scale * height };
}

/** Place of a point of the grid on the canvas. */
export const placeOf = (view, [x0, y0, step], [x, y]) => [view.left + view.scale * (x0 + step * x + 0.5), view.top + view.scale * (y0 + step * y + 0.5)];

const layer = make("canvas");

/** Draw a map over its points; `style`: {map, range, opacity}. */
export function drawMap(pen, view, grid, values, style) {
  const [x0, y0, step, nx, ny] = grid;
  if (!style.opacity || values.length !== nx * ny) return;
  [layer.width, layer.height] = [nx, ny];
  const own = layer.getContext("2d"), picture = own.createImageData(nx, ny);
  paint(picture.data, values, style.map, style.range);
  own.putImageData(picture, 0, 0);
  pen.save();
  pen.globalAlpha = style.opacity;
  pen.imageSmoothingEnabled = false;
  pen.drawImage(layer, view.left + view.scale * (x0 + 0.5 - step / 2), view.top + view.scale * (y0 + 0.5 - step / 2), view.scale * step * nx, view.scale * step * ny);
  pen.restore();
}

/** Lay the mask, which moves with the specimen, over the image. */
export function drawMask(pen, view, placed, bitmap) {
  pen.save();
  pen.beginPath();
  pen.rect(view.left, view.top, view.width, view.height);
  pen.clip();
  pen.drawImage(bitmap, placed.left, placed.top, placed.width, placed.height);
  pen.restore();
}

/** Draw the points, thinned so that they stay apart, and the outline of their subsets. Returns every how many points one is drawn. */
export function drawGrid(pen, view, grid, fine) {
  const [, , step, nx, ny, subset] = grid;
  const every = Math.max(1, Math.ceil((12 * fine) / (step * view.scale)));
  for (const [edge, fill] of [[5 * fine, SHADE], [3 * fine, MARK]]) {
    pen.fillStyle = fill;
    for (let j = 0; j < ny; j += every) for (let i = 0; i < nx; i += every) {
      const [x, y] = placeOf(view, grid, [i, j]);
      pen.fillRect(x - edge / 2, y - edge / 2, edge, edge);
    }
  }
  const [left, top] = placeOf(view, grid, [0, 0]), half = (subset / 2) * view.scale;
  pen.strokeStyle = MARK;
  pen.lineWidth = 1.5 * fine;
  pen.strokeRect(left - half, top - half, (nx - 1) * step * view.scale + 2 * half, (ny - 1) * step * view.scale + 2 * half);
  return every;
}

/** Draw the point, line or region that is measured. */
export function drawProbe(pen, view, grid, tool, from, to, fine) {
  if (!from) return;
  const [x, y] = placeOf(view, grid, from), [u, v] = to ? placeOf(view, grid, to) : [x, y];
  const shape = new Path2D();
  if (tool === "region" && to) shape.rect(Math.min(x, u), Math.min(y, v), Math.abs(u - x), Math.abs(v - y));
  else {
    for (const [a, b] of tool === "line" && to ? [[x, y], [u, v]] : [[x, y]]) {
      const arm = 8 * fine;
      shape.moveTo(a - arm, b); shape.lineTo(a + arm, b); shape.moveTo(a, b - arm); shape.lineTo(a, b + arm);
    }
    if (tool === "line" && to) { shape.moveTo(x, y); shape.lineTo(u, v); }
  }
  for (const [width, stroke] of [[4 * fine, "#000c"], [1.6 * fine, "#fff"]]) {
    pen.lineWidth = width;
    pen.strokeStyle = stroke;
    pen.stroke(shape);
  }
}

/** Draw a bar of a round length at the lower left; of pixels if the pixel size is unknown. */
export function drawScaleBar(pen, view, pixelUm, fine) {
  const unit = pixelUm ?? 1, most = (0.3 * view.width) / view.scale * unit;
  const length = roundLength(most), wide = (length / unit) * view.scale, text = pixelUm ? onSpecimen(length) : `${length} px`;
  const x = view.left + 10 * fine, y = view.top + view.height - 12 * fine;
  pen.font = `600 ${14 * fine}px system-ui, sans-serif`;
  pen.fillStyle = SHADE;
  pen.fillRect(x - 6 * fine, y - 22 * fine, Math.max(wide, pen.measureText(text).width) + 12 * fine, 30 * fine);
  pen.fillStyle = "#fff";
  pen.fillRect(x, y, wide, 4 * fine);
  pen.fillText(text, x, y - 5 * fine);
}

/** Draw the colours from the highest value at the top to the lowest at the bottom. */
export function drawBar(canvas, map) {
  [canvas.width, canvas.height] = [1, 128];
  const pen = canvas.getContext("2d");
  for (let y = 0; y < 128; y++) {
    pen.fillStyle = `rgb(${colourAt(map, 1 - y / 127).join()})`;
    pen.fillRect(0, y, 1, 1);
  }
}

/** Labels of the colour bar from top to bottom. */
export const barLabels = ([low, high], unit) => [1, 0.5, 0].map((part) => `${number(low + part * (high - low))}${unit ? ` ${unit}` : ""}`);

/** The colour bar with its labels as a picture, for a saved image. */
export function barPicture(map, labels, height, fine) {
  const out = make("canvas"), strip = make("canvas");
  [out.width, out.height] = [110 * fine, height];
  drawBar(strip, map);
  const pen = out.getContext("2d");
  pen.imageSmoothingEnabled = false;
  pen.drawImage(strip, 0, 0, 16 * fine, height);
  pen.fillStyle = colour("ink");
  pen.font = `${12 * fine}px system-ui, sans-serif`;
  labels.forEach((label, at) => pen.fillText(label, 22 * fine, at === 0 ? 12 * fine : at === 1 ? height / 2 + 4 * fine : height - 3 * fine));
  return out;
}
