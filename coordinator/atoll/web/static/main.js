// The frame of the page: which view is shown, the banner of a lost connection, files dropped anywhere.

import { forgetToken, get, hooks, session, token } from "./api.js";
import { announce, h, setText, viewHeading } from "./dom.js";
import { follow, onConnection, startEvents } from "./events.js";

const main = document.getElementById("main");
const banner = document.getElementById("banner");
/** Views are loaded when they are first seen: the list of jobs needs neither charts nor forms. */
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
/** Milliseconds after which the other views are loaded, too. */
const SOON = 3000;
let current = null;
let visits = 0;
/** What is not there now, with the reason. */
const lost = new Map();
/** What views get of the frame. */
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
    root.replaceChildren(viewHeading("This view cannot be loaded"), h("p", {}, "The service does not answer. The view is loaded as soon as it does."));
    setTimeout(() => visitNumber === visits && visit(), ASK_AGAIN);
  }
  if (visitNumber > 1) focus(root);
}

/** Keyboards and screen readers begin at the heading of a new view. */
function focus(root) { (root.querySelector("h1") ?? main).focus({ preventScroll: true }); scrollTo(0, 0); }

function mark(name) {
  const views = { job: "jobs", compare: "jobs" };
  for (const link of document.querySelectorAll("header nav a")) {
    if (link.hash === `#/${views[name] ?? name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

function title(text) { document.title = `${text} · Atoll`; }

/** Says what cannot be reached, and has the view fetch everything anew when all can be again. */
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
  if (!known) return; // the banner says it, or the field for a token
  Object.assign(session, known);
  const sign = session.may_write ? session.user ?? "signed in" : h("a", { href: "#/token" }, "looking only: enter the token");
  document.getElementById("session").replaceChildren(sign, ` · ${session.version}`);
}

/** Without a token that the service knows nothing can be shown: there is a field for one in the place of every view. */
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
    event.preventDefault(); // the address holds the view, not a place in the page
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

/** Loads the other views while nothing else is to do, so that they open without the service, too. */
function loadViews() { for (const { load } of Object.values(VIEWS)) load().catch(() => {}); } // it is tried again when it is opened

begin();
