// What a job gives: refining under way, then simulation, phase portrait, report and files to take along.

import { check, get, getText, paths, send } from "./api.js";
import { LinesChart, PhaseChart, cycled, legend, sparse } from "./charts.js";
import { HAS_RESULT, plural } from "./format.js";
import { announce, download, faultBox, h, setText, show } from "./dom.js";
import { Paced } from "./poll.js";

const ASK_AGAIN = 1000;
const EMPTY_PAGE = "<!doctype html><meta charset=utf-8><title>Report</title><p>A worker makes the report…</p>";
const ENDINGS = { python: "py", c: "c", julia: "jl", matlab: "m", modelica: "mo", sbml: "xml", petab: "txt", xppaut: "ode", latex: "tex", sympy: "py", csv: "csv", json: "json" };

export class Outcome {
  #state = null; #charts = []; #isClosed = false; #picks = {};
  constructor(id) {
    this.id = id;
    this.pace = new Paced(() => this.#load());
    this.tasks = h("p", { class: "faint" });
    this.refining = h("div", { class: "refining", hidden: true }, h("p", {}, "Refining: constants are fitted to the whole trajectories, candidates are compared, errors are estimated."),
      h("progress", { "aria-label": "Refining" }), this.tasks);
    this.report = h("button", { type: "button", onclick: () => this.#openReport() }, "Open the report");
    this.reportSaid = h("span", { class: "faint", role: "status" });
    this.files = h("span", { class: "bar" });
    this.fault = faultBox();
    this.charts = h("div", { class: "pair" });
    this.label = h("p", { class: "label" }, "Take along");
    this.done = h("div", { hidden: true }, h("div", { class: "bar" }, this.report, this.reportSaid), this.label, this.files, this.fault, this.charts);
    this.box = h("section", { "aria-label": "Outcome", hidden: true }, h("h2", {}, "Outcome"), this.refining, this.done);
  }

  update(job) {
    setText(this.tasks, (job.tasks ?? []).map(taskText).join(" "));
    this.isWhole = (job.variables ?? []).every((variable) => variable.expression);
    if (job.state === this.#state) return;
    this.#state = job.state;
    if (HAS_RESULT.includes(job.state)) this.pace.now();
    this.#show();
  }

  /** Exports and simulation are of the equation that was chosen of a front, also while the job runs. */
  choose(variable, index) { if (this.#picks[variable] !== index) { this.#picks[variable] = index; this.pace.soon(); this.#show(); } }
  get #query() { return { pick: Object.entries(this.#picks).map((pair) => pair.join("=")) }; }
  #show() {
    const isDone = HAS_RESULT.includes(this.#state);
    const isChosen = Object.keys(this.#picks).length > 0;
    setText(this.label, isChosen ? "Take along, with the chosen equations" : "Take along");
    show(this.refining, this.#state === "refining");
    show(this.report, isDone);
    show(this.done, isDone || isChosen);
    show(this.box, isDone || isChosen || this.#state === "refining");
  }

  async #load() {
    const [exports, simulation] = await Promise.allSettled([get(paths.of(this.id, "exports")), this.isWhole ? get(paths.of(this.id, "simulation"), this.#query) : null]);
    if (this.#isClosed) return;
    const files = (exports.value?.formats ?? []).map((format) => [format, `exports/${format}`, ENDINGS[format] ?? "txt"]);
    this.files.replaceChildren(...[["result.json", "result", "json"], ...files].map(([name, what, ending]) =>
      h("button", { type: "button", class: "small", onclick: () => this.#download(what, `${this.id}.${ending}`) }, name)));
    if (simulation.value) this.#drawCharts(simulation.value, null);
  }

  /** What was measured is in the result only, which may be large: it is fetched when somebody wants to see it. */
  #addMeasured(simulation) { return this.fault.guard(async () => this.#drawCharts(simulation, await get(paths.of(this.id, "result")))); }
  #download(what, name) { return this.fault.guard(async () => download(name, await getText(paths.of(this.id, what), this.#query))); }

  #drawCharts(simulation, result) {
    const { time, columns } = simulation;
    this.#charts.forEach((chart) => chart.close());
    this.charts.replaceChildren();
    const times = columns[time];
    const states = Object.keys(columns).filter((name) => name !== time && columns[name]?.length === times?.length);
    if (!times || !states.length) return;
    const data = result?.data?.trajectories?.[0];
    const measured = data?.times?.length === undefined ? null : data;
    this.#drawSimulation(time, times, states, columns, measured);
    if (states.length > 1) this.#drawPhase(states, columns, measured);
    if (!result) this.charts.append(h("p", {}, h("button", { type: "button", onclick: () => this.#addMeasured(simulation) }, "Show what was measured as well")));
  }

  #drawSimulation(time, times, states, columns, measured) {
    const chart = this.#keep(new LinesChart("Simulation of the model"));
    const shown = states.slice(0, 6);
    this.charts.append(h("figure", {}, h("figcaption", {}, `Simulation from the first measured state${measured ? ", and what was measured" : ""}.`), chart.box,
      legend(shown.map((name, index) => [cycled(index), name]))));
    const lines = shown.map((name, index) => ({ values: columns[name], colour: cycled(index) }));
    if (!measured) return chart.set(time, "", times, lines);
    const xs = [...new Set([...times, ...measured.times])].sort((a, b) => a - b);
    const on = (ts, values) => {
      const known = new Map(ts.map((t, index) => [t, values[index]]));
      return xs.map((x) => known.get(x) ?? null);
    };
    const points = shown.filter((name) => measured.measured?.[name])
      .map((name) => ({ values: on(measured.times, sparse(measured.measured[name])), colour: cycled(shown.indexOf(name)), isPoints: true }));
    return chart.set(time, "", xs, [...lines.map((line) => ({ ...line, values: on(times, line.values) })), ...points]);
  }

  #drawPhase(states, columns, measured) {
    const chart = this.#keep(new PhaseChart("Phase portrait"));
    const selects = [0, 1].map((index) => {
      const select = h("select", { onchange: () => draw() }, states.map((name) => h("option", { value: name }, name)));
      select.value = states[index];
      return select;
    });
    const draw = () => {
      const [x, y] = selects.map((select) => select.value);
      const trails = [{ xs: columns[x], ys: columns[y], colour: "c0" }];
      if (measured?.measured?.[x] && measured.measured[y]) trails.push({ xs: measured.measured[x], ys: sparse(measured.measured[y]), colour: "c1", isPoints: true });
      chart.set(x, y, trails);
    };
    const axes = h("span", { class: "bar" }, h("label", {}, "across ", selects[0]), h("label", {}, "up ", selects[1]));
    this.charts.append(h("figure", {}, h("figcaption", {}, "Phase portrait"), states.length > 2 ? axes : null, chart.box));
    draw();
  }

  #keep(chart) { this.#charts.push(chart); return chart; }
  /** The report needs the token, which a plain link would not send: it is fetched and shown as a page of its own. */
  async #openReport() {
    this.report.disabled = true;
    const empty = URL.createObjectURL(new Blob([EMPTY_PAGE], { type: "text/html" }));
    const tab = window.open(empty, "_blank"); // at once, or it would count as a pop-up that nobody asked for
    try {
      const text = await this.#fetchReport();
      if (tab && !tab.closed) fillPage(tab, text);
      setText(this.reportSaid, "");
    } catch (error) { tab?.close(); setText(this.reportSaid, error.message); }
    this.report.disabled = false;
  }

  async #fetchReport() {
    setText(this.reportSaid, "A worker makes the report…");
    for (;;) {
      const response = await send(paths.of(this.id, "report"));
      if (response.status !== 202) { announce("The report is ready."); return (await check(response)).text(); }
      const { waits_for: reason } = await response.json();
      if (reason) setText(this.reportSaid, `Waits for ${reason}.`);
      await new Promise((done) => setTimeout(done, ASK_AGAIN));
      if (this.#isClosed) throw new Error("");
    }
  }

  close() { this.#isClosed = true; this.pace.close(); this.#charts.forEach((chart) => chart.close()); }
}

/** A page that we open has our strict policy, under which styles in its text do not count: they become style sheets. */
function fillPage(tab, text) {
  const styles = [];
  const rest = text.replace(/<style[^>]*>(.*?)<\/style>/gis, (_, style) => (styles.push(style), ""));
  const page = new DOMParser().parseFromString(rest, "text/html");
  page.querySelectorAll("style, script, link, base, meta[http-equiv]").forEach((element) => element.remove());
  const sheet = new tab.CSSStyleSheet();
  sheet.replaceSync(styles.join("\n"));
  tab.document.adoptedStyleSheets = [sheet];
  tab.document.documentElement.replaceWith(tab.document.adoptNode(page.documentElement));
}

function taskText({ worker, helpers, compared }) {
  const place = worker ? `on ${worker}${helpers ? `, helped by ${plural(helpers, "worker")}` : ""}` : "waits for a worker";
  return `${compared.toLocaleString()} candidates compared so far; ${place}.`;
}
