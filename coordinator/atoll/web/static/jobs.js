// The list of jobs: fetched newest first, sorted and filtered here, and updated by events.

import { get, session } from "./api.js";
import { follow } from "./events.js";
import { perFrame, faultBox, h, keyed, redraw, setClass, setText, show, viewHeading } from "./dom.js";
import { ENDED, duration, elapsed, stamp, largestError, moment, number, plural, short, stateOf } from "./format.js";

const STATES = ["queued", "preparing", "running", "refining", "done", "failed", "cancelled"];
const PAGE = 50;
/** Sortable columns: heading, value for sorting, text of a cell, whether the largest value comes first. */
const COLUMNS = {
  state: { title: "State", value: (job) => STATES.indexOf(job.state) },
  name: { title: "Name", value: (job) => job.name.toLowerCase() },
  equation: { title: "Equation", value: (job) => equations(job).join(), isCode: true },
  error: { title: "Largest error", value: (job) => largestError(job) ?? Infinity, say: (job) => number(largestError(job)), isNumber: true },
  verdict: { title: "Verdicts", value: (job) => verdicts(job).join() },
  progress: { title: "Progress", value: (job) => epochs(job)[1], say: progress, isDown: true },
  owner: { title: "Owner", value: (job) => job.submitter ?? "", say: (job) => job.submitter },
  submitted: { title: "Submitted", value: (job) => job.submitted, say: (job) => moment(job.submitted), isDown: true },
  elapsed: { title: "Elapsed", value: elapsed, say: (job) => duration(elapsed(job)), isNumber: true, isDown: true },
};

export default function open(root, { parameters }, app) { return new Jobs(root, parameters, app); }

