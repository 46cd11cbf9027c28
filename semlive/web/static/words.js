// Numbers, times and states as text.

export const STATES = {
  idle: ["idle", "calm"], connecting: ["connecting", "busy"], ready: ["ready", "busy"], ramping: ["moving", "busy"],
  settling: ["settling", "busy"], holding: ["holding", "wait"], imaging: ["imaging", "busy"], step_done: ["step done", "good"],
  judging: ["checking the calibration", "wait"], warming: ["warming up", "wait"], paused: ["paused", "wait"], stopping: ["stopping", "wait"], fault: ["FAULT", "bad"],
  recover: ["waiting for confirmation", "wait"], estopped: ["EMERGENCY STOP", "bad"], complete: ["complete", "good"], aborted: ["ended early", "bad"],
};

export const FIELDS = {
  disparity_u: ["disparity u, as measured", "px"], disparity_v: ["disparity v, as measured", "px"],
  displacement_u: ["displacement u, corrected", "px"], displacement_v: ["displacement v, corrected", "px"],
  exx: ["strain exx", "1e-6"], eyy: ["strain eyy", "1e-6"], exy: ["strain exy", "1e-6"], zncc: ["correlation (ZNCC)", ""],
};

/** Factor from the unit of a map to the unit shown. */
export const scaleOf = (field) => (FIELDS[field]?.[1] === "1e-6" ? 1e6 : 1);

/** A number with the given number of significant digits, without powers of ten. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const places = Math.min(8, Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(value)))));
  return value.toFixed(places).replace("-", "−");
}

/** A number without trailing zeros. */
export const plain = (value) => String(Number(value.toPrecision(6))).replace("-", "−");

/** A value and its uncertainty, both to the second digit of the uncertainty. */
export function measured(value, sigma) {
  if (value === null || value === undefined) return "–";
  if (!sigma) return number(value, 4);
  const places = Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(sigma))));
  return `${value.toFixed(places)} ± ${sigma.toFixed(places)}`.replace("-", "−");
}

/** A length of time. */
export function duration(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  if (whole < 120) return `${whole} s`;
  const minutes = Math.floor(whole / 60);
  return minutes < 120 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** Time of day at some seconds after the start of the run. */
export function timeOfDay(startMs, seconds) {
  return new Date(startMs + 1000 * seconds).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });
}
