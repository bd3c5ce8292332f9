// The workers: their jobs and resources, whether they get new work, and the times when workers joined and left.

import { change, get, session } from "./api.js";
import { follow } from "./events.js";
import { faultBox, h, keyed, redraw, setClass, setText, show, viewHeading } from "./dom.js";
import { bytes, duration, moment, plural } from "./format.js";
import { Poll } from "./poll.js";

const COLUMNS = ["Worker", "Host", "State", "Doing", "Islands", "Load", "CPU", "Memory", "Received", "Sent", "Version", "Joined", "Service"];
const NUMBERS = new Set(["Islands", "Load", "CPU", "Memory", "Received", "Sent", "Joined"]);
const SERVICES = { open: [["Cordon", "cordoned"], ["Drain", "draining"]], cordoned: [["Uncordon", "open"], ["Drain", "draining"]], draining: [["Uncordon", "open"]] };
const SILENT = 5;
const HISTORY = new Set(["worker-joined", "worker-lost", "worker-back", "refused"]);
const MOST_EVENTS = 50;

export default function open(root, _place, app) {
  const summary = h("p", { class: "faint" }, "Loading…");
  const fault = faultBox();
  const body = h("tbody");
  const heads = COLUMNS.map((head) => h("th", { scope: "col", class: NUMBERS.has(head) ? "number" : null }, head));
  const table = h("table", { class: "list stacked", hidden: true }, h("caption", { class: "unseen" }, "Workers"), h("thead", {}, h("tr", {}, heads)), body);
  const none = h("p", { hidden: true }, "Start a worker on any machine that can reach the coordinator: ", h("code", {}, `island-worker --connect ${session.connect}`));
  const history = new History();
  root.append(viewHeading("Workers"), summary, fault, h("div", { class: "wide" }, table), none, history.box);
  const loads = new Loads();
  const poll = new Poll("workers", app, ({ workers }) => {
    const alive = workers.filter((worker) => worker.state !== "lost").length;
    setText(summary, workers.length ? `${plural(alive, "worker")}${workers.length > alive ? `, ${workers.length - alive} lost` : ""}.` : "No workers yet.");
    show(table, workers.length > 0);
    show(none, !alive);
    keyed(body, workers, (worker) => worker.worker, () => row(serve), (made, worker) => fill(made, worker, loads.of(worker)));
  }, (sentence) => setText(summary, sentence));
  async function serve(worker, service) {
    await fault.guard(() => change("PUT", `workers/${encodeURIComponent(worker)}/service`, { service }));
    poll.again();
  }
  follow("all", { happened: (event) => history.add([event]) });
  history.fetch();
  return { again: () => Promise.all([poll.again(), history.fetch()]), close: () => poll.close() };
}

/** Processor seconds per second of each worker, between the last two answers. */
class Loads {
  #last = new Map();
  of({ worker, pid, counters }) {
    const [now, used, key] = [Date.now() / 1000, counters?.cpu_s ?? 0, `${worker} ${pid}`];
    const before = this.#last.get(key);
    if (before && now - before.now < 0.5) return before.load;
    const load = before && used >= before.used ? (used - before.used) / (now - before.now) : null;
    this.#last.set(key, { now, used, load });
    return load;
  }
}

/** Times when workers joined and left, newest first. */
class History {
  #events = new Map(); #isKnown = false;
  constructor() {
    this.list = h("ol", { class: "log", reversed: true });
    this.none = h("p", { class: "faint", hidden: true }, "No worker has joined or left yet.");
    this.box = h("section", { "aria-label": "History" }, h("h2", {}, "History"), this.none, this.list);
  }

  async fetch() {
    const answer = await get("logs", { limit: 1000 }).catch(() => null); // the banner shows that the service does not answer
    if (!answer) return;
    this.#isKnown = true;
    this.add(answer.events);
  }

  add(events) {
    for (const event of events) if (HISTORY.has(event.event)) this.#events.set(event.number, event);
    const shown = [...this.#events.values()].sort((a, b) => b.number - a.number).slice(0, MOST_EVENTS);
    show(this.none, this.#isKnown && !shown.length);
    keyed(this.list, shown, (event) => event.number, (event) => h("li", { class: event.event === "worker-lost" || event.event === "refused" ? "doubtful" : "" },
      h("time", { datetime: event.time }, moment(event.time)), h("span", { class: "kind" }, event.event),
      h("span", {}, `${event.worker ?? ""}: ${event.text}`, event.job ? h("small", {}, " (job ", jobLink(event.job), ")") : null)));
  }
}

function jobLink(job) { return h("a", { href: `#/jobs/${encodeURIComponent(job)}` }, job); }

function row(serve) {
  const made = h("tr", {}, COLUMNS.map((head) => h("td", { "data-head": head, class: NUMBERS.has(head) ? "number" : head === "Worker" ? "title" : null })));
  made.parts = Object.fromEntries(COLUMNS.map((head, index) => [head, made.children[index]]));
  made.parts.State.append(h("span"), h("small", { class: "faint" }));
  made.parts.Service.append(h("span"), h("span", { class: "bar" }));
  made.serve = serve;
  return made;
}

function fill({ parts, serve }, worker, load) {
  const isLost = worker.state === "lost";
  const traffic = worker.counters?.traffic ?? [];
  const sum = (what) => traffic.reduce((total, kind) => total + kind[what], 0);
  const texts = {
    Worker: worker.worker, Host: worker.host || "–", Islands: worker.islands, Load: isLost || load === null ? "–" : `${Math.round(100 * load)} %`,
    CPU: duration(worker.counters?.cpu_s), Memory: isLost ? "–" : bytes(worker.counters?.memory_bytes), Received: bytes(sum("bytes_in")), Sent: bytes(sum("bytes_out")),
    Version: worker.version, Joined: `${duration(worker.joined)} ago`,
  };
  for (const [head, text] of Object.entries(texts)) setText(parts[head], text);
  parts.Worker.title = `process ${worker.pid} on ${worker.host}`;
  parts.Load.title = `of one processor; ${plural(worker.cores, "core")} on this host may be used`;
  setText(parts.State.firstChild, worker.state);
  setClass(parts.State.firstChild, `state ${worker.state}`);
  setText(parts.State.lastChild, worker.silent > SILENT ? ` silent for ${duration(worker.silent)}` : "");
  fillDoing(parts.Doing, worker);
  setText(parts.Service.firstChild, isLost ? "" : worker.service);
  const kind = session.may_write && !isLost ? worker.service : "";
  if (parts.Service.dataset.kind === kind) return; // otherwise a button could be replaced during a click
  parts.Service.dataset.kind = kind;
  parts.Service.lastChild.replaceChildren(...(SERVICES[kind] ?? []).map(([label, wanted]) =>
    h("button", { type: "button", class: "small", "aria-label": `${label} ${worker.worker}`, onclick: () => serve(worker.worker, wanted) }, label)));
}

/** Shows the work of a worker, with a link to its job. */
function fillDoing(place, { state, doing, detail, standing }) {
  const [job, rest] = doing ? doing.split(/\/(.*)/s, 2) : [null, ""];
  const since = standing > SILENT ? ` (for ${duration(standing)})` : "";
  if (state === "lost") return redraw(place, "lost", () => "–");
  if (!job) return redraw(place, detail + since, () => `${detail || "–"}${since}`);
  return redraw(place, doing + since, () => [jobLink(job), ` ${rest}${since}`]);
}
