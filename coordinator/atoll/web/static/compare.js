// Two jobs side by side: their equations by variable, their fronts on the same axes, and other differences.

import { get, paths } from "./api.js";
import { FrontChart, colourOf, legend } from "./charts.js";
import { faultBox, h, viewHeading } from "./dom.js";
import { follow } from "./events.js";
import { HAS_RESULT, duration, largestError, number, stateOf } from "./format.js";
import { formula } from "./mathml.js";
import { Paced } from "./poll.js";

export default function open(root, { parameters }, app) {
  return new Comparison(root, [parameters.get("a") ?? "", parameters.get("b") ?? ""]);
}

class Comparison {
  #charts = new Map();
  constructor(root, ids) {
    this.ids = ids;
    this.fault = faultBox();
    [this.jobs, this.equations, this.options, this.data] = Array.from({ length: 4 }, () => h("div", { class: "wide" }));
    root.append(viewHeading("Compare jobs"), this.fault, this.jobs, h("h2", {}, "Equations"), this.equations,
      h("h2", {}, "Options that differ"), this.options, h("h2", {}, "Data that differ"), this.data);
    this.pace = new Paced(() => this.#load());
    follow(ids, { job: () => this.pace.soon() });
    this.again();
  }

  again() { return this.pace.now(); }

  async #load() {
    const all = await this.fault.guard(() => Promise.all(this.ids.map((id) => this.#fetch(id))));
    if (all && !this.isClosed) this.#draw(all);
  }
  /** A job that has not ended has no result yet, and a job that has just begun has no progress. */
  async #fetch(id) {
    const job = await get(paths.job(id));
    const ask = (isThere, what) => (isThere ? get(paths.of(id, what)).catch(() => null) : null);
    const [progress, result] = await Promise.all([ask(job.variables?.length, "progress"), ask(HAS_RESULT.includes(job.state), "result")]);
    return { job, equations: progress?.equations ?? [], result, config: (result ?? progress)?.config, files: progress?.files };
  }

  #draw(all) {
    const jobs = all.map(({ job }) => job);
    const names = jobs.map((job, index) => h("a", { href: `#/jobs/${encodeURIComponent(job.job)}` }, h("span", { class: `swatch ${colourOf(index)}`, "aria-hidden": "true" }), `${job.name} (${job.job})`));
    const facts = [["State", stateOf], ["Largest error", (job) => number(largestError(job))], ["Elapsed", (job) => duration(job.elapsed)], ["Seed", (job) => job.seed], ["Preset", (job) => job.preset]];
    this.jobs.replaceChildren(pairTable("Jobs", names, facts.map(([label, say]) => [label, ...jobs.map(say)])));
    this.#drawEquations(all);
    const plain = jobs.map((job) => job.name);
    const [configs, data] = [all.map(({ config }) => flat(config ?? {})), all.map(dataFacts)];
    this.options.replaceChildren(differences("Options that differ", plain, configs, "(default)"));
    this.data.replaceChildren(differences("Data that differ", plain, data));
  }

  #drawEquations(all) {
    const variables = [...new Set(all.flatMap(({ job, equations }) => [...(job.variables ?? []), ...equations].map((equation) => equation.variable)))];
    for (const variable of variables) {
      const pair = all.map(({ equations }) => equations.find((equation) => equation.variable === variable));
      const place = this.#place(variable, all);
      place.formulas.replaceChildren(...pair.map((equation, index) => h("div", { class: "side" },
        h("p", { class: "faint" }, h("span", { class: `swatch ${colourOf(index)}`, "aria-hidden": "true" }), all[index].job.name),
        h("div", { class: "formula", tabindex: "0", role: "group", "aria-label": `${variable} of ${all[index].job.name}` },
          equation ? formula(equation.mathml, `${equation.lhs} = ${equation.expression}`) : "No equation."), this.#verdict(all[index].job, variable))));
      place.chart.set(pair.map((equation) => equation?.front ?? []));
    }
  }

  #verdict(job, variable) {
    const view = job.variables?.find((one) => one.variable === variable);
    if (!view) return null;
    return h("p", { class: "numbers" }, `error ${number(view.normalized_error)}, complexity ${view.complexity ?? "–"}${view.verdict ? `, ${view.verdict}` : ""}`);
  }

  #place(variable, all) {
    if (!this.#charts.has(variable)) {
      const chart = new FrontChart(`Fronts of ${variable} of both jobs`);
      const formulas = h("div", { class: "pair" });
      this.equations.append(h("article", { class: "equation" }, h("h3", {}, variable), formulas, chart.box, legend(all.map(({ job }, index) => [colourOf(index), job.name]))));
      this.#charts.set(variable, { chart, formulas });
    }
    return this.#charts.get(variable);
  }

  close() {
    this.isClosed = true;
    this.pace.close();
    this.#charts.forEach(({ chart }) => chart.close());
  }
}

function flat(value, prefix = "") {
  if (value === null || typeof value !== "object" || Array.isArray(value)) return prefix ? { [prefix]: JSON.stringify(value) } : {};
  return Object.assign({}, ...Object.entries(value).map(([name, part]) => flat(part, prefix ? `${prefix}.${name}` : name)));
}

function dataFacts({ result, files }) {
  const data = result?.data;
  if (!data) return { files: (files ?? []).join(", "), rows: "known after the end of the job" };
  return { files: (data.files ?? []).join(", "), rows: String(data.rows), "read as": data.read_as, trajectories: String(data.trajectories?.length ?? "–"), sha256: data.digest };
}

function differences(caption, names, [a, b], lacking = null) { // values that are missing in one job are not compared
  const rows = [...new Set([...Object.keys(a), ...Object.keys(b)])].map((key) => [key, a[key] ?? lacking, b[key] ?? lacking])
    .filter(([, one, other]) => one !== other && one !== null && other !== null);
  return rows.length ? pairTable(caption, names, rows) : "None.";
}

function pairTable(caption, names, rows) {
  const heads = ["", ...names].map((name) => (name ? h("th", { scope: "col" }, name) : h("td")));
  return h("table", { class: "sides" }, h("caption", { class: "unseen" }, caption), h("thead", {}, h("tr", {}, heads)),
    h("tbody", {}, rows.map(([label, ...values]) => h("tr", {}, h("th", { scope: "row" }, label), values.map((value) => h("td", {}, String(value)))))));
}
