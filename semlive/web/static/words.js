// Numbers, times and states as text.

export const STATES = {
  idle: ["idle", "calm"], connecting: ["connecting", "busy"], ready: ["ready", "busy"], ramping: ["moving", "busy"],
  settling: ["settling", "busy"], holding: ["holding", "wait"], imaging: ["imaging", "busy"], step_done: ["step done", "good"],
  judging: ["checking the calibration", "wait"], warming: ["warming up", "wait"], paused: ["paused", "wait"], stopping: ["stopping", "wait"], fault: ["FAULT", "bad"],
  recover: ["waiting for confirmation", "wait"], estopped: ["EMERGENCY STOP", "bad"], complete: ["complete", "good"], aborted: ["ended early", "bad"],
};

export const FINAL = ["complete", "aborted"];

/** A number with the given number of significant digits, without powers of ten where they are not needed. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const exponent = Math.floor(Math.log10(Math.abs(value)));
  if (exponent < -7) return value.toExponential(digits - 1).replaceAll("-", "−");
  return value.toFixed(Math.min(8, Math.max(0, digits - 1 - exponent))).replace("-", "−");
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
  const minutes = Math.round(whole / 60);
  return minutes < 120 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}

/** The remaining time of a countdown, to the second. */
export function countdown(seconds) {
  const whole = Math.max(0, Math.ceil(seconds));
  if (whole < 120) return `${whole} s`;
  const [hours, minutes, rest] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60].map((n) => String(n).padStart(2, "0"));
  return hours === "00" ? `${minutes}:${rest}` : `${Number(hours)}:${minutes}:${rest}`;
}

/** Time of day at some seconds after the start of the run. */
export function timeOfDay(startMs, seconds, parts = { second: "2-digit" }) {
  return new Date(startMs + 1000 * seconds).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", hour12: false, ...parts });
}

/** A length on the specimen in the unit that suits it. */
export function onSpecimen(micrometres) {
  if (Math.abs(micrometres) >= 1000) return `${plain(micrometres / 1000)} mm`;
  return Math.abs(micrometres) >= 1 ? `${plain(micrometres)} µm` : `${plain(1000 * micrometres)} nm`;
}

/** A step of the plan in words. */
export function stepText(step) {
  if (!step) return "";
  if (step.warm_up) return "warm-up pair";
  const shift = step.shift_px.some(Boolean) ? ` at (${step.shift_px.map(plain).join(", ")}) px` : "";
  return `${step.phase}${step.load_n === null ? "" : ` ${plain(step.load_n)} N`}${shift}`;
}
