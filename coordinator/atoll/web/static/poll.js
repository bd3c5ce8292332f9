// Polling: at regular intervals without events, otherwise after each change, with a limited rate.

import { get } from "./api.js";

const PAUSE = 2000;
/** Fetches when something changed, at most every two seconds; `fetch` may return a longer pause in milliseconds. */
export class Paced {
  #due = null; #earliest = 0; #isBusy = false; #isStale = false;
  constructor(fetch) { this.fetch = fetch; }

  soon() {
    if (this.#isBusy) this.#isStale = true;
    else this.#due ??= setTimeout(() => this.now(), Math.max(0, this.#earliest - Date.now()));
  }

  async now() {
    clearTimeout(this.#due);
    this.#due = null;
    if (this.#isBusy) return;
    this.#isBusy = true;
    const pause = await this.fetch().catch(() => 0); // the banner shows that the service does not answer
    this.#isBusy = this.isClosed;
    this.#earliest = Date.now() + Math.max(PAUSE, pause ?? 0);
    if (this.#isStale) this.soon();
    this.#isStale = false;
  }

  close() {
    clearTimeout(this.#due);
    this.#isBusy = this.isClosed = true; // a closed view fetches no data
  }
}

/** Calls `draw(answer)` repeatedly until the view is closed; reports a service that does not answer. */
export class Poll extends Paced {
  #isDrawn = false;
  /** `failed(sentence)` is called if there was no answer to draw so far. */
  constructor(path, app, draw, failed = () => {}) {
    super(() => this.#read(path, draw));
    Object.assign(this, { app, failed });
    this.again();
  }

  again() { return this.now(); }

  async #read(path, draw) {
    this.soon();
    if (document.visibilityState === "hidden") return;
    try {
      const answer = await get(path);
      if (this.isClosed) return;
      draw(answer);
      this.#isDrawn = true;
      this.app.connection("poll", true);
    } catch (error) {
      if (this.isClosed) return;
      if (!this.#isDrawn) this.failed(error.message);
      this.app.connection("poll", false, error.message);
    }
  }

  close() { super.close(); this.app.connection("poll", true); } // a closed poll reports no lost connection
}
