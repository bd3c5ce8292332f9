// Requests to the service. Addresses are relative to the page, so that it works under any path.

const STORE = `atoll-token ${location.pathname}`;
/** Told of each request whether anything answered. */
export const hooks = { answered() {}, refused() {} };
export const session = { user: null, may_write: false, version: "", connect: "tcp/HOST:7447" };
/** Takes the token from the address, where history and screenshots would keep it, into the store of this tab. */
function takeToken() {
  const here = new URL(location.href);
  const given = here.searchParams.get("token");
  if (given === null) return;
  sessionStorage.setItem(STORE, given);
  here.searchParams.delete("token");
  history.replaceState(null, "", here);
}

takeToken(); // before anything asks for something

export function token() { return sessionStorage.getItem(STORE); }
/** Keeps a token that the service knows; raises ApiError for another one. */
export async function keepToken(given) {
  const headers = { Authorization: `Bearer ${given}` };
  const response = await fetch(address("session"), { headers }).catch(() => { throw new ApiError("The service does not answer.", 0); });
  if (!response.ok) throw new ApiError(response.status === 401 ? "This token is not known. Look at the address again." : `The service answered ${response.status}.`, response.status);
  sessionStorage.setItem(STORE, given);
  return true;
}

/** Forgets a token that the service does not know any more. */
export function forgetToken() { sessionStorage.removeItem(STORE); }
/** What a request failed with: a sentence for people, the HTTP status, 0 where nothing answered, and the columns of a file that was refused. */
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

/** Sends a request and returns the response, whatever its status; raises ApiError where nothing answers. */
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

/** Raises what a response complains about. */
export async function check(response) {
  if (response.ok || response.status === 304) return response;
  const problem = await response.json().catch(() => ({})); // no problem document: the status has to do
  if (response.status === 401) hooks.refused(problem.detail);
  throw new ApiError(problem.detail ?? `The service answered ${response.status} ${response.statusText}`.trim(), response.status, problem.columns);
}

export async function get(path, query, signal) { return (await check(await send(path, { query, signal }))).json(); }
export async function getText(path, query) { return (await check(await send(path, { query }))).text(); }
/** Changes something; `json` is the body. */
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
