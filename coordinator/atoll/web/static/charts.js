// Charts by uPlot, which is loaded with the first chart. The style sheet defines their colours, for light and dark pages.

import { h } from "./dom.js";
import { number } from "./format.js";

const HEIGHT = 250;
export const COLOURS = 6;
const dark = matchMedia("(prefers-color-scheme: dark)");
const charts = new Set();
let loading = null;

dark.addEventListener("change", () => charts.forEach((chart) => chart.redraw(false, true)));

function load() {
  loading ??= new Promise((done) => {
    const from = (name) => new URL(name, import.meta.url).href;
    const failed = () => done((loading = null)); // the next chart tries again
    const script = h("script", { src: from("uPlot.iife.min.js"), onload: () => done(window.uPlot), onerror: failed });
    document.head.append(h("link", { rel: "stylesheet", href: from("uPlot.min.css") }), script);
  });
  return loading;
}

/** Returns the current value of a colour of the style sheet. */
export function colour(name) { return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim(); }
/** After six colours, the colours are used again with dashed lines. */
export function colourOf(index) { return `c${index % COLOURS}${Math.floor(index / COLOURS) % 2 ? " dashed" : ""}`; }
/** Returns a legend: each name after a mark of its colour. */
export function legend(entries) {
  return h("ul", { class: "legend" }, entries.map(([name, label]) =>
    h("li", {}, h("span", { class: `swatch ${name}`, "aria-hidden": "true" }), label)));
}

