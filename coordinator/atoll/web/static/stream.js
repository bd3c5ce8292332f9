// One connection to api/v1/events that reconnects by itself. It uses fetch, because EventSource cannot send a token.

import { check, send } from "./api.js";

const LEAST_PAUSE = 500;
const LONGEST_PAUSE = 10_000;
/** Comments arrive every 10 s; a connection without data for longer is lost, even if it was not closed. */
const LONGEST_SILENCE = 25_000;
/** Reads events of some jobs until it is closed; `on` has message(type, id, data), opened() and lost(sentence). */
export class Stream {
  #end = new AbortController();
  constructor(jobs, last, on) {
    this.last = last;
    this.on = on;
    this.#keepReading(jobs);
  }

  close() { this.#end.abort(); }

  async #keepReading(jobs) {
    let pause = LEAST_PAUSE;
    while (!this.#end.signal.aborted) {
      try {
        await this.#read(jobs, () => (pause = LEAST_PAUSE));
        if (!this.#end.signal.aborted) this.on.lost("The service ended the connection.");
      } catch (error) {
        if (this.#end.signal.aborted) return;
        this.on.lost(error.status === undefined ? "The connection to the service is lost." : error.message);
      }
      await this.#rest(pause * (0.8 + 0.4 * Math.random())); // random, so that tabs do not reconnect at the same time
      pause = Math.min(2 * pause, LONGEST_PAUSE);
    }
  }

  #rest(milliseconds) {
    return new Promise((done) => {
      setTimeout(done, milliseconds);
      this.#end.signal.addEventListener("abort", done, { once: true });
    });
  }

  async #read(jobs, began) {
    const attempt = new AbortController();
    const stop = () => attempt.abort();
    this.#end.signal.addEventListener("abort", stop, { once: true });
    let watch = setTimeout(stop, LONGEST_SILENCE);
    try {
      const headers = { Accept: "text/event-stream", ...(this.last === null ? {} : { "Last-Event-ID": this.last }) };
      const response = await check(await send("events", { query: { jobs }, headers, signal: attempt.signal, cache: "no-store" }));
      const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
      const read = eventReader((type, id, data) => this.#take(type, id, data));
      began();
      this.on.opened();
      for (;;) {
        const { done, value } = await reader.read();
        if (done) return;
        clearTimeout(watch);
        watch = setTimeout(stop, LONGEST_SILENCE);
        read(value);
      }
    } finally {
      clearTimeout(watch);
      this.#end.signal.removeEventListener("abort", stop);
      attempt.abort();
    }
  }

  #take(type, id, data) { if (id !== null) this.last = id; this.on.message(type, id, JSON.parse(data)); }
}

/** Returns a function that takes pieces of a text/event-stream and passes on each complete event. */
function eventReader(take) {
  let rest = "";
  return (text) => {
    const blocks = (rest + text).split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const { event, id = null, data } = Object.fromEntries(block.split("\n").map((line) => line.split(/: (.*)/, 2)));
      if (data) take(event, id, data);
    }
  };
}
