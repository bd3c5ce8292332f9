// Fetches the progress of a job: no more than 1 kB/s on average.

import { check, paths, send } from "./api.js";
import { Paced } from "./poll.js";

const BYTES_PER_SECOND = 1000;

export class Progress extends Paced {
  #tag = null;
  constructor(id, show) { super(() => this.#read()); Object.assign(this, { id, show }); }

  /** Returns the pause until the next request, in milliseconds. */
  async #read() {
    const headers = this.#tag ? { "If-None-Match": this.#tag } : {};
    const response = await send(paths.of(this.id, "progress"), { headers });
    if (response.status === 404 || response.status === 304) return 0; // no progress yet, or no change
    await check(response);
    this.#tag = response.headers.get("ETag");
    const text = await response.text();
    this.show(JSON.parse(text));
    return (1000 * (Number(response.headers.get("Content-Length")) || text.length)) / BYTES_PER_SECOND;
  }
}
