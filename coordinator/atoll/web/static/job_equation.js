// One equation of a job: its current form, the front of complexity against error, the convergence of the islands.

import { ConvergenceChart, FrontChart, colourOf, errorOf, legend, sayPoint, makeSteerable } from "./charts.js";
import { foldWhen, folding, perFrame, h, keyed, redraw, setClass, setText, show } from "./dom.js";
import { formula } from "./mathml.js";
import { ENDED, count, number, short } from "./format.js";

const WHY = {
  target: "found: its error is below the target", law: "found: an exact law", stagnation: "ended: no more improvement",
  "max-epochs": "ended: all epochs are done", "max-time": "ended: time limit", cancelled: "ended: cancelled", known: "given, not searched",
};

export class EquationCard {
  #equation = null; #chosen = null;
  constructor(variable, pick) {
    Object.assign(this, { variable, pick });
    this.draw = perFrame(() => this.#draw());
    this.#build();
  }

  #build() {
    this.title = h("h3", {}, this.variable);
    this.verdict = h("span", { class: "verdict", hidden: true });
    this.now = h("div", { class: "formula", tabindex: "0", role: "group", "aria-label": `Equation of ${this.variable}` }, "No equation yet.");
    this.facts = h("p", { class: "faint numbers" });
    this.given = h("ul", { class: "numbers", hidden: true, "aria-label": `Given side of ${this.variable}` });
    this.constants = h("p", { class: "numbers" });
    this.checks = h("div", { class: "reason", hidden: true });
    this.candidates = h("div");
    this.front = new FrontChart(`Front of ${this.variable}`, (index) => this.#choose(index));
    this.curves = new ConvergenceChart(`Errors of the islands of ${this.variable} over generations`);
    this.picked = h("p", { class: "faint numbers" });
    this.pickedFormula = h("div", { class: "formula", tabindex: "0", role: "group", "aria-label": `Chosen equation of ${this.variable}` });
    this.islands = h("div");
    this.rows = h("tbody");
    this.mark = makeSteerable(this.front.box, `Front of ${this.variable}: choose an equation`, {
      count: () => this.#points.length, at: () => this.#index, choose: (index) => this.#choose(index), say: () => sayPoint(this.#points[this.#index]),
    });
    this.pictures = h("div", { class: "pair" },
      h("figure", {}, h("figcaption", {}, "Front: the smallest error for each complexity; a ring marks the equation above, if it is on the front. Click a point, or use arrow keys."), this.front.box, this.picked, this.pickedFormula),
      h("figure", {}, h("figcaption", {}, "Convergence: the error of each island over generations."), this.curves.box, this.islands));
    this.search = folding("Candidates, front and convergence", this.candidates, this.pictures, this.#table());
    this.search.hidden = true;
    this.box = h("article", { class: "equation", "aria-label": `Equation of ${this.variable}` },
      h("div", { class: "head" }, this.title, this.verdict), this.now, this.given, this.constants, this.facts, this.checks, this.search);
  }

  #table() {
    const heads = ["Complexity", "Error", "Equation"].map((text, index) => h("th", { scope: "col", class: index < 2 ? "number" : null }, text));
    const table = h("table", {}, h("caption", { class: "unseen" }, `Front of ${this.variable}`), h("thead", {}, h("tr", {}, heads)), this.rows);
    return h("details", {}, h("summary", {}, "The front as a table"), h("div", { class: "wide", tabindex: "0", role: "group", "aria-label": `Front of ${this.variable} as a table` }, table));
  }
  /** Shows the job's view of this equation. */
  update(view, job) {
    foldWhen(this.search, ENDED.includes(job.state));
    setText(this.title, view.lhs || view.variable);
    show(this.verdict, Boolean(view.verdict));
    setText(this.verdict, view.verdict ?? "");
    setClass(this.verdict, `verdict ${(view.verdict ?? "").replace(" ", "-")}`);
    const state = view.why ? WHY[view.why] : job.state === "running" ? "searched" : "";
    const target = job.target_error ? ` (target ${number(job.target_error)})` : "";
    const parts = [
      `error ${number(view.normalized_error)}${target}`, view.complexity === null ? null : `complexity ${view.complexity}`,
      `epoch ${view.epoch}`, `${count(view.point_evaluations)} points`, view.converged ? "islands agree" : null, state,
    ];
    setText(this.facts, parts.filter(Boolean).join(" · "));
    if (!this.#equation && view.expression) setText(this.now, `${view.lhs} = ${short(view.expression)}`);
  }
  /** Shows an equation of the progress. */
  show(equation) { this.#equation = equation; this.#tell(); this.draw(); }
  get #points() { return this.#equation?.front ?? []; }
  /** The index of the chosen point, which stays chosen while the front grows. Without a choice, it is the index of the equation above, or -1 if this equation is not on the front. */
  get #index() {
    const find = (isMeant) => this.#points.findIndex(isMeant);
    const chosen = this.#chosen === null ? -1 : find((point) => point.complexity === this.#chosen);
    return chosen >= 0 ? chosen : find((point) => point.selected);
  }

  #choose(index) { this.#chosen = this.#points[index]?.complexity ?? null; this.#tell(); this.draw(); }
  #tell() { if (this.#chosen !== null) this.pick(this.#index); } // its index changes when the front grows

  #draw() {
    const { lhs, expression, mathml, given, constants, convergence, plateau, reason, checks, candidates } = this.#equation;
    show(this.given, Boolean(given));
    redraw(this.given, JSON.stringify(given), () => (given ?? []).map((line) => h("li", {}, line)));
    setText(this.constants, constants ? `Constants: ${constants}` : "");
    show(this.constants, Boolean(constants));
    show(this.checks, Boolean(reason));
    redraw(this.checks, JSON.stringify([reason, checks]), () => [h("p", {}, reason ?? ""), ...checkLists(checks ?? [])]);
    redraw(this.candidates, JSON.stringify(candidates), () => candidateTable(this.variable, candidates ?? []));
    redraw(this.now, `${mathml} ${expression}`, () => formula(mathml, `${lhs} = ${expression ?? "…"}`));
    show(this.search, this.#points.length > 0 || candidates?.length > 0);
    this.front.set([this.#points], this.#index >= 0 ? this.#index : null);
    this.curves.set(convergence ?? [], plateau);
    this.#drawLegend(convergence ?? []);
    this.#drawPicked(this.#points[this.#index]);
    this.#drawTable();
    this.mark();
  }

  #drawLegend(curves) {
    const names = curves.map((curve) => (typeof curve.island === "number" ? `island ${curve.island}` : String(curve.island)));
    redraw(this.islands, names.join(), () => legend(names.map((name, index) => [colourOf(index), name])));
  }

  #drawPicked(point) {
    const isChosen = this.#chosen !== null && point; // otherwise the point is the equation above
    setText(this.picked, isChosen ? `chosen: complexity ${point.complexity} · error ${number(errorOf(point), 4)}` : "");
    redraw(this.pickedFormula, isChosen ? point.mathml ?? point.expression : "", () => (isChosen ? formula(point.mathml, point.expression) : []));
  }

  #drawTable() {
    const points = this.#points;
    const chosen = this.#index;
    keyed(this.rows, points.map((point, index) => ({ point, index })), ({ point }) => point.complexity,
      ({ point }) => {
        const button = h("button", { type: "button", class: "link" });
        button.addEventListener("click", () => this.#choose(this.#points.findIndex(({ complexity }) => complexity === point.complexity)));
        return h("tr", {}, h("td", { class: "number" }), h("td", { class: "number" }), h("td", {}, button));
      },
      (row, { point, index }) => {
        const [complexity, error, expression] = row.children;
        setText(complexity, point.complexity);
        setText(error, number(errorOf(point), 4));
        setText(expression.firstChild, point.expression);
        setClass(row, index === chosen ? "chosen" : "");
        expression.firstChild.setAttribute("aria-pressed", String(index === chosen));
      });
  }

  close() { this.front.close(); this.curves.close(); }
}

/** Returns the number of passed checks, a list of the failed checks and of those not made, and the other checks collapsed. */
function checkLists(checks) {
  if (!checks.length) return [];
  const isOpen = ({ outcome }) => outcome === "failed" || outcome === "not made";
  const [missed, others] = [checks.filter(isOpen), checks.filter((check) => !isOpen(check))];
  const passed = others.filter(({ outcome }) => outcome === "passed").length;
  return [h("p", {}, `${passed} of ${passed + missed.length} checks passed${missed.length ? ":" : "."}`),
    missed.length ? h("ul", {}, checkItems(missed)) : null,
    others.length ? h("details", {}, h("summary", {}, "The other checks"), h("ul", {}, checkItems(others))) : null].filter(Boolean);
}

/** Returns an item for each reason; checks with the same reason are listed together. */
function checkItems(checks) {
  const groups = new Map();
  for (const { name, outcome, reason } of checks) {
    const key = JSON.stringify([outcome, reason]);
    groups.set(key, { outcome, reason, names: [...groups.get(key)?.names ?? [], name] });
  }
  return [...groups.values()].map(({ outcome, reason, names }) => h("li", {}, h("b", {}, `${names.join(", ")}: ${outcome}.`), ` ${reason}`));
}

/** Returns the equations that were compared with the equation above, by Δ description length. */
function candidateTable(variable, candidates) {
  if (candidates.length < 2) return [];
  const isHeldOut = candidates.some((candidate) => candidate.held_out_r2 !== null);
  const heads = ["Δ description length", "R²", ...(isHeldOut ? ["Held-out R²"] : []), "Complexity", "Origin", "Equation"];
  const rows = candidates.map((candidate) => [candidate.selected ? "shown" : candidate.nats === null ? "?" : candidate.nats.toFixed(1), candidate.r2,
    ...(isHeldOut ? [candidate.held_out_r2 ?? ""] : []), candidate.complexity, candidate.origin ?? "", h("code", {}, candidate.expression)]);
  const cell = (value, index) => h("td", { class: index < heads.length - 2 ? "number" : null }, value ?? "");
  return [h("h4", {}, "Candidates"), h("p", { class: "faint" }, "Δ description length: the description length with another equation minus the description length with the equation above, in nats. Below about 3 the data hardly decide."),
    h("div", { class: "wide", tabindex: "0", role: "group", "aria-label": `Candidates of ${variable}` }, h("table", {}, h("caption", { class: "unseen" }, `Candidates of ${variable}`),
      h("thead", {}, h("tr", {}, heads.map((head, index) => h("th", { scope: "col", class: index < heads.length - 2 ? "number" : null }, head)))),
      h("tbody", {}, rows.map((row, index) => h("tr", { class: candidates[index].selected ? "chosen" : null }, row.map(cell))))))];
}