class Jobs {
  #jobs = new Map(); #chosen = new Set(); #next = null; #isLoaded = false;
  constructor(root, parameters, app) {
    this.app = app;
    this.filter = parameters.get("state") ?? "";
    this.text = parameters.get("text") ?? "";
    this.sort = Object.hasOwn(COLUMNS, parameters.get("sort")) ? parameters.get("sort") : "submitted";
    this.isDown = parameters.has("down") ? parameters.get("down") === "yes" : Boolean(COLUMNS[this.sort].isDown);
    this.draw = perFrame(() => this.#draw());
    this.#build(root);
    follow("all", { job: (change) => this.#change(change), happened: ({ event }) => event === "deleted" && this.again() });
    this.clock = setInterval(() => document.visibilityState === "visible" && this.draw(), 1000);
    this.again();
  }

  #build(root) {
    this.heading = viewHeading("Jobs");
    this.status = h("p", { class: "faint", role: "status" }, "Loading…");
    this.fault = faultBox();
    this.compare = h("a", { class: "button", hidden: true }, "Compare the two");
    this.body = h("tbody");
    this.table = h("table", { class: "list stacked", hidden: true }, h("caption", { class: "unseen" }, "Jobs"), this.#head(), this.body);
    this.more = h("button", { type: "button", hidden: true, onclick: () => this.#load(this.#next) }, "More jobs");
    this.empty = this.#welcome();
    root.append(this.heading, this.#tools(), this.fault, h("div", { class: "wide" }, this.table), this.empty, h("p", { class: "bar" }, this.more, this.status));
  }

  #tools() {
    const states = [["", "all"], ...STATES.map((state) => [state, state])].map(([value, label]) => h("option", { value }, label));
    this.state = h("select", { value: "", onchange: () => this.#filterBy({ filter: this.state.value }) }, states);
    this.state.value = STATES.includes(this.filter) ? this.filter : "";
    this.search = h("input", { type: "search", value: this.text, oninput: () => this.#filterBy({ text: this.search.value }) });
    this.order = h("select", { onchange: () => this.#sortBy(this.order.value) },
      Object.entries(COLUMNS).map(([name, { title }]) => h("option", { value: name }, title)));
    this.order.value = this.sort;
    return h("div", { class: "tools" },
      h("label", {}, "State ", this.state), h("label", {}, "Text ", this.search),
      h("label", { class: "narrow" }, "Sort by ", this.order), this.compare);
  }

  #head() {
    this.heads = Object.entries(COLUMNS).map(([name, { title, isNumber }]) => {
      const button = h("button", { type: "button", class: "sort", onclick: () => this.#sortBy(name) }, title);
      return h("th", { scope: "col", class: isNumber ? "number" : null, "data-name": name }, button);
    });
    return h("thead", {}, h("tr", {}, h("th", { scope: "col" }, h("span", { class: "unseen" }, "Compare")), this.heads));
  }
  /** Shows the next steps if the service has no jobs. */
  #welcome() {
    const file = h("input", { type: "file", class: "unseen", id: "first-file", multiple: true, onchange: () => this.#take([...file.files]) });
    return h("section", { class: "welcome", hidden: true },
      h("h2", {}, "No jobs yet"),
      h("ol", {},
        h("li", {}, "Drop a data file anywhere on this page, or ", file, h("label", { for: "first-file", class: "button" }, "choose a file"),
          ", such as CSV: one row per time, one column per quantity."),
        h("li", {}, "Start at least one worker, on any machine that can reach the coordinator: ",
          h("code", {}, `island-worker --connect ${session.connect}`)),
        h("li", {}, "No data at hand? ", h("a", { class: "button", href: "#/new?demo=yes" }, "Try the demo data"))));
  }

  #take(files) { this.app.dropped = files; location.hash = "#/new"; }
  again() { return this.#load(null); }

  async #load(cursor) {
    const page = await this.fault.guard(() => get("jobs", { limit: PAGE, cursor, state: this.filter }));
    this.hasFailed = !page;
    if (page && cursor === null) this.#jobs.clear();
    for (const job of page?.jobs ?? []) this.#jobs.set(job.job, stamp(job));
    if (page) [this.#next, this.#isLoaded] = [page.next, true];
    this.draw();
  }

  #change({ job: id, changes, deleted }) {
    const known = this.#jobs.get(id);
    const job = "elapsed" in changes ? stamp({ ...known, ...changes }) : { ...known, ...changes };
    if (deleted || (this.filter && job.state !== this.filter)) this.#jobs.delete(id);
    else if (known || this.#belongs(job)) this.#jobs.set(id, job);
    else return;
    this.draw();
  }
  /** A new job is added to the page unless it is older than all loaded jobs. */
  #belongs(job) {
    if (job.submitted === undefined || !this.#isLoaded) return false;
    const oldest = [...this.#jobs.values()].reduce((least, { submitted }) => (submitted < least ? submitted : least), "~");
    return !this.#next || job.submitted > oldest;
  }

  #filterBy(values) {
    Object.assign(this, values);
    this.#keep();
    return "filter" in values ? this.again() : this.draw();
  }

  #sortBy(name) {
    this.isDown = this.sort === name ? !this.isDown : Boolean(COLUMNS[name].isDown);
    this.sort = name;
    this.order.value = name;
    this.#keep();
    this.draw();
  }
  /** The address contains the filter and the order; a typed letter adds no step to the history. */
  #keep() {
    const kept = new URLSearchParams();
    if (this.filter) kept.set("state", this.filter);
    if (this.text) kept.set("text", this.text);
    if (this.sort !== "submitted" || !this.isDown) kept.set("sort", this.sort);
    if (kept.has("sort")) kept.set("down", this.isDown ? "yes" : "no");
    history.replaceState(null, "", `#/jobs${kept.size ? `?${kept}` : ""}`);
  }

  #visibleJobs() {
    const words = this.text.toLowerCase();
    const { value } = COLUMNS[this.sort];
    const sign = this.isDown ? -1 : 1;
    const isFound = (job) => !words || [job.name, job.job, job.submitter ?? "", job.reason ?? ""].some((text) => text.toLowerCase().includes(words));
    const order = (a, b) => {
      const [x, y] = [value(a), value(b)];
      if (x === y) return a.submitted < b.submitted ? 1 : -1;
      return (x < y ? -1 : 1) * sign;
    };
    return [...this.#jobs.values()].filter(isFound).sort(order);
  }

  #draw() {
    const jobs = this.#visibleJobs();
    const isEmpty = this.#isLoaded && !this.#jobs.size && !this.filter;
    for (const head of this.heads) {
      const order = head.dataset.name === this.sort ? (this.isDown ? "descending" : "ascending") : "none";
      head.setAttribute("aria-sort", order);
    }
    keyed(this.body, jobs, (job) => job.job, (job) => this.#row(job), (row, job) => this.#fill(row, job));
    show(this.table, jobs.length > 0);
    show(this.empty, isEmpty);
    show(this.more, Boolean(this.#next));
    setText(this.status, this.#isLoaded ? (isEmpty ? "" : this.#summary(jobs)) : this.hasFailed ? "" : "Loading…");
    this.#offerComparison();
  }

  #summary(jobs) {
    if (!jobs.length) return "No job matches; change the state or the text.";
    return `${plural(jobs.length, "job")} shown${this.#next ? ", sorted among the loaded jobs" : ""}`;
  }

  #offerComparison() {
    const two = [...this.#chosen].filter((id) => this.#jobs.has(id));
    show(this.compare, two.length === 2);
    if (two.length === 2) this.compare.href = `#/compare?a=${encodeURIComponent(two[0])}&b=${encodeURIComponent(two[1])}`;
    for (const box of this.body.querySelectorAll("input")) box.disabled = two.length === 2 && !box.checked;
  }

  #row(job) {
    const box = h("input", { type: "checkbox", "aria-label": `Compare ${job.name} (${job.job})`, onchange: () => choose() });
    const choose = () => { this.#chosen[box.checked ? "add" : "delete"](job.job); this.draw(); };
    box.checked = this.#chosen.has(job.job);
    const row = h("tr", {}, h("td", { class: "check" }, box));
    row.parts = Object.fromEntries(Object.entries(COLUMNS).map(([name, { title, isNumber, isCode }]) =>
      [name, h("td", { "data-head": title, class: isCode ? "code" : isNumber ? "number" : name === "name" ? "title" : null })]));
    row.parts.name.append(h("a", { href: `#/jobs/${encodeURIComponent(job.job)}` }), " ", h("small", {}, job.job));
    row.parts.state.append(h("span"));
    row.append(...Object.values(row.parts));
    return row;
  }

  #fill({ parts }, job) {
    for (const [name, { say }] of Object.entries(COLUMNS)) if (say) setText(parts[name], say(job));
    const state = parts.state.firstChild;
    setText(state, stateOf(job));
    setClass(state, `state ${stateOf(job)}`);
    state.title = job.reason ?? "";
    setText(parts.name.firstChild, job.name || job.job);
    redraw(parts.equation, equations(job).join("\n"), () => equations(job).map((text) => h("code", { title: text }, text)));
    redraw(parts.verdict, verdicts(job).join(), () => h("span", { class: "verdicts" }, verdicts(job).map((verdict) => h("span", { class: `verdict ${verdict.replace(" ", "-")}` }, verdict))));
  }

  close() { clearInterval(this.clock); }
}

const MOST_EQUATIONS = 3;
/** Returns the first equations of a job in the form of the terminal. */
function equations(job) {
  const known = (job.variables ?? []).filter((variable) => variable.expression);
  const texts = known.slice(0, MOST_EQUATIONS).map(({ lhs, expression }) => `${lhs} = ${short(expression)}`);
  return known.length > MOST_EQUATIONS ? [...texts, `and ${known.length - MOST_EQUATIONS} more`] : texts;
}

function verdicts(job) { return (job.variables ?? []).map((variable) => variable.verdict).filter(Boolean); }
/** Returns the smallest and the largest number of epochs of a job's equations. */
function epochs(job) {
  const all = (job.variables ?? []).map((variable) => variable.epoch);
  return all.length ? [Math.min(...all), Math.max(...all)] : [0, 0];
}

function progress(job) {
  const [least, most] = epochs(job);
  const all = job.variables ?? [];
  if (!ENDED.includes(job.state) && job.tasks?.length) {
    const [{ function: kind, compared, worker }] = job.tasks;
    const work = kind === "refine" ? `${compared.toLocaleString()} candidates compared` : "data are prepared";
    return worker ? work : "waits for a worker";
  }
  if (!all.length) return job.ahead ? `${job.ahead} ahead` : "";
  const found = all.filter((variable) => variable.finished).length;
  const end = ENDED.includes(job.state) || !found ? "" : `, ${found} of ${all.length} finished`;
  return `epoch ${least === most ? most : `${least}–${most}`}${end}`;
}
