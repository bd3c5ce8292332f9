// Readable numbers, times and sizes.

const UNITS = ["B", "kB", "MB", "GB", "TB"];
const PREFIXES = ["", " k", " M", " G", " T", " P"];
/** Returns a number with a few significant digits: 0.355, 1.20e-5, 12300. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 1e-3 || size >= 1e6) return value.toExponential(digits - 1);
  return size >= 10 ** digits ? String(Math.round(value)) : value.toPrecision(digits);
}

/** Returns a count with a prefix: 4.43 M. */
export function count(value) { return scaled(value, 1000, PREFIXES); }
export function bytes(value) { return scaled(value, 1000, UNITS.map((unit) => ` ${unit}`)); }

function scaled(value, base, names) {
  if (value === null || value === undefined) return "–";
  let step = 0;
  let rest = value;
  while (rest >= base && step < names.length - 1) { rest /= base; step += 1; }
  const digits = step === 0 || rest >= 100 ? 0 : rest >= 10 ? 1 : 2;
  return `${rest.toFixed(digits)}${names[step]}`;
}

/** Returns seconds as 0.4 s, 12 s, 3 min 20 s, 2 h 5 min, 3 d 4 h. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 60) return `${seconds < 10 ? seconds.toFixed(1) : Math.round(seconds)} s`;
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return `${minutes} min ${Math.floor(seconds % 60)} s`;
  const hours = Math.floor(minutes / 60);
  if (hours < 48) return `${hours} h ${minutes % 60} min`;
  return `${Math.floor(hours / 24)} d ${hours % 24} h`;
}

/** Returns a local time; without the date if it is today. */
export function moment(text) {
  const time = new Date(text);
  if (Number.isNaN(time.getTime())) return text ?? "–";
  const clock = time.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  if (time.toDateString() === new Date().toDateString()) return clock;
  return `${time.toLocaleDateString([], { year: "numeric", month: "short", day: "numeric" })} ${clock}`;
}

export function clock(text) {
  const time = new Date(text);
  return Number.isNaN(time.getTime()) ? "" : time.toLocaleTimeString([], { hour12: false });
}

/** Returns an expression with numbers of six significant digits, as in the terminal. */
export function short(expression) { return expression.replace(/\d+\.\d+(e[+-]?\d+)?/g, (text) => String(Number(Number(text).toPrecision(6)))); }

export function plural(amount, noun) { return `${amount} ${noun}${amount === 1 ? "" : "s"}`; }

export const ENDED = ["done", "failed", "cancelled"];
export const HAS_RESULT = ["done", "cancelled"];
/** Returns the largest normalized error of all searched equations, as the progress of the whole model. */
export function largestError(job) {
  const errors = (job.variables ?? []).map((variable) => variable.normalized_error).filter((error) => error !== null && error !== undefined);
  return errors.length ? Math.max(...errors) : null;
}

/** Stores when the view of a job arrived, so that the page can count the seconds of a running job. */
export function stamp(job) { return { ...job, heard: Date.now() }; }

export function elapsed(job) {
  const isOver = ENDED.includes(job.state) || job.elapsed === undefined;
  return isOver ? job.elapsed : job.elapsed + (Date.now() - job.heard) / 1000;
}

/** Returns the state of a job, in a more precise word if possible. */
export function stateOf(job) { if (job.paused && !ENDED.includes(job.state)) return "paused"; return job.state; }
