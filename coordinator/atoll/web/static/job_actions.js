// Actions on a job.

import { change, paths } from "./api.js";
import { announce, confirmButton, faultBox, h, setText, show } from "./dom.js";
import { ENDED } from "./format.js";

export class Actions {
  constructor(id, app, changed) {
    this.id = id;
    this.app = app;
    this.changed = changed;
    this.#build();
  }

  #build() {
    const button = (label, act) => h("button", { type: "button", onclick: act }, label);
    this.pause = button("Pause", () => this.#post(this.isPaused ? "resume" : "pause"));
    this.cancel = confirmButton("Cancel", "Cancel the job and keep its best equations?", "Yes, cancel it", () => this.#post("cancel"));
    this.retry = button("Retry", () => this.#retry());
    this.share = button("Share", () => this.#do(() => change("PUT", paths.of(this.id, "sharing"), { shared: !this.isShared })));
    this.remove = confirmButton("Delete", "Delete the job with its result and its data?", "Yes, delete it", () => this.#remove());
    this.level = h("input", { type: "number", min: "-10", max: "10", step: "1", value: "0" });
    this.priority = h("form", { class: "inline", onsubmit: (event) => this.#prioritize(event) }, h("label", {}, "Priority ", this.level), h("button", {}, "Set"));
    this.anew = h("a", { class: "button", href: `#/new?from=${encodeURIComponent(this.id)}` }, "Submit again with changes");
    this.fault = faultBox();
    this.note = h("p", { class: "faint", hidden: true }, "You can only read. To change something, open the address with the token that ",
      h("code", {}, "coordinator web"), " prints.");
    this.bar = h("div", { class: "bar" }, this.pause, this.cancel, this.retry, this.priority, this.share, this.anew, this.remove);
    this.box = h("section", { class: "actions", "aria-label": "Actions" }, this.bar, this.note, this.fault);
  }

  update(job, mayWrite) {
    const isOver = ENDED.includes(job.state);
    this.isPaused = job.paused;
    this.isShared = job.shared;
    setText(this.pause, job.paused ? "Resume" : "Pause");
    setText(this.share, job.shared ? "Make private" : "Share");
    const isBroken = job.state === "failed" || job.state === "cancelled";
    const shown = [[this.bar, mayWrite], [this.note, !mayWrite], [this.pause, !isOver], [this.cancel, !isOver], [this.priority, !isOver], [this.retry, isBroken], [this.remove, isOver]];
    for (const [element, isShown] of shown) show(element, isShown);
    if (document.activeElement !== this.level) this.level.value = job.priority;
    if (this.bar.contains(document.activeElement) && !document.activeElement.checkVisibility()) this.anew.focus(); // its button is gone
  }

  #post(what) { return this.#do(() => change("POST", paths.of(this.id, what))); }

  #prioritize(event) {
    event.preventDefault();
    return this.#do(() => change("PUT", paths.of(this.id, "priority"), { priority: Number(this.level.value) }));
  }

  async #retry() {
    const job = await this.#do(() => change("POST", paths.of(this.id, "retry")), false);
    if (job) location.hash = `#/jobs/${encodeURIComponent(job.job)}`;
  }

  async #remove() { if ((await this.#do(() => change("DELETE", paths.job(this.id)), false)) !== undefined) location.hash = "#/jobs"; }
  /** Runs an action; after an error, shows the reason and returns undefined. */
  async #do(act, isAboutUs = true) {
    const job = await this.fault.guard(act);
    if (job && isAboutUs) this.changed(job);
    if (job !== undefined) announce("Done.");
    return job;
  }
}
