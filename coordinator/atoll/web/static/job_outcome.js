// The outcome of a job: conclusion, measured and simulated curves, report and files to download.

import { check, get, getText, paths, send } from "./api.js";
import { TrailsChart, colourOf, legend } from "./charts.js";
import { HAS_RESULT, plural } from "./format.js";
import { announce, download, faultBox, h, redraw, setText, show } from "./dom.js";
import { Paced } from "./poll.js";

const ASK_AGAIN = 1000;
const MOST_STATES = 6;
const EMPTY_PAGE = "<!doctype html><meta charset=utf-8><title>Report</title><p>A worker is writing the report…</p>";
const ENDINGS = { python: "py", c: "c", julia: "jl", matlab: "m", modelica: "mo", sbml: "xml", petab: "txt", xppaut: "ode", latex: "tex", sympy: "py", csv: "csv", json: "json" };

export class Outcome {
  #state = null; #charts = []; #isClosed = false; #picks = {};
  constructor(id) {
    this.id = id;
    this.pace = new Paced(() => this.#load());
    this.tasks = h("p", { class: "faint" });
    this.refining = h("div", { class: "refining", hidden: true }, h("p", {}, "Refining: constants are fitted to the whole trajectories, candidates are compared, errors are estimated."),
      h("progress", { "aria-label": "Refining" }), this.tasks);
    this.conclusion = h("p", { class: "lead", hidden: true });
    this.report = h("button", { type: "button", class: "primary", onclick: () => this.#openReport() }, "Open the report");
    this.reportStatus = h("span", { class: "faint", role: "status" });
    this.files = h("span", { class: "bar" });
    this.fault = faultBox();
    this.caption = h("p", { class: "faint" });
    this.charts = h("div", { class: "pair" });
    this.label = h("p", { class: "label" }, "Download");
    this.pictures = h("section", { "aria-label": "Measured and simulated", hidden: true }, h("h2", {}, "Measured and simulated"), this.caption, this.charts);
    this.downloads = h("section", { "aria-label": "Report and downloads", hidden: true }, h("h2", {}, "Report and downloads"),
      h("div", { class: "bar" }, this.report, this.reportStatus), this.label, this.files, this.fault);
    this.remarks = h("section", { "aria-label": "Remarks", hidden: true });
  }

  update(job) {
    setText(this.tasks, (job.tasks ?? []).map(taskText).join(" "));
    this.isWhole = (job.variables ?? []).every((variable) => variable.expression);
    if (job.state === this.#state) return;
    this.#state = job.state;
    if (this.#isDone) this.pace.now();
    this.#show();
  }

  /** Shows the progress of the whole result. */
  show({ conclusion, warnings, notes }) {
    setText(this.conclusion, conclusion);
    const lists = [["Warnings", warnings ?? []], ["Notes", notes ?? []]].filter(([, texts]) => texts.length);
    redraw(this.remarks, JSON.stringify(lists), () => lists.flatMap(([title, texts]) => [h("h2", {}, title), h("ul", {}, texts.map((text) => h("li", {}, text)))]));
    this.#show();
  }

  /** Exports and the simulation use the chosen equation of a front, also while the job runs. */
  choose(variable, index) { if (this.#picks[variable] !== index) { this.#picks[variable] = index; this.pace.soon(); this.#show(); } }
  get #query() { return { pick: Object.entries(this.#picks).map((pair) => pair.join("=")) }; }
  get #isDone() { return HAS_RESULT.includes(this.#state); }
  get #isChosen() { return Object.keys(this.#picks).length > 0; }
  #show() {
    setText(this.label, this.#isChosen ? "Download, with the chosen equations" : "Download");
    show(this.refining, this.#state === "refining");
    show(this.report, this.#isDone);
    show(this.downloads, this.#isDone || this.#isChosen);
    show(this.conclusion, this.#isDone && Boolean(this.conclusion.textContent));
    show(this.remarks, this.#isDone && this.remarks.childElementCount > 0);
  }

  async #load() {
    const [exports, simulation] = await Promise.allSettled([get(paths.of(this.id, "exports")), this.isWhole ? get(paths.of(this.id, "simulation"), this.#query) : null]);
    if (this.#isClosed) return;
    const files = (exports.value?.formats ?? []).map((format) => [format, `exports/${format}`, ENDINGS[format] ?? "txt"]);
    this.files.replaceChildren(...[["result.json", "result", "json"], ...files].map(([name, what, ending]) =>
      h("button", { type: "button", class: "small", onclick: () => this.#download(what, `${this.id}.${ending}`) }, name)));
    if (simulation.value) this.#drawCharts(simulation.value);
  }

  #download(what, name) { return this.fault.guard(async () => download(name, await getText(paths.of(this.id, what), this.#query))); }

  #drawCharts(simulation) {
    const { time, trajectories, fitted, message } = simulation;
    this.#charts.forEach((chart) => chart.close());
    this.#charts = [];
    this.charts.replaceChildren();
    show(this.pictures, Boolean(trajectories.length || fitted || message));
    if (fitted) this.#drawFitted(fitted);
    else if (trajectories.length) this.#drawTrajectories(simulation);
    else setText(this.caption, message);
    if (!time || !trajectories.length) return;
    const states = Object.keys(trajectories[0].values);
    if (states.length > 1) this.#drawPhase(states, simulation);
  }

  #drawTrajectories({ time, trajectories, labels, trajectories_in_total: total }) {
    const [states, label] = [Object.keys(trajectories[0].values), (name) => labels[name] ?? name];
    setText(this.caption, captionOf(trajectories, total, states.length));
    for (const state of states.slice(0, MOST_STATES)) {
      const chart = this.#keep(new TrailsChart(`${state} over ${time}, measured and simulated`));
      this.charts.append(h("figure", {}, h("figcaption", {}, label(state)), chart.box, legendOf(trajectories)));
      chart.set(label(time), label(state), trajectories.flatMap((part, index) => [
        { xs: part.measured_times, ys: part.measured[state] ?? [], colour: colourOf(index), isPoints: true },
        { xs: part.times, ys: part.values[state], colour: colourOf(index), low: part.lower?.[state], high: part.upper?.[state] }]));
    }
  }

  #drawFitted({ target, measured, fitted }) {
    setText(this.caption, "Dots: fitted values over measured values; on the line both are equal.");
    const chart = this.#keep(new TrailsChart(`${target}, fitted over measured`));
    this.charts.append(h("figure", {}, h("figcaption", {}, target), chart.box));
    const known = measured.filter((value) => value !== null);
    const ends = known.length ? [Math.min(...known), Math.max(...known)] : [];
    chart.set("measured", "fitted", [{ xs: ends, ys: ends, colour: "edge" }, { xs: measured, ys: fitted, colour: "c0", isPoints: true }]);
  }

  #drawPhase(states, { trajectories, labels }) {
    const chart = this.#keep(new TrailsChart("Phase portrait"));
    const selects = [0, 1].map((index) => {
      const select = h("select", { onchange: () => draw() }, states.map((name) => h("option", { value: name }, name)));
      select.value = states[index];
      return select;
    });
    const draw = () => {
      const [x, y] = selects.map((select) => select.value);
      chart.set(labels[x] ?? x, labels[y] ?? y, trajectories.flatMap((part, index) => [
        { xs: part.measured[x] ?? [], ys: part.measured[y] ?? [], colour: colourOf(index), isPoints: true },
        { xs: part.values[x], ys: part.values[y], colour: colourOf(index) }]));
    };
    const axes = h("span", { class: "bar" }, h("label", {}, "across ", selects[0]), h("label", {}, "up ", selects[1]));
    this.charts.append(h("figure", {}, h("figcaption", {}, "Phase portrait"), states.length > 2 ? axes : null, chart.box, legendOf(trajectories)));
    draw();
  }

  #keep(chart) { this.#charts.push(chart); return chart; }
  /** Fetches the report and shows it in a new tab, because a plain link would not send the token. */
  async #openReport() {
    this.report.disabled = true;
    const empty = URL.createObjectURL(new Blob([EMPTY_PAGE], { type: "text/html" }));
    const tab = window.open(empty, "_blank"); // opened at once, otherwise browsers would block it as a pop-up
    try {
      const text = await this.#fetchReport();
      if (tab && !tab.closed) fillPage(tab, text);
      setText(this.reportStatus, "");
    } catch (error) { tab?.close(); setText(this.reportStatus, error.message); }
    this.report.disabled = false;
  }

  async #fetchReport() {
    setText(this.reportStatus, "A worker is writing the report…");
    for (;;) {
      const response = await send(paths.of(this.id, "report"));
      if (response.status !== 202) { announce("The report is ready."); return (await check(response)).text(); }
      const { waits_for: reason } = await response.json();
      if (reason) setText(this.reportStatus, `Waits for ${reason}.`);
      await new Promise((done) => setTimeout(done, ASK_AGAIN));
      if (this.#isClosed) throw new Error("");
    }
  }

  close() { this.#isClosed = true; this.pace.close(); this.#charts.forEach((chart) => chart.close()); }
}

/** Returns a caption for lines and dots, and says whether each line starts from one initial state. */
function captionOf(trajectories, total, states) {
  const isWhole = trajectories.every(({ pieces }) => pieces === 1);
  const isInPieces = trajectories.some(({ pieces }) => pieces > 1);
  const start = isWhole ? (trajectories.length > 1 ? ", each from one initial state" : ", from one initial state") : isInPieces ? ", in pieces with separate initial states" : "";
  const band = trajectories.some(({ lower }) => lower) ? "; bands are 95 % bands" : "";
  const some = total > trajectories.length ? ` ${trajectories.length} of ${total} trajectories are drawn, in the order of increasing R².` : "";
  const few = states > MOST_STATES ? ` The first ${MOST_STATES} of ${states} states are drawn; the report has all states.` : "";
  return `Dots are measured, lines simulated by the model${start}${band}.${some}${few}`;
}

function legendOf(trajectories) {
  return trajectories.length > 1 ? legend(trajectories.map(({ name, held_out: out }, index) => [colourOf(index), `${name}${out ? ", held out" : ""}`])) : null;
}

/** The new tab has our strict policy, which ignores styles in its text, so they become style sheets. */
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
