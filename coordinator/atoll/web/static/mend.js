// If an error names an option, a button sets or removes the option, or a list offers columns. For a warning, a button sets it.

import { h } from "./dom.js";

const NAMED = /--([a-z][a-z-]*)(?: (-?[a-z0-9.]+))?/g;
/** Options that name one column of the data. */
const OF_COLUMN = ["time", "trajectory", "group", "target", "weights"];
/** Options that take columns, with the role of these columns; "": the columns keep their roles. */
const OF_COLUMNS = { inputs: "input", states: "state", hold: "" };

/** Returns the names in the value of an option; names with a comma are quoted. */
export function namesOf(text) {
  return [...(text ?? "").matchAll(/"((?:[^"]|"")*)"|([^,]+)/g)].map(([, inQuotes, plain]) => (inQuotes?.replaceAll('""', '"') ?? plain.trim()));
}

/** Returns buttons that correct the error in a message. `put(name, value)` sets an option; null removes it. */
export function mends(sentence, { options, given, columns, put, choose, assign, isWarning = false }) {
  const seen = new Set();
  return [...sentence.matchAll(NAMED)].flatMap(([, flag, word]) => {
    const name = flag.replaceAll("-", "_");
    const option = options.get(name);
    if (!option || seen.has(name)) return [];
    seen.add(name);
    if (name in OF_COLUMNS) {
      const value = columnsBehind(sentence, flag, columns);
      const act = () => (OF_COLUMNS[name] ? assign(namesOf(value), OF_COLUMNS[name]) : put(name, value));
      if (value && given[name] !== value) return [button(`${option.label}: ${namesOf(value).join(", ")}`, act)];
    }
    if (!isWarning && OF_COLUMN.includes(name) && given[name] === undefined) return columns.length ? columnMend(option, sentence, columns, choose) : [];
    if (isValue(option, word) && String(given[name]) !== word) return [button(`${option.label}: ${word}`, () => put(name, option.is_repeatable ? [word] : word))];
    if (given[name] !== undefined) return isWarning ? [] : [button(`Remove “${option.label}”`, () => put(name, null))];
    return option.metavar === null ? [button(option.label, () => put(name, true))] : [];
  });
}

function button(label, act) { return h("button", { type: "button", onclick: act }, label); }
/** Returns the columns that follow an option in a sentence, quoted for the shell if needed; "" if there are none. */
function columnsBehind(sentence, flag, columns) {
  const [, inQuotes, plain] = sentence.match(new RegExp(`--${flag} (?:'([^']+)'|([^\\s'";()]+))`)) ?? [];
  const value = inQuotes ?? plain?.replace(/[.,]+$/, "") ?? "";
  return namesOf(value).every((name) => columns.includes(name)) ? value : "";
}
/** The word after an option is its value if it is one of the choices, or a number for an option that takes numbers. */
function isValue({ metavar, name }, word) {
  if (word === undefined || metavar === null) return false;
  const choices = metavar.split("|"); // a single word is an example
  return (choices.length > 1 && choices.includes(word)) || (name === "missing_value" && word !== "" && Number.isFinite(Number(word)));
}

/** Returns a button for a column that the sentence proposes, otherwise a list of columns. */
function columnMend(option, sentence, columns, choose) {
  const proposed = sentence.match(/perhaps ([^),;]+)/)?.[1];
  const act = (column) => choose(column, option.name);
  const select = h("select", { onchange: () => select.value && act(select.value) }, ["", ...columns].map((name) => h("option", { value: name }, name || "(choose)")));
  return [option.name === "time" && columns.includes(proposed) ? button(`${option.label}: ${proposed}`, () => act(proposed)) : null,
    h("label", {}, `${option.label} `, select)].filter(Boolean);
}
