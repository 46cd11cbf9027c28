// Values along a line and inside a rectangle of a map. Pure functions; places are grid points, which may lie between points.

const finite = (values) => values.filter(Number.isFinite);

/** Mean, standard deviation, median and range of the valid values; null if there are none. */
export function statistics(values) {
  const valid = finite(values);
  if (!valid.length) return null;
  const mean = valid.reduce((sum, value) => sum + value, 0) / valid.length;
  const squares = valid.reduce((sum, value) => sum + (value - mean) ** 2, 0);
  const sorted = Float64Array.from(valid).sort();
  return { points: valid.length, mean, sd: valid.length > 1 ? Math.sqrt(squares / (valid.length - 1)) : 0,
    median: (sorted[(valid.length - 1) >> 1] + sorted[valid.length >> 1]) / 2, low: sorted[0], high: sorted[valid.length - 1] };
}

/** Indices of the points in a rectangle given by two corners, row by row. */
export function inside([ax, ay], [bx, by], nx) {
  const indices = [];
  for (let y = Math.min(ay, by); y <= Math.max(ay, by); y++) for (let x = Math.min(ax, bx); x <= Math.max(ax, bx); x++) indices.push(y * nx + x);
  return indices;
}

/** Bilinear value between four points; NaN if one of them is not valid. */
export function between(values, nx, ny, x, y) {
  const left = Math.min(nx - 2, Math.max(0, Math.floor(x))), top = Math.min(ny - 2, Math.max(0, Math.floor(y)));
  if (nx < 2 || ny < 2) return values[Math.round(y) * nx + Math.round(x)];
  const fx = x - left, fy = y - top, at = top * nx + left;
  const upper = fx === 0 ? values[at] : fx === 1 ? values[at + 1] : values[at] * (1 - fx) + values[at + 1] * fx;
  const lower = fx === 0 ? values[at + nx] : fx === 1 ? values[at + nx + 1] : values[at + nx] * (1 - fx) + values[at + nx + 1] * fx;
  return fy === 0 ? upper : fy === 1 ? lower : upper * (1 - fy) + lower * fy;
}

/** Values along a line from a to b, one per grid step: rows of [distance in grid steps, value, index of the nearest point]. */
export function profile(values, nx, ny, [ax, ay], [bx, by]) {
  const length = Math.hypot(bx - ax, by - ay), count = Math.max(1, Math.ceil(length));
  return Array.from({ length: count + 1 }, (_, i) => {
    const x = ax + ((bx - ax) * i) / count, y = ay + ((by - ay) * i) / count;
    return [(length * i) / count, between(values, nx, ny, x, y), Math.round(y) * nx + Math.round(x)];
  });
}

/** A round length (1, 2 or 5 times a power of ten) of at most the given one. */
export function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].map((digit) => digit * power).find((length) => length <= most * (1 + 1e-9)) ?? power;
}
