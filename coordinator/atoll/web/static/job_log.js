// The event log of a job, newest first: events that may need an action are highlighted.

import { get, paths } from "./api.js";
import { folding, perFrame, h, keyed, show } from "./dom.js";
import { clock } from "./format.js";

const MOST = 300;
const PAGE = 200;
const BAD = new Set(["failed", "broken", "isolated", "worker-lost"]);
const DOUBTFUL = new Set(["stalled", "unplaced", "refused", "cancelled"]);
/** Kinds of frequent events; the charts show their contents. */
const ROUTINE = new Set(["commit", "log", "placed"]);

export class Log {
  #events = new Map(); #last = 0;
  constructor(id) {
    this.id = id;
    this.draw = perFrame(() => this.#draw()); // there may be hundreds of events
    this.all = h("input", { type: "checkbox", onchange: () => this.draw() });
    this.list = h("ol", { class: "log", reversed: true });
    this.none = h("p", { class: "faint" }, "No events yet.");
    this.events = folding("Event log", h("p", {}, h("label", {}, this.all, " all events, also checkpoints and lines of workers")), this.none, h("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "Events, newest first" }, this.list));
  }
  /** Fetches the events after the last known event, page by page. */
  async fetch() {
    for (;;) {
      const { events } = await get(paths.of(this.id, "logs"), { after: this.#last, limit: PAGE, of_workers: "false" });
      this.add(events);
      if (events.length < PAGE) return;
    }
  }

  add(events) {
    for (const event of events) { this.#events.set(event.number, event); this.#last = Math.max(this.#last, event.number); }
    if (events.length) this.draw();
  }

  #draw() {
    const isShown = (event) => this.all.checked || !ROUTINE.has(event.event);
    const shown = [...this.#events.values()].filter(isShown).sort((a, b) => b.number - a.number).slice(0, MOST);
    if (this.#events.size > 4 * MOST) this.#events = new Map([...this.#events].sort(([a], [b]) => a - b).slice(-2 * MOST));
    show(this.none, !shown.length);
    keyed(this.list, shown, (event) => event.number, line);
  }
}

function line(event) {
  const severity = BAD.has(event.event) ? "bad" : DOUBTFUL.has(event.event) || event.details?.level === "warning" ? "doubtful" : "";
  const about = [event.variable, event.island === null || event.island === undefined ? null : `island ${event.island}`,
    event.epoch === null || event.epoch === undefined ? null : `epoch ${event.epoch}`, event.worker].filter(Boolean).join(", ");
  return h("li", { class: severity },
    h("time", { datetime: event.time }, clock(event.time)), h("span", { class: "kind" }, event.event),
    h("span", {}, event.text, about ? h("small", { class: "faint" }, ` (${about})`) : null));
}
