// Colour maps, scaled from 0 to 1, and ranges of values. All maps are readable with every common colour vision deficiency.

// Seventeen colours of the maps of matplotlib; between them colours are interpolated linearly.
const STOPS = {
  viridis: "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c 1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 fde725",
  cividis: "00224e 002e6a 1a386f 32436d 434e6c 535a6d 61656f 6f7073 7d7c78 8c8878 9b9476 aba072 bcae6c cdbb63 dec958 f0d846 fee838",
  inferno: "000004 0b0724 210c4a 3d0965 57106e 71196e 8a226a a32c61 bc3754 d24644 e45a31 f1731d f98e09 fcac11 f9cb35 f2ea69 fcffa4",
  grey: "000000 101010 202020 303030 404040 505050 606060 707070 808080 909090 a0a0a0 b0b0b0 c0c0c0 d0d0d0 e0e0e0 f0f0f0 ffffff",
  diverging: "053061 175290 2a71b2 3f8ec0 6bacd1 9bc9e0 c2ddec e0ecf3 f7f6f6 fbe5d8 fbccb4 f5aa89 e48066 d05548 ba2832 930e26 67001f",
};

export const COLOUR_MAPS = {
  viridis: "viridis", cividis: "cividis", inferno: "inferno", grey: "grey", diverging: "blue – white – red",
};

const rgb = (hex) => [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16));

/** A table of 256 colours, 3 bytes each. */
function table(name) {
  const stops = STOPS[name].split(" ").map(rgb);
  const bytes = new Uint8ClampedArray(768);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (stops.length - 1), low = Math.min(stops.length - 2, Math.floor(at));
    for (let c = 0; c < 3; c++) bytes[3 * i + c] = stops[low][c] + (at - low) * (stops[low + 1][c] - stops[low][c]);
  }
  return bytes;
}

const tables = Object.fromEntries(Object.keys(STOPS).map((name) => [name, table(name)]));

/** Colour of a part of the range as [red, green, blue]. */
export function colourAt(name, part) {
  const at = 3 * Math.round(255 * Math.min(1, Math.max(0, part)));
  return [...tables[name].subarray(at, at + 3)];
}

/** Write the colours of values into the bytes of an image; values that are not finite stay transparent. */
export function paint(bytes, values, name, [low, high]) {
  const colours = tables[name], factor = 255 / (high - low);
  for (let i = 0; i < values.length; i++) {
    if (!Number.isFinite(values[i])) continue;
    const at = 3 * Math.round(Math.min(255, Math.max(0, factor * (values[i] - low))));
    bytes[4 * i] = colours[at];
    bytes[4 * i + 1] = colours[at + 1];
    bytes[4 * i + 2] = colours[at + 2];
    bytes[4 * i + 3] = 255;
  }
}

/** Range without the outermost hundredth at each end, so that single outliers do not take all colours; symmetric about zero for the diverging map. */
export function automaticRange(values, symmetric) {
  const sorted = Float32Array.from(values.filter(Number.isFinite)).sort();
  if (!sorted.length) return [0, 1];
  let low = sorted[Math.floor(0.01 * sorted.length)], high = sorted[Math.floor(0.99 * (sorted.length - 1))];
  if (symmetric) [low, high] = [-Math.max(Math.abs(low), Math.abs(high)), Math.max(Math.abs(low), Math.abs(high))];
  return low === high ? [low - 1e-9, high + 1e-9] : [low, high];
}
