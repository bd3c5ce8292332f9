// The islands of a job: one cell for each island, in the colour of its worker, with its epoch and latest event.

import { get, paths } from "./api.js";
import { colourOf } from "./charts.js";
import { perFrame, h, keyed, setClass, setText, show } from "./dom.js";
import { ENDED, plural } from "./format.js";
import { Paced } from "./poll.js";

/** Milliseconds for which a cell shows the latest event of its island. */
const FRESH = 6000;
const PAUSE = 4000;
const MARKS = { placed: "placed", unplaced: "no worker", isolated: "isolated", "worker-lost": "lost", stalled: "waits" };

export class Islands extends Paced {
  #islands = []; #marks = new Map(); #workers = [];
  constructor(id) {
    super(() => this.#read());
    this.id = id;
    this.draw = perFrame(() => this.#draw());
    this.map = h("div", { class: "islands", tabindex: "0", role: "group", "aria-label": "Islands by equation" });
    this.workers = h("ul", { class: "legend" });
    this.summary = h("p", { class: "faint" });
    this.box = h("section", { "aria-label": "Islands", hidden: true }, h("h2", {}, "Islands"), this.summary, this.workers, this.map);
  }

  async #read() { this.#islands = (await get(paths.of(this.id, "islands"))).islands; this.draw(); return PAUSE; }

  update(job) {
    this.isOver = ENDED.includes(job.state);
    const epochs = (job.variables ?? []).map((variable) => variable.epoch).join();
    if (!this.isOver && this.epochs !== epochs) this.soon();
    this.epochs = epochs;
    show(this.box, !this.isOver && this.#islands.length > 0);
  }

  has(worker) { return this.#islands.some((island) => island.worker === worker); }
  /** Marks the cells that an event is about. */
  happened(event) {
    const word = MARKS[event.event];
    if (!word) return;
    const isMeant = (island) =>
      event.event === "worker-lost" ? island.worker === event.worker
        : event.variable === island.variable && (event.island === null || event.island === undefined || event.island === island.island);
    for (const island of this.#islands.filter(isMeant)) this.#mark(keyOf(island), word);
    this.draw();
    this.soon();
  }

  #mark(key, word) {
    this.#marks.set(key, word);
    setTimeout(() => {
      if (this.#marks.get(key) === word) this.#marks.delete(key);
      this.draw();
    }, FRESH);
  }
  /** A worker keeps its letter and colour as long as the page is open. */
  #letter(worker) {
    if (!this.#workers.includes(worker)) this.#workers.push(worker);
    const index = this.#workers.indexOf(worker);
    return { index, letter: index < 26 ? String.fromCharCode(65 + index) : `W${index + 1}` };
  }

  #draw() {
    show(this.box, !this.isOver && this.#islands.length > 0);
    const names = [...new Set(this.#islands.map((island) => island.worker).filter(Boolean))].sort();
    names.forEach((worker) => this.#letter(worker));
    const away = this.#islands.filter((island) => !island.worker).length;
    setText(this.summary, `${plural(this.#islands.length, "island")} on ${plural(names.length, "worker")}${away ? `; ${away} without a worker` : ""}.`);
    keyed(this.workers, names, (worker) => worker, (worker) => {
      const { index, letter } = this.#letter(worker);
      return h("li", {}, h("span", { class: `swatch ${colourOf(index)}`, "aria-hidden": "true" }), `${letter} ${worker}`);
    });
    const variables = [...new Set(this.#islands.map((island) => island.variable))];
    keyed(this.map, variables, (variable) => variable, (variable) => this.#group(variable), (group, variable) => this.#fill(group, variable));
  }

  #group(variable) {
    return h("div", { class: "group" }, h("h3", {}, variable), h("ul", { class: "cells", "aria-label": `Islands of ${variable}` }));
  }

  #fill(group, variable) {
    const islands = this.#islands.filter((island) => island.variable === variable);
    const least = Math.min(...islands.map((island) => island.epoch));
    const ahead = islands.filter((island) => island.epoch > least).length; // the other islands have not received their migrants yet
    setText(group.firstChild, `${variable}${ahead ? ` · migrants of ${plural(ahead, "island")} not received yet` : ""}`);
    keyed(group.lastElementChild, islands, keyOf, () => h("li", {}, h("b"), h("span"), h("small")), (cell, island) => {
      const [name, place, note] = cell.children;
      const worker = island.worker ? this.#letter(island.worker) : null;
      const mark = this.#marks.get(keyOf(island));
      setText(name, `${island.island} ${worker ? worker.letter : "–"}`);
      setText(place, `epoch ${island.epoch}`);
      setText(note, mark ?? (worker ? (island.epoch > least ? "sent" : "computes") : ""));
      setClass(cell, `${worker ? colourOf(worker.index) : "idle"}${mark ? " fresh" : ""}`);
      cell.title = `island ${island.island} of ${variable}: ${island.worker ?? "no worker"}`;
    });
  }
}

function keyOf(island) { return `${island.variable} ${island.island}`; }
