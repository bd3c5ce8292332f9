// The coordinator: its queue, its use of resources, and whether it accepts jobs.

import { change, session } from "./api.js";
import { facts, faultBox, h, setText, show, viewHeading } from "./dom.js";
import { bytes, duration } from "./format.js";
import { Poll } from "./poll.js";

export default function open(root, _place, app) {
  const [queue, users, process] = [h("div"), h("div"), h("div")];
  const [state, fault] = [h("span", { class: "state" }), faultBox()];
  const toggle = h("button", { type: "button", hidden: true, onclick: turn }, "Pause the queue");
  let isPaused = false;
  root.append(h("div", { class: "head" }, viewHeading("Coordinator"), state), h("h2", {}, "Queue"), queue, h("p", { class: "bar" }, toggle), fault, h("h2", {}, "Jobs by user"), users, h("h2", {}, "Process"), process);
  const poll = new Poll("coordinator", app, (answer) => {
    const { coordinator } = answer;
    isPaused = coordinator.paused;
    setText(state, isPaused ? "queue paused" : "starts jobs");
    state.className = `state ${isPaused ? "paused" : "running"}`;
    setText(toggle, isPaused ? "Resume the queue" : "Pause the queue");
    show(toggle, session.may_write);
    queue.replaceChildren(facts(queueFacts(answer.queue)));
    users.replaceChildren(coordinator.users.length ? facts(coordinator.users.map(userFact)) : h("p", { class: "faint" }, "No job is waiting or running."));
    process.replaceChildren(facts(processFacts(coordinator)));
  });
  async function turn() { await fault.guard(() => change("PUT", "coordinator/queue", { paused: !isPaused })); poll.again(); }
  return poll;
}

function queueFacts(queue) {
  const word = (name) => (name[0].toUpperCase() + name.slice(1)).replaceAll("_", " ");
  return Object.entries(queue).filter(([name]) => name !== "kind").map(([name, amount]) => [word(name), String(amount)]);
}

function userFact({ user, queued, begun }) { return [user ?? "without a certificate", `${queued} in the queue, ${begun} started`]; }

function processFacts({ version, incarnation, seconds, counters, store, lag_s: lag }) {
  const mean = store.transactions ? (1000 * store.total_s) / store.transactions : 0;
  const sum = (what) => (counters.traffic ?? []).reduce((total, kind) => total + kind[what], 0);
  return [
    ["Version", version], ["Uptime", duration(seconds)], ["Starts", String(incarnation)],
    ["Memory", bytes(counters.memory_bytes)], ["CPU", `${duration(counters.cpu_s)} (${((100 * counters.cpu_s) / Math.max(seconds, 1)).toFixed(1)} %)`],
    ["Loop lag", `${(1000 * lag).toFixed(0)} ms at most in the last minute`], ["Received", bytes(sum("bytes_in"))], ["Sent", bytes(sum("bytes_out"))],
    ["Store", `${store.transactions} transactions, ${mean.toFixed(1)} ms each, the longest ${(1000 * store.worst_s).toFixed(0)} ms`],
  ];
}
