// Maps that the page shows: stored ones, and those computed from them. Pure functions; arrays are row by row, NaN at invalid points.

const combine = (a, b, of) => Float32Array.from(a, (value, i) => of(value, b[i]));
const minus = ([a, b]) => combine(a, b, (x, y) => x - y);
const hypotenuse = ([a, b]) => combine(a, b, Math.hypot);

/** Principal strains of tensor components: [largest, smallest]. */
function principal(exx, eyy, exy) {
  const middle = (exx + eyy) / 2, radius = Math.hypot((exx - eyy) / 2, exy);
  return [middle + radius, middle - radius];
}

// Of the plane strain tensor. Von Mises strain is sqrt(e1² − e1 e2 + e2²) of the plane tensor; it is no equivalent plastic strain.
const OF_STRAIN = {
  exx: (exx) => exx, eyy: (_, eyy) => eyy, exy: (_, __, exy) => exy,
  e1: (...e) => principal(...e)[0],
  e2: (...e) => principal(...e)[1],
  shear: (...e) => principal(...e)[0] - principal(...e)[1],
  mises: (...e) => { const [a, b] = principal(...e); return Math.sqrt(Math.max(0, a * a - a * b + b * b)); },
};
const COMPONENTS = ["exx", "eyy", "exy"];

/** Standard uncertainty of a strain by propagation of those of the components, which are independent; null if unknown. */
export function strainSigma(name, components, sigmas) {
  if (!sigmas || components.some((value) => !Number.isFinite(value))) return null;
  let variance = 0;
  for (let i = 0; i < 3; i++) {
    const up = components.map((value, at) => (at === i ? value + sigmas[i] / 2 : value));
    const down = components.map((value, at) => (at === i ? value - sigmas[i] / 2 : value));
    variance += (OF_STRAIN[name](...up) - OF_STRAIN[name](...down)) ** 2;
  }
  return Math.sqrt(variance);
}

function strain(name, label) {
  return { label, unit: "1e-6", scale: 1e6, group: "strain", needs: COMPONENTS,
    values: ([xx, yy, xy]) => Float32Array.from(xx, (value, i) => OF_STRAIN[name](value, yy[i], xy[i])) };
}

const px = (label, group, needs, values, more = {}) => ({ label, unit: "px", scale: 1, group, needs, values, ...more });
const itself = ([values]) => values;

// `needs`: stored maps of the frame; with `~` before the name, that of the other frame of its pair. `sigma`: stored maps of its uncertainty, combined as root of the sum of squares.
export const FIELDS = {
  eyy: strain("eyy", "strain eyy"), exx: strain("exx", "strain exx"), exy: strain("exy", "strain exy (tensor shear)"),
  e1: strain("e1", "largest principal strain"), e2: strain("e2", "smallest principal strain"),
  shear: strain("shear", "maximum shear strain (engineering)"), mises: strain("mises", "von Mises strain"),
  displacement_u: px("displacement u, corrected", "displacement", ["displacement_u"], itself, { sigma: ["displacement_sigma_u"] }),
  displacement_v: px("displacement v, corrected", "displacement", ["displacement_v"], itself, { sigma: ["displacement_sigma_v"] }),
  displacement: px("displacement, magnitude", "displacement", ["displacement_u", "displacement_v"], hypotenuse, { sigma: ["displacement_sigma_u"] }),
  correction_u: px("correction u (drift and distortion)", "correction and residual", ["disparity_u", "displacement_u"], minus),
  correction_v: px("correction v (drift and distortion)", "correction and residual", ["disparity_v", "displacement_v"], minus),
  residual_u: px("residual u (difference within the pair)", "correction and residual", ["displacement_u", "~displacement_u"], minus, { sigma: ["displacement_sigma_u", "~displacement_sigma_u"] }),
  residual_v: px("residual v (difference within the pair)", "correction and residual", ["displacement_v", "~displacement_v"], minus, { sigma: ["displacement_sigma_v", "~displacement_sigma_v"] }),
  disparity_u: px("disparity u, as measured", "as measured", ["disparity_u"], itself, { sigma: ["disparity_sigma_u"] }),
  disparity_v: px("disparity v, as measured", "as measured", ["disparity_v"], itself, { sigma: ["disparity_sigma_v"] }),
  zncc: { label: "correlation (ZNCC)", unit: "", scale: 1, group: "as measured", needs: ["zncc"], values: itself },
};

/** Entry of the frame that holds a needed map, or undefined. */
function source(need, entry, frames) {
  const other = need.startsWith("~");
  const from = other ? frames.find((one) => one.frame === (entry.frame ^ 1)) : entry;
  return from?.fields.includes(need.replace("~", "")) ? from : undefined;
}

/** Whether a frame has a field. */
export const available = (name, entry, frames) => FIELDS[name].needs.every((need) => source(need, entry, frames) !== undefined);

const fetched = new Map();
const MAX_FETCHED = 24;
let queue = Promise.resolve();

/** Fetch a stored map, at most once per version. One after the other: a browser has six connections to a server, and Stop must find a free one. */
function stored(entry, name) {
  const key = `${entry.frame}/${name}?v=${entry.version}`;
  queue = queue.then(async () => {
    if (fetched.has(key)) return fetched.get(key);
    const reply = await fetch(`field/${key}`).catch(() => null);
    const bytes = reply?.ok ? await reply.arrayBuffer().catch(() => null) : null;
    if (bytes === null) return null;
    fetched.set(key, new Float32Array(bytes));
    if (fetched.size > MAX_FETCHED) fetched.delete(fetched.keys().next().value);
    return fetched.get(key);
  });
  return queue;
}

/** Values of a field of a frame and their uncertainties: {values, sigma(i)}; null if a map could not be fetched. `gauge` has the sigmas of exx, eyy, exy. */
export async function fieldOf(name, entry, frames, gauge) {
  const { needs, values: compute, sigma = [], group } = FIELDS[name];
  const fetch_ = (need) => stored(source(need, entry, frames), need.replace("~", ""));
  const uncertain = sigma.every((need) => source(need, entry, frames) !== undefined) ? sigma : [];
  const [parts, sigmas] = await Promise.all([Promise.all(needs.map(fetch_)), Promise.all(uncertain.map(fetch_))]);
  if ([...parts, ...sigmas].includes(null)) return null;
  if (group === "strain") return { values: compute(parts), sigma: (i) => strainSigma(name, parts.map((part) => part[i]), gauge) };
  return { values: compute(parts), sigma: (i) => (sigmas.length ? Math.hypot(...sigmas.map((part) => part[i])) : null) };
}
