// Fetches the progress of a job: at most every two seconds, and no more than 2.5 kB/s on average.

import { check, paths, send } from "./api.js";

const LEAST_PAUSE = 2000;
const BYTES_PER_SECOND = 2500;

export class Progress {
  #tag = null;
  #due = null;
  #earliest = 0;
  #isFetching = false;
  #isStale = false;

  constructor(id, show) {
    this.id = id;
    this.show = show;
  }

  /** Something changed: fetches as soon as the pace allows it. */
  fetchSoon() {
    if (this.#isFetching) this.#isStale = true;
    else this.#due ??= setTimeout(() => this.fetch(), Math.max(0, this.#earliest - Date.now()));
  }

  async fetch() {
    clearTimeout(this.#due);
    this.#due = null;
    if (this.#isFetching) return;
    this.#isFetching = true;
    let size = 0;
    try {
      size = await this.#read();
    } catch {
      // the banner says it if the service is away; the next change asks again
    }
    this.#isFetching = false;
    this.#earliest = Date.now() + Math.max(LEAST_PAUSE, (1000 * size) / BYTES_PER_SECOND);
    if (this.#isStale) this.fetchSoon();
    this.#isStale = false;
  }

  async #read() {
    const headers = this.#tag ? { "If-None-Match": this.#tag } : {};
    const response = await send(paths.of(this.id, "progress"), { headers });
    if (response.status === 404 || response.status === 304) return 0; // nothing yet, or nothing new
    await check(response);
    this.#tag = response.headers.get("ETag");
    const text = await response.text();
    this.show(JSON.parse(text).equations);
    return Number(response.headers.get("Content-Length")) || text.length;
  }

  close() {
    clearTimeout(this.#due);
    this.#due = null;
    this.#isFetching = true; // nothing is fetched for a view that is gone
  }
}
