// The frame of the page: which view is shown, the banner of a lost connection, files dropped anywhere.

import { forgetToken, get, hooks, session, token } from "./api.js";
import { announce, h, setText, viewHeading } from "./dom.js";
import { follow, onConnection, startEvents } from "./events.js";

const main = document.getElementById("main");
const banner = document.getElementById("banner");
/** Views, loaded when they are opened first, because the list of jobs needs neither charts nor forms. */
const VIEWS = {
  jobs: { title: "Jobs", load: () => import("./jobs.js") },
  job: { title: "Job", load: () => import("./job.js") },
  compare: { title: "Compare jobs", load: () => import("./compare.js") },
  workers: { title: "Workers", load: () => import("./workers.js") },
  coordinator: { title: "Coordinator", load: () => import("./coordinator.js") },
  new: { title: "New job", load: () => import("./new.js") },
  token: { title: "Enter the token", load: () => import("./token.js") },
};

const ASK_AGAIN = 2000;
/** Milliseconds after which the other views are loaded. */
const SOON = 3000;
let current = null;
let visits = 0;
/** Lost connections, with the reason. */
const lost = new Map();
/** Functions of the frame for views. */
const app = { dropped: null, connection, title };
/** Returns the view of an address such as #/jobs/ID or #/compare?a=ID&b=ID, with its parameters. */
function place() {
  const [path, query] = location.hash.replace(/^#\/?/, "").split("?");
  const [name, id] = path.split("/"); // ids have letters, digits, _ and - only
  const parameters = new URLSearchParams(query ?? "");
  if (name === "jobs" && id) return { name: "job", id, parameters };
  return { name: Object.hasOwn(VIEWS, name) && name !== "job" ? name : "jobs", parameters };
}

async function visit() {
  const visitNumber = ++visits;
  const { name, id, parameters } = session.needs_token ? { name: "token", parameters: new URLSearchParams() } : place();
  current?.close?.();
  current = null;
  follow(null, null);
  mark(name);
  title(VIEWS[name].title);
  const root = h("div", { class: `view ${name}` });
  main.replaceChildren(root);
  try {
    const { default: open } = await VIEWS[name].load();
    if (visitNumber !== visits) return;
    current = open(root, { id, parameters }, app);
  } catch {
    root.replaceChildren(viewHeading("This view cannot be loaded"), h("p", {}, "The service does not answer. The view is loaded when it answers."));
    setTimeout(() => visitNumber === visits && visit(), ASK_AGAIN);
  }
  if (visitNumber > 1) focus(root);
}

/** Moves the focus to the heading of a new view, for keyboards and screen readers. */
function focus(root) { (root.querySelector("h1") ?? main).focus({ preventScroll: true }); scrollTo(0, 0); }

function mark(name) {
  const views = { job: "jobs", compare: "jobs" };
  for (const link of document.querySelectorAll("header nav a")) {
    if (link.hash === `#/${views[name] ?? name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

function title(text) { document.title = `${text} · Atoll`; }

/** Shows lost connections; when all connections are back, the view fetches its data again. */
function connection(source, isThere, reason) {
  const wasLost = lost.size > 0;
  if (isThere) lost.delete(source);
  else lost.set(source, reason || "The connection to the service is lost.");
  const [sentence] = lost.values();
  setText(banner, sentence ? `${sentence} The page shows the last known state and continues automatically when the service answers.` : "");
  if (!wasLost || lost.size) return;
  announce("The service answers again.");
  loadSession();
  current?.again?.();
}

async function loadSession() {
  const known = await get("session").catch(() => null);
  if (!known) return; // the banner or the field for a token shows the reason
  Object.assign(session, known);
  const sign = session.may_write ? session.user ?? "signed in" : h("a", { href: "#/token" }, "read only: enter the token");
  document.getElementById("session").replaceChildren(sign, ` · ${session.version}`);
}

/** Without an accepted token no view can be shown, so every view is replaced by the field for the token. */
function refuse(sentence) {
  if (session.needs_token) return;
  if (token()) session.refusal = "The service does not accept the token of this page: the service was restarted, or the address belongs to another service.";
  Object.assign(session, { needs_token: true, may_write: false });
  forgetToken();
  announce(session.refusal ?? sentence ?? "");
  if (visits) visit();
}

function acceptFiles() {
  const holdsFile = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  addEventListener("dragover", (event) => {
    if (!holdsFile(event)) return;
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  addEventListener("dragleave", (event) => event.relatedTarget ?? document.body.classList.remove("dropping"));
  addEventListener("drop", (event) => {
    document.body.classList.remove("dropping");
    if (!holdsFile(event)) return;
    event.preventDefault();
    app.dropped = [...event.dataTransfer.files];
    if (current?.take) current.take(app.dropped);
    else location.hash = "#/new";
  });
}

async function begin() {
  document.getElementById("skip").addEventListener("click", (event) => {
    event.preventDefault(); // the address names the view, not a position in the page
    main.focus();
  });
  acceptFiles();
  hooks.refused = refuse;
  hooks.answered = (isThere) => connection("requests", isThere, "The service does not answer.");
  setInterval(() => lost.has("requests") && loadSession(), ASK_AGAIN);
  onConnection(({ connected, reason }) => connection("events", connected, reason));
  document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && current?.again?.());
  await loadSession();
  addEventListener("hashchange", visit);
  await visit();
  if (!session.needs_token) startEvents();
  setTimeout(loadViews, SOON);
}

/** Loads the other views when the page is idle, so that they open even without the service. */
function loadViews() { for (const { load } of Object.values(VIEWS)) load().catch(() => {}); } // opening the view tries again

begin();
