// Copies the service's MathML element by element, so that it can only contain formulas.

import { h } from "./dom.js";

const NAMESPACE = "http://www.w3.org/1998/Math/MathML";
const ATTRIBUTES = new Set([
  "display", "mathvariant", "stretchy", "fence", "separator", "form", "lspace", "rspace", "columnalign", "rowspacing", "linethickness",
]);
const known = new Map();
/** Returns a formula as an element; `text` is used instead if MathML is missing or unreadable. */
export function formula(markup, text) {
  const math = markup ? parsed(markup) : null;
  return math ? math.cloneNode(true) : h("code", { class: "expression" }, text ?? "–");
}

/** Parsed formulas by text: each answer repeats the formulas of a front. */
function parsed(markup) {
  if (!known.has(markup)) {
    if (known.size > 2000) known.clear();
    const top = new DOMParser().parseFromString(markup, "application/xml").documentElement;
    known.set(markup, top.namespaceURI === NAMESPACE && top.localName === "math" ? copy(top) : null);
  }
  return known.get(markup);
}

function copy(element) {
  const made = document.createElementNS(NAMESPACE, element.localName);
  for (const { name, value } of element.attributes) { if (ATTRIBUTES.has(name) || (name === "class" && value === "unknown")) made.setAttribute(name, value); }
  for (const child of element.childNodes) {
    if (child.nodeType === Node.TEXT_NODE) made.append(child.data);
    else if (child.nodeType === Node.ELEMENT_NODE && child.namespaceURI === NAMESPACE) made.append(copy(child));
  }
  return made;
}
