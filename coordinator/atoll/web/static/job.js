// One job: its description, its improving equations, its islands, and its event log.

import { get, paths, session } from "./api.js";
import { follow } from "./events.js";
import { announce, facts, foldWhen, folding, perFrame, faultBox, h, redraw, setClass, setText, show, viewHeading } from "./dom.js";
import { ENDED, HAS_RESULT, count, duration, elapsed, stamp, moment, plural, stateOf } from "./format.js";
import { Actions } from "./job_actions.js";
import { EquationCard } from "./job_equation.js";
import { Islands } from "./job_islands.js";
import { Log } from "./job_log.js";
import { Outcome } from "./job_outcome.js";
import { Progress } from "./job_progress.js";

export default function open(root, { id }, app) { return new JobPage(root, id, app); }

class JobPage {
  #job = null; #cards = new Map(); #isClosed = false;
  constructor(root, id, app) {
    this.id = id;
    this.app = app;
    this.draw = perFrame(() => this.#draw());
    this.actions = new Actions(id, app, (job) => this.#merge(job));
    this.progress = new Progress(id, (progress) => this.#showProgress(progress));
    this.islands = new Islands(id);
    this.log = new Log(id);
    this.outcome = new Outcome(id);
    this.#build(root);
    this.clock = setInterval(() => this.#job && document.visibilityState === "visible" && this.draw(), 1000);
    follow([id], { job: (change) => this.#change(change), happened: (event) => this.#happened(event) });
    this.again();
  }

  #build(root) {
    this.heading = viewHeading(`Job ${this.id}`);
    this.state = h("span", { class: "state" });
    this.reason = h("p", { class: "reason" });
    this.notes = h("ul", { class: "notes" });
    this.facts = h("div");
    this.fault = faultBox();
    this.equations = h("div", { class: "equations" }, h("p", { class: "faint" }, "No equations yet."));
    this.about = folding("About this job", this.facts);
    this.body = h("div", { hidden: true },
      this.reason, this.outcome.conclusion, this.notes, this.outcome.refining, this.actions.box,
      h("section", { "aria-label": "Equations" }, h("h2", {}, "Equations"), this.equations),
      this.outcome.pictures, this.outcome.downloads, this.outcome.remarks,
      this.islands.box, h("section", { "aria-label": "Job" }, h("h2", {}, "Job"), this.about, this.log.events));
    root.append(h("p", { class: "crumb" }, h("a", { href: "#/jobs" }, "Jobs")), h("div", { class: "head" }, this.heading, this.state), this.fault, this.body);
  }

  async again() {
    const job = await this.fault.guard(() => get(paths.job(this.id)));
    if (!job) return;
    this.#merge(job);
    if (this.#job.variables?.length) this.progress.now(); // there are no equations while data are prepared
    if (!ENDED.includes(this.#job.state)) this.islands.now();
    this.log.fetch().catch(() => {}); // the banner shows that the service does not answer
  }

  #change({ changes, deleted }) {
    if (deleted) {
      announce("The job is deleted.");
      location.hash = "#/jobs";
    } else if (this.#job || changes?.job) {
      this.#merge(changes);
      if (changes.variables?.length) this.progress.soon();
      if (changes.workers !== undefined) this.islands.soon();
    }
  }

  #happened(event) {
    if (event.job !== this.id && !(event.worker && this.islands.has(event.worker))) return;
    this.log.add([event]);
    this.islands.happened(event);
  }

  #merge(changes) {
    const before = this.#job && stateOf(this.#job);
    this.#job = "elapsed" in changes ? stamp({ ...this.#job, ...changes }) : { ...this.#job, ...changes };
    const after = stateOf(this.#job);
    if (before && before !== after) {
      announce(`The job is ${after}.`);
      if (this.#job.variables?.length) this.progress.soon();
    }
    this.draw();
  }

  #draw() {
    if (this.#isClosed) return;
    const job = this.#job;
    const state = stateOf(job);
    show(this.body, true);
    setText(this.heading, job.name || job.job);
    this.app.title(`${job.name || job.job}: ${state}`);
    setText(this.state, state);
    setClass(this.state, `state ${state}`);
    setText(this.reason, job.reason ?? "");
    show(this.reason, Boolean(job.reason));
    this.#drawNotes(job);
    this.#drawFacts(job);
    this.actions.update(job, session.may_write);
    foldWhen(this.about, HAS_RESULT.includes(job.state));
    foldWhen(this.log.events, HAS_RESULT.includes(job.state));
    for (const variable of job.variables ?? []) this.#card(variable.variable).update(variable, job);
    this.outcome.update(job);
    this.islands.update(job);
  }
  /** Returns the messages that the user should read before trusting the result or waiting. */
  #drawNotes(job) {
    const isGoing = !ENDED.includes(job.state);
    const notes = [
      ...(job.stalls ?? []).map((text) => ["bad", "No progress", text]),
      ...(isGoing ? job.warnings ?? [] : []).map((text) => ((job.notes ?? []).includes(text) ? ["", "Note", text] : ["doubtful", "Warning", text])), // for a result they are shown below
      ...(isGoing && job.ahead ? [["", "Waits", `${plural(job.ahead, "job")} before it in the queue.`]] : []),
      ...(isGoing && job.held && !job.paused ? [["", "Waits", "It has begun, and waits for its user's next turn."]] : []),
      ...(job.state === "running" && job.workers === 0 && !job.reason ? [["doubtful", "Waits", "No worker computes it now."]] : []),
    ];
    redraw(this.notes, JSON.stringify(notes), () => notes.map(([severity, label, text]) => h("li", { class: severity }, h("b", {}, `${label}: `), text)));
  }

  #drawFacts(job) {
    const rate = job.point_evaluations_per_second;
    const pairs = [
      ["Job", job.job],
      ["Submitted", moment(job.submitted)], ["Owner", job.submitter ?? "–"], ["Elapsed", duration(elapsed(job))],
      ["Workers", ENDED.includes(job.state) ? null : String(job.workers)], ["Points evaluated", count(job.point_evaluations)],
      ["Points per second", rate && !ENDED.includes(job.state) ? count(rate) : null],
      ["Seed", String(job.seed)], ["Preset", job.preset], ["Priority", String(job.priority)],
      ["Workers lost", job.counters?.deaths ? String(job.counters.deaths) : null],
      ["Time spent waiting for migrants", job.counters?.waited_s ? duration(job.counters.waited_s) : null],
    ];
    redraw(this.facts, pairs.join(), () => facts(pairs));
  }

  #showProgress(progress) {
    if (this.#isClosed) return;
    this.outcome.show(progress);
    for (const equation of progress.equations) this.#card(equation.variable).show(equation);
  }

  #card(variable) {
    if (!this.#cards.has(variable)) {
      if (!this.#cards.size) this.equations.replaceChildren();
      const card = new EquationCard(variable, (index) => this.outcome.choose(variable, index));
      this.#cards.set(variable, card);
      this.equations.append(card.box);
    }
    return this.#cards.get(variable);
  }

  close() {
    this.#isClosed = true;
    clearInterval(this.clock);
    this.progress.close();
    this.islands.close();
    this.outcome.close();
    this.#cards.forEach((card) => card.close());
  }
}