/** One chart in an element: built with its first data, and again when the kind of its series changes. */
export class Chart {
  #plot = null; #shape = ""; #isClosed = false;
  constructor(label, { height = HEIGHT } = {}) {
    this.height = height;
    this.box = h("div", { class: "chart", role: "img", "aria-label": label });
    this.box.style.height = `${height}px`;
    this.observer = new ResizeObserver(() => this.#fit());
    this.observer.observe(this.box);
  }
  /** Shows data; `options` returns the options of uPlot; a changed `shape` builds the chart again. */
  async draw(data, shape, options) {
    this.next = { data, shape, options };
    const UPlot = await load();
    if (!UPlot || this.#isClosed || !this.next) return;
    const wanted = this.next;
    this.next = null;
    if (this.#plot && wanted.shape === this.#shape) return this.#plot.setData(wanted.data);
    this.#drop();
    this.#shape = wanted.shape;
    this.#plot = new UPlot({ ...this.#size(), ...wanted.options(UPlot) }, wanted.data, this.box);
    charts.add(this.#plot);
  }

  close() {
    this.#isClosed = true;
    this.observer.disconnect();
    this.#drop();
  }

  #drop() {
    if (!this.#plot) return;
    charts.delete(this.#plot);
    this.#plot.destroy();
    this.#plot = null;
  }

  #size() { return { width: Math.max(this.box.clientWidth, 200), height: this.height }; }
  #fit() { if (this.#plot && this.box.clientWidth && this.#plot.width !== this.box.clientWidth) this.#plot.setSize(this.#size()); }
}

function axis(label, isLog, more = {}) {
  const lines = { stroke: () => colour("grid"), width: 1, ...(isLog ? { filter: decadesOnly } : {}) };
  return {
    label, labelSize: 18, labelFont: "12px system-ui, sans-serif", font: "11px system-ui, sans-serif",
    stroke: () => colour("faint"), grid: lines, ticks: lines,
    values: (plot, splits) => splits.map((split) => (split === null ? "" : tick(split))), ...more,
  };
}

/** Returns no minor grid lines over many decades, because they would merge into a grey area. */
function decadesOnly(_plot, splits) {
  if (Math.log10(splits.at(-1) / splits[0]) < 3) return splits;
  return splits.map((split) => (Math.abs(Math.log10(split) - Math.round(Math.log10(split))) < 1e-9 ? split : null));
}

function tick(value) {
  const [size, short] = [Math.abs(value), Number(value.toPrecision(6))];
  return value !== 0 && (size >= 1e5 || size < 1e-3) ? short.toExponential().replace("+", "") : String(short);
}

/** Returns the options that all charts share. */
function frame(xLabel, yLabel, { isLogX = false, isLogY = false, bounds = {}, series, ...more }) {
  const scale = (isLog, range) => ({ time: false, ...(isLog ? { distr: 3 } : {}), ...(range ? { range: () => range } : {}) });
  return {
    legend: { show: false }, cursor: { drag: { x: false, y: false } },
    scales: { x: scale(isLogX, bounds.x), y: scale(isLogY, bounds.y) },
    axes: [axis(xLabel, isLogX, { size: 32 }), axis(yLabel, isLogY, { size: 62 })],
    series, padding: [10, 14, 0, 0], ...more,
  };
}

const stroke = (name) => () => colour(name.split(" ")[0]);
const dashOf = (name) => (name.endsWith("dashed") ? [5, 4] : undefined);
const isWide = (values) => {
  const known = values.filter((value) => value !== null);
  const above = known.filter((value) => value > 0);
  return above.length > 0 && above.length === known.length && Math.max(...above) > 10 * Math.min(...above);
};

/** Logarithms need positive numbers, so an error of 0 is drawn a decade below the smallest positive error. */
function positive(errors) {
  const least = Math.min(...errors.filter((error) => error > 0), 1);
  return errors.map((error) => (error > 0 ? error : least / 10));
}

/** Fronts: error over complexity; a click chooses a point of the first front. */
export class FrontChart extends Chart {
  constructor(label, choose) { super(label); this.choose = choose; }
  /** `fronts` are lists of points; `chosen` is an index into the first. */
  set(fronts, chosen = null) {
    const xs = [...new Set(fronts.flat().map((point) => point.complexity))].sort((a, b) => a - b);
    if (!xs.length) return;
    const all = positive(fronts.flat().map(errorOf));
    const columns = fronts.map((front) => {
      const errors = new Map(front.map((point) => [point.complexity, errorOf(point)]));
      const lowest = Math.min(...all);
      return xs.map((x) => (errors.has(x) ? Math.max(errors.get(x), lowest) : null));
    });
    const mark = xs.map((x, index) => (chosen !== null && fronts[0][chosen]?.complexity === x ? columns[0][index] : null));
    this.bounds = { x: [0, Math.max(...xs) + 1], y: decades(all) };
    this.points = fronts[0];
    this.xs = xs;
    this.draw([xs, ...columns, mark], `front ${fronts.length}`, (UPlot) => this.#options(UPlot, fronts.length));
  }

  #options(UPlot, count) {
    const steps = UPlot.paths.stepped({ align: 1 });
    const series = Array.from({ length: count }, (_, index) => ({
      stroke: stroke(colourOf(index)), width: 1, dash: index ? [5, 4] : undefined, paths: steps, spanGaps: true,
      points: { show: true, size: 8, fill: stroke(colourOf(index)), stroke: stroke("ground"), width: 1 },
    }));
    const chosen = { stroke: stroke("text"), paths: () => null, points: { show: true, size: 14, width: 2, fill: "transparent", stroke: stroke("text") } };
    const options = frame("complexity", "error (normalized)", { isLogY: true, series: [{}, ...series, chosen] });
    options.scales.x.range = () => this.bounds.x;
    options.scales.y.range = () => this.bounds.y;
    options.cursor = { ...options.cursor, y: false, points: { size: 10 } };
    options.hooks = { ready: [(plot) => plot.over.addEventListener("click", () => this.#click(plot))] };
    return options;
  }

  #click(plot) {
    const index = this.points.findIndex((point) => point.complexity === this.xs[plot.cursor.idx]);
    if (index >= 0) this.choose?.(index);
  }
}

/** Returns whole decades around errors, so that no error lies on an edge. */
function decades(errors) {
  return [10 ** (Math.ceil(Math.log10(Math.min(...errors))) - 1), 10 ** (Math.floor(Math.log10(Math.max(...errors))) + 1)];
}

/** Returns a subset of many points, so that a line below stays visible; the others are null. */
export function thin(values, most = 100) {
  const step = Math.ceil(values.length / most);
  return values.map((value, index) => (index % step ? null : value));
}

export function errorOf(point) { return point.normalized_error ?? point.error; }
/** Errors of islands over generations, with the generation of the last improvement. */
export class ConvergenceChart extends Chart {
  set(curves, plateau) {
    const kept = curves.filter((curve) => curve.generations.length);
    if (!kept.length) return;
    this.plateau = plateau;
    const xs = [...new Set(kept.flatMap((curve) => curve.generations))].sort((a, b) => a - b);
    const columns = kept.map((curve) => lastValues(curve, xs));
    const [isLogX, isLogY] = [isWide(xs), isWide(kept.flatMap((curve) => curve.errors))];
    const names = kept.map((curve) => curve.island);
    this.isShort = xs.length < 2; // one generation has no line
    this.draw([xs, ...columns], `curves ${names} ${isLogX} ${isLogY} ${this.isShort}`, (UPlot) => this.#options(UPlot, names, isLogX, isLogY));
  }

  #options(UPlot, names, isLogX, isLogY) {
    const paths = UPlot.paths.stepped({ align: 1 });
    const series = names.map((_, index) => ({ stroke: stroke(colourOf(index)), dash: dashOf(colourOf(index)), width: 1.4, paths, spanGaps: true, points: { show: this.isShort } }));
    return frame("generation", "error (normalized)", {
      isLogX, isLogY, series: [{}, ...series], hooks: { draw: [(plot) => this.#drawPlateau(plot)] },
    });
  }

  #drawPlateau(plot) {
    if (this.plateau === null || this.plateau === undefined) return;
    const { ctx, bbox } = plot;
    const x = plot.valToPos(this.plateau, "x", true);
    if (x < bbox.left || x > bbox.left + bbox.width) return;
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = colour("faint");
    ctx.setLineDash([6, 5]);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.textAlign = x > bbox.left + bbox.width / 2 ? "right" : "left";
    ctx.fillText(" plateau ", x, bbox.top + 12 * devicePixelRatio);
    ctx.restore();
  }
}

/** An island may report several errors of one generation: the last error counts. */
function lastValues(curve, xs) {
  const values = new Map(curve.generations.map((generation, index) => [generation, curve.errors[index]]));
  const first = curve.generations[0];
  const end = curve.errors.at(-1);
  return xs.map((x, index) => values.get(x) ?? (index === xs.length - 1 && x > first ? end : null));
}

/** Curves over one axis: `lines` holds {values, colour, isPoints, band: [low, high]}. */
export class LinesChart extends Chart {
  set(xLabel, yLabel, xs, lines) {
    const data = [xs];
    const series = [{}];
    const bands = [];
    for (const line of lines) {
      if (line.band) {
        data.push(line.band[1], line.band[0]);
        bands.push({ series: [series.length, series.length + 1], fill: () => `${colour(line.colour)}38` });
        const edge = { stroke: "transparent", width: 0, points: { show: false } };
        series.push(edge, edge);
      }
      data.push(line.values);
      const points = line.isPoints ? { show: true, size: 4, fill: stroke(line.colour), stroke: stroke(line.colour), width: 0 } : { show: false };
      series.push({ stroke: stroke(line.colour), width: 1.6, spanGaps: !line.isPoints, points, ...(line.isPoints ? { paths: () => null } : {}) });
    }
    const shape = `${xLabel} ${yLabel} ${lines.map((line) => `${line.colour} ${line.isPoints} ${Boolean(line.band)}`)}`;
    this.draw(data, shape, () => frame(xLabel, yLabel, { series, bands }));
  }
}

/** Curves and points, each with its own horizontal values: over time, or one state over another.
 *
 * `trails` holds {xs, ys, colour, isPoints, low, high}: a line ends where a number is missing, and `low` and `high` are
 * the edges of its band. */
export class TrailsChart extends Chart {
  set(xLabel, yLabel, trails) {
    const bounds = { x: extent(trails.map((trail) => trail.xs)), y: extent(trails.flatMap((trail) => [trail.ys, trail.low ?? [], trail.high ?? []])) };
    const facets = [{ scale: "x", auto: true }, { scale: "y", auto: true }];
    const series = trails.map((trail) => ({ facets, paths: (plot, index) => drawTrail(plot, index, trail) }));
    const options = () => frame(xLabel, yLabel, { mode: 2, bounds, series: [null, ...series], cursor: { show: false } });
    const shape = `${xLabel} ${yLabel} ${bounds.x} ${bounds.y} ${trails.map((trail) => `${trail.colour} ${trail.isPoints}`)}`;
    this.draw([null, ...trails.map((trail) => [trail.xs, trail.ys, trail.low, trail.high])], shape, options);
  }
}

function extent(columns) {
  let [low, high] = [Infinity, -Infinity];
  for (const values of columns) {
    for (const value of values) if (value !== null && Number.isFinite(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
  }
  if (low > high) return [0, 1];
  const margin = 0.05 * (high - low || Math.abs(high) || 1);
  return [low - margin, high + margin];
}

function drawTrail(plot, index, trail) {
  const [xs, ys, low, high] = plot.data[index];
  const { ctx } = plot;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour(trail.colour);
  ctx.lineWidth = 1.6 * devicePixelRatio;
  if (trail.isPoints) ctx.fill(squares(plot, xs, ys));
  else ctx.stroke(lines(plot, xs, ys));
  if (low && high) {
    ctx.globalAlpha = 0.2;
    ctx.fill(band(plot, xs, low, high));
  }
  ctx.restore();
  return null;
}

function at(plot, x, y) { return [plot.valToPos(x, "x", true), plot.valToPos(y, "y", true)]; }

function squares(plot, xs, ys) {
  const path = new Path2D();
  const size = 4 * devicePixelRatio;
  xs.forEach((x, i) => {
    if (x === null || ys[i] === null) return;
    const [left, top] = at(plot, x, ys[i]);
    path.rect(left - size / 2, top - size / 2, size, size);
  });
  return path;
}

function lines(plot, xs, ys) {
  const path = new Path2D();
  let isDown = false;
  xs.forEach((x, i) => {
    const isKnown = x !== null && ys[i] !== null;
    if (isKnown) path[isDown ? "lineTo" : "moveTo"](...at(plot, x, ys[i]));
    isDown = isKnown;
  });
  return path;
}

/** Returns the area between two curves, piece by piece. */
function band(plot, xs, low, high) {
  const path = new Path2D();
  let piece = [];
  const close = () => {
    piece.forEach((i, place) => path[place ? "lineTo" : "moveTo"](...at(plot, xs[i], high[i])));
    piece.reverse().forEach((i) => path.lineTo(...at(plot, xs[i], low[i])));
    piece = [];
  };
  xs.forEach((x, i) => { if (x === null || low[i] === null || high[i] === null) close(); else piece.push(i); });
  close();
  return path;
}

/** Makes an element a slider, for screen readers: arrow keys choose a point of a front. */
export function makeSteerable(element, label, { count, at, choose, say }) {
  element.addEventListener("keydown", (event) => {
    const last = count() - 1;
    const steps = { ArrowRight: at() + 1, ArrowUp: at() + 1, ArrowLeft: at() - 1, ArrowDown: at() - 1, Home: 0, End: last, Enter: at() };
    if (!(event.key in steps) || last < 0) return;
    event.preventDefault();
    choose(Math.max(0, Math.min(last, steps[event.key])));
  });
  return () => {
    const values = { role: "slider", tabindex: 0, "aria-label": label, "aria-valuemin": 0, "aria-valuemax": Math.max(0, count() - 1), "aria-valuenow": Math.max(0, at()), "aria-valuetext": say() };
    for (const [name, value] of Object.entries(values)) element.setAttribute(name, value);
  };
}

export function sayPoint(point) {
  return point ? `complexity ${point.complexity}, error ${number(errorOf(point))}: ${point.expression}` : "no point is marked";
}
