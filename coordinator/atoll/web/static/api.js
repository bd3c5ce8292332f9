// Requests to the service. Addresses are relative to the page, so that it works under any path.

const STORE = `atoll-token ${location.pathname}`;
/** `answered(isThere)` is called after each request; `isThere` is whether the service answered. */
export const hooks = { answered() {}, refused() {} };
export const session = { user: null, may_write: false, version: "", connect: "tcp/HOST:7447" };
/** Moves the token from the address, which history and screenshots would show, into the storage of this tab. */
function takeToken() {
  const here = new URL(location.href);
  const given = here.searchParams.get("token");
  if (given === null) return;
  sessionStorage.setItem(STORE, given);
  here.searchParams.delete("token");
  history.replaceState(null, "", here);
}

takeToken(); // before the first request

export function token() { return sessionStorage.getItem(STORE); }
/** Stores a token that the service accepts; raises ApiError for other tokens. */
export async function keepToken(given) {
  const headers = { Authorization: `Bearer ${given}` };
  const response = await fetch(address("session"), { headers }).catch(() => { throw new ApiError("The service does not answer.", 0); });
  if (!response.ok) throw new ApiError(response.status === 401 ? "This token is unknown. Check the address." : `The service answered ${response.status}.`, response.status);
  sessionStorage.setItem(STORE, given);
  return true;
}

/** Removes a token that the service no longer accepts. */
export function forgetToken() { sessionStorage.removeItem(STORE); }
/** The error of a request: a sentence, the HTTP status (0 without an answer), and the columns of a refused file. */
export class ApiError extends Error {
  constructor(sentence, status, columns = []) { super(sentence); Object.assign(this, { status, columns }); }
}

export function address(path, query = {}) {
  const made = new URL(`api/v1/${path}`, document.baseURI);
  made.hash = "";
  for (const [name, value] of Object.entries(query)) {
    for (const part of [value].flat()) { if (part !== null && part !== undefined && part !== "") made.searchParams.append(name, part); }
  }
  return made;
}

/** Sends a request and returns the response with any status; raises ApiError without a response. */
export async function send(path, { query, headers, ...options } = {}) {
  const known = token();
  const all = { ...headers, ...(known ? { Authorization: `Bearer ${known}` } : {}) };
  try {
    const response = await fetch(address(path, query), { ...options, headers: all });
    hooks.answered(true);
    return response;
  } catch (error) {
    if (error.name === "AbortError") throw error;
    hooks.answered(false);
    throw new ApiError("The service does not answer.", 0);
  }
}

/** Raises ApiError for a response with an error status. */
export async function check(response) {
  if (response.ok || response.status === 304) return response;
  const problem = await response.json().catch(() => ({})); // not a problem document: use the status
  if (response.status === 401) hooks.refused(problem.detail);
  throw new ApiError(problem.detail ?? `The service answered ${response.status} ${response.statusText}`.trim(), response.status, problem.columns);
}

export async function get(path, query, signal) { return (await check(await send(path, { query, signal }))).json(); }
export async function getText(path, query) { return (await check(await send(path, { query }))).text(); }
/** Sends a request that changes something; `json` is the body. */
export async function change(method, path, json) {
  const body = json === undefined ? {} : { body: JSON.stringify(json), headers: { "Content-Type": "application/json" } };
  const response = await check(await send(path, { method, ...body }));
  return response.status === 204 ? null : response.json();
}

/** Sends the bytes of a file. */
export async function upload(path, file, query, signal) {
  const headers = { "Content-Type": "application/octet-stream" };
  return (await check(await send(path, { method: "POST", body: file, query, headers, signal }))).json();
}

const job = (id) => `jobs/${encodeURIComponent(id)}`;
export const paths = { job, of: (id, what) => `${job(id)}/${what}` };
