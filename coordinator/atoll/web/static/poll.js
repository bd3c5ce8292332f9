// Views without events: asked every two seconds while they are visible.

import { get } from "./api.js";

const PAUSE = 2000;

/** Calls `draw(answer)` again and again until the view is closed; says it if nothing answers. */
export class Poll {
  #timer = null;

  constructor(path, app, draw) {
    Object.assign(this, { path, app, draw });
    this.again();
  }

  async again() {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.again(), PAUSE);
    if (document.visibilityState === "hidden" || this.isClosed) return;
    try {
      const answer = await get(this.path);
      if (this.isClosed) return;
      this.draw(answer);
      this.app.connection(true);
    } catch (error) { if (!this.isClosed) this.app.connection(false, error.message); }
  }

  close() {
    this.isClosed = true;
    clearTimeout(this.#timer);
  }
}
