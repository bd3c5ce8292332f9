// The workers: what each computes and takes, and whether it is given more.

import { change, session } from "./api.js";
import { faultBox, h, keyed, setClass, setText, show, viewHeading } from "./dom.js";
import { bytes, duration, plural } from "./format.js";
import { Poll } from "./poll.js";

const HEADS = ["Worker", "State", "Doing", "Islands", "CPU", "Memory", "Received", "Sent", "Version", "Cores", "Joined", "Service"];
const NUMBERS = new Set(["Islands", "CPU", "Memory", "Received", "Sent", "Cores", "Joined"]);
const SERVICES = { open: [["Cordon", "cordoned"], ["Drain", "draining"]], cordoned: [["Uncordon", "open"], ["Drain", "draining"]], draining: [["Uncordon", "open"]] };
const SILENT = 5;

export default function open(root, _place, app) {
  const summary = h("p", { class: "faint" }, "Loading…");
  const fault = faultBox();
  const body = h("tbody");
  const heads = HEADS.map((head) => h("th", { scope: "col", class: NUMBERS.has(head) ? "number" : null }, head));
  const table = h("table", { class: "list stacked", hidden: true }, h("caption", { class: "unseen" }, "Workers"), h("thead", {}, h("tr", {}, heads)), body);
  const none = h("p", { hidden: true }, "Start one on any machine that can reach the coordinator: ", h("code", {}, `island-worker --connect ${session.connect}`));
  root.append(viewHeading("Workers"), summary, fault, h("div", { class: "wide" }, table), none);
  const poll = new Poll("workers", app, ({ workers }) => {
    const alive = workers.filter((worker) => worker.state !== "lost").length;
    setText(summary, workers.length ? `${plural(alive, "worker")}${workers.length > alive ? `, ${workers.length - alive} lost` : ""}.` : "No workers yet.");
    show(table, workers.length > 0);
    show(none, !workers.length);
    keyed(body, workers, (worker) => worker.worker, () => row(serve), fill);
  });
  async function serve(worker, service) {
    await fault.guard(() => change("PUT", `workers/${encodeURIComponent(worker)}/service`, { service }));
    poll.again();
  }
  return poll;
}

function row(serve) {
  const made = h("tr", {}, HEADS.map((head) => h("td", { "data-head": head, class: NUMBERS.has(head) ? "number" : head === "Worker" ? "title" : null })));
  made.children[1].append(h("span"), h("small", { class: "faint" }));
  made.children[11].append(h("span"), h("span", { class: "bar" }));
  made.serve = serve;
  return made;
}

function fill(made, worker) {
  const { 0: name, 1: state, 11: service } = made.children;
  const traffic = worker.counters?.traffic ?? [];
  const sum = (what) => traffic.reduce((total, kind) => total + kind[what], 0);
  const doing = [worker.doing || worker.detail, worker.standing > SILENT ? `(for ${duration(worker.standing)})` : ""].join(" ").trim();
  const texts = [doing || "–", worker.islands, duration(worker.counters?.cpu_s), bytes(worker.counters?.memory_bytes), bytes(sum("bytes_in")), bytes(sum("bytes_out")), worker.version, worker.cores, `${duration(worker.joined)} ago`];
  texts.forEach((text, index) => setText(made.children[2 + index], text));
  setText(name, worker.worker);
  name.title = `process ${worker.pid} on ${worker.host}`;
  setText(state.firstChild, worker.state);
  setClass(state.firstChild, `state ${worker.state}`);
  setText(state.lastChild, worker.silent > SILENT ? ` silent for ${duration(worker.silent)}` : "");
  setText(service.firstChild, worker.service);
  const kind = session.may_write && worker.state !== "lost" ? worker.service : "";
  if (service.dataset.kind === kind) return; // or a button would be lost under the finger every two seconds
  service.dataset.kind = kind;
  service.lastChild.replaceChildren(...(SERVICES[kind] ?? []).map(([label, wanted]) =>
    h("button", { type: "button", class: "small", "aria-label": `${label} ${worker.worker}`, onclick: () => made.serve(worker.worker, wanted) }, label)));
}
