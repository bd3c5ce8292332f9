// All tabs of a browser share one connection, because browsers open only six connections to a host over HTTP/1.1.
//
// Tabs elect a leader by an exclusive lock. Each visible tab reports which jobs it watches; the leader reads the events of
// all these jobs and distributes them. A hidden tab does not listen and does not lead. Without locks each tab has its own connection.

import { token } from "./api.js";
import { Stream } from "./stream.js";

const WISH_AGAIN = 20_000;
/** Milliseconds after which the jobs of a tab are dropped unless it reports them again, because a tab may end without a message. */
const WISH_DIES = 60_000;
const SETTLE = 100;
/** Maximum number of jobs in a request; for more jobs, the events of all jobs are requested. */
const MOST_NAMES = 32;
/** Tabs with another path or user see other jobs, so they have a separate election. */
const NAME = `atoll-events ${new URL(".", document.baseURI).pathname} ${token() ?? ""}`;
const tab = Math.random().toString(36).slice(2);
const hasLocks = Boolean(navigator.locks) && typeof BroadcastChannel === "function";
const channel = hasLocks ? new BroadcastChannel(NAME) : null;
const listeners = new Set();
let jobs = null;
let view = null;
let last = null;
let leader = null;
let waiting = null;
/** Notifies a view of changes of jobs ("all", or a list of ids): `told` has the methods job(change) and happened(event). */
export function follow(wanted, told) {
  jobs = wanted;
  view = told;
  tellWish();
}

/** Calls `listener({connected, reason})` when the connection is opened or lost. */
export function onConnection(listener) { listeners.add(listener); }
/** Starts: from now on this tab takes part in the election. */
export function startEvents() {
  channel?.addEventListener("message", ({ data }) => hear(data));
  document.addEventListener("visibilitychange", appear);
  addEventListener("pagehide", vanish);
  addEventListener("pageshow", (event) => event.persisted && appear());
  setInterval(tellWish, WISH_AGAIN);
  appear();
}

function appear() {
  if (document.visibilityState === "hidden") return vanish();
  if (hasLocks) runForLeader();
  else leader ??= new Leader();
  tellWish();
}

function vanish() {
  channel?.postMessage({ kind: "wish", tab, jobs: null });
  waiting?.abort();
  waiting = null;
  leader?.resign();
  leader = null;
}

/** Waits for the lock, for which all visible tabs queue. */
function runForLeader() {
  if (leader || waiting) return;
  const candidacy = new AbortController();
  waiting = candidacy;
  const lead = () => new Promise((resign) => {
    if (candidacy.signal.aborted) return resign();
    waiting = null;
    leader = new Leader(resign);
    tellWish();
  });
  navigator.locks.request(NAME, { signal: candidacy.signal }, lead).catch(() => {}); // aborted before the lock was granted
}

function tellWish() {
  const wish = { kind: "wish", tab, jobs: document.visibilityState === "hidden" ? null : jobs };
  if (leader) leader.hear(wish);
  else channel?.postMessage(wish);
}

function hear(message) {
  if (message.kind === "wish") leader?.hear(message);
  else if (message.kind === "who") tellWish();
  else if (message.kind === "connection") listeners.forEach((listener) => listener(message));
  else if (message.kind === "event") take(message);
}

/** Hands an event to the view of this tab, if it is about what the view watches. */
function take({ type, id, data }) {
  if (id !== null) last = id;
  if (!view || jobs === null || document.visibilityState === "hidden") return;
  const isOurs = jobs === "all" || !data.job || jobs.includes(data.job);
  if (isOurs && type === "job") view.job?.(data);
  if (isOurs && type === "happened") view.happened?.(data);
}

/** Reads the events of all tabs' jobs while this tab has the lock. */
class Leader {
  #wishes = new Map(); #stream = null; #reads = null; #due = null;
  #state = { kind: "connection", connected: true, reason: "" };
  constructor(resign = () => {}) {
    this.give = resign;
    this.timer = setInterval(() => this.#settle(), WISH_AGAIN);
    channel?.postMessage({ kind: "who" });
  }

  resign() {
    clearInterval(this.timer);
    clearTimeout(this.#due);
    this.#stream?.close();
    this.give();
  }

  hear({ tab: name, jobs: wanted }) {
    const isNew = !this.#wishes.has(name);
    if (wanted === null) this.#wishes.delete(name);
    else this.#wishes.set(name, { jobs: wanted, heard: Date.now() });
    if (isNew && name !== tab && !this.#state.connected) channel?.postMessage(this.#state);
    this.#due ??= setTimeout(() => this.#settle(), SETTLE); // views change in several steps: reads events after the last step
  }

  #settle() {
    this.#due = null;
    for (const [name, wish] of this.#wishes) { if (Date.now() - wish.heard > WISH_DIES) this.#wishes.delete(name); }
    const union = this.#union();
    if (JSON.stringify(union) === JSON.stringify(this.#reads)) return;
    this.#reads = union;
    this.#stream?.close();
    this.#stream = union.length ? this.#open(union) : null;
    if (!this.#stream) this.#say(true, ""); // without a stream no connection is lost
  }

  #union() {
    const all = [...this.#wishes.values()].map((wish) => wish.jobs);
    const names = [...new Set(all.flat())].sort();
    return all.includes("all") || names.length > MOST_NAMES ? ["all"] : names;
  }

  #open(union) {
    return new Stream(union, last, {
      opened: () => this.#say(true, ""),
      lost: (reason) => this.#say(false, reason),
      message: (type, id, data) => this.#pass(type, id, data),
    });
  }

  #pass(type, id, data) {
    if (type === "connection") this.#say(data.connected, data.reason);
    this.#tell({ kind: "event", type, id, data });
  }

  #say(connected, reason) {
    if (connected === this.#state.connected && reason === this.#state.reason) return;
    this.#state = { kind: "connection", connected, reason };
    this.#tell(this.#state);
  }

  #tell(message) { channel?.postMessage(message); hear(message); }
}
