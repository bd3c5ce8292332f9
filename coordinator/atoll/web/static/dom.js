// Only this module creates elements: text is always set as text, never parsed as markup.

/** Returns an element; `on…` properties are listeners, null and false are left out, other properties are attributes. */
export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "value" || name === "checked") element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** Sets a text only if it differs, to avoid needless layout and announcements. */
export function setText(element, text) {
  const wanted = String(text ?? "");
  if (element.textContent !== wanted) element.textContent = wanted;
}

export function setClass(element, name) { if (element.className !== name) element.className = name; }
export function show(element, isShown) { if (element.hidden === isShown) element.hidden = !isShown; }
/** Updates the children of `place` to `items`: elements are kept by key, so that focus and scrolling stay. */
export function keyed(place, items, key, make, update) {
  const known = place.keyed ?? (place.keyed = new Map());
  const wanted = new Set(items.map(key));
  for (const [name, element] of known) {
    if (!wanted.has(name)) { element.remove(); known.delete(name); }
  }
  let next = place.firstElementChild;
  for (const item of items) {
    const name = key(item);
    let element = known.get(name);
    if (!element) known.set(name, (element = make(item)));
    if (element === next) next = next.nextElementSibling;
    else place.insertBefore(element, next);
    update?.(element, item);
  }
}

/** Builds the children of an element again, only if `key` has changed. */
export function redraw(element, key, make) {
  if (element.drawn === key) return;
  element.drawn = key;
  element.replaceChildren(...[make()].flat());
}

/** Returns an element for the message of an error. */
export function faultBox() {
  const box = h("p", { class: "fault", role: "alert", hidden: true });
  box.say = (sentence = "") => { setText(box, sentence); show(box, Boolean(sentence)); };
  /** Runs an action; after an error, shows its message and returns undefined. */
  box.guard = async (act) => {
    box.say();
    try {
      return await act();
    } catch (error) { if (error.name !== "AbortError") box.say(error.message); return undefined; }
  };
  return box;
}

/** Returns a function that runs `draw` once before the next frame, for any number of calls. */
export function perFrame(draw) {
  let isDue = false;
  return () => {
    if (isDue) return;
    isDue = true;
    requestAnimationFrame(() => { isDue = false; draw(); });
  };
}

/** Announces a change to screen readers. */
export function announce(sentence) { setText(document.getElementById("announcer"), sentence); }
/** Returns a heading that can take the focus when a view opens. */
export function viewHeading(text) { return h("h1", { tabindex: "-1" }, text); }
/** Returns a list of terms; `pairs` holds [term, element or text]. */
export function facts(pairs) {
  const items = pairs.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return h("dl", { class: "facts" }, items.map(([term, value]) => h("div", {}, h("dt", {}, term), h("dd", {}, value))));
}

/** Returns a button that asks for confirmation inside the page before it calls `act`. */
export function confirmButton(label, question, yes, act) {
  const open = h("button", { type: "button", onclick: () => toggle(true) }, label);
  const agree = h("button", { type: "button", class: "danger", onclick: () => (toggle(false), act()) }, yes);
  const refuse = h("button", { type: "button", onclick: () => toggle(false) }, "No");
  const box = h("span", { class: "confirm", role: "group", "aria-label": question, hidden: true }, question, agree, refuse);
  box.addEventListener("keydown", (event) => event.key === "Escape" && toggle(false));
  function toggle(isAsking) {
    show(box, isAsking);
    show(open, !isAsking);
    (isAsking ? refuse : open).focus();
  }
  return h("span", {}, open, box);
}

/** Returns a section with a title that can be collapsed. */
export function folding(title, ...parts) { return h("details", { open: true }, h("summary", {}, title), parts); }

/** Collapses a section when `isOver` becomes true, and expands it when it becomes false; later clicks of the user are respected. */
export function foldWhen(part, isOver) {
  if (part.isFolded === isOver) return;
  [part.isFolded, part.open] = [isOver, !isOver];
}

/** Returns a text with a button that copies it. */
export function copyable(label, text) {
  const code = h("pre", { tabindex: "0", "aria-label": label }, text);
  const button = h("button", { type: "button", class: "small", onclick: copy }, "Copy");
  async function copy() {
    try {
      await navigator.clipboard.writeText(code.textContent);
    } catch {
      getSelection().selectAllChildren(code); // without HTTPS there is no clipboard object, but this command works
      document.execCommand("copy");
    }
    setText(button, "Copied");
    announce(`${label} copied`);
    setTimeout(() => setText(button, "Copy"), 2000);
  }
  return h("div", { class: "copyable" }, h("div", { class: "bar" }, h("span", { class: "label" }, label), button), code);
}

/** Lets the user save a text as a file. */
export function download(name, text, type = "text/plain") {
  const address = URL.createObjectURL(new Blob([text], { type }));
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
