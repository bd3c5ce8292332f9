// A new job: a file, how it is read, its smoothed curves, the options, and the same job as a command.

import { get, paths, session, upload } from "./api.js";
import { LinesChart, legend, thin } from "./charts.js";
import { announce, copyable, facts, faultBox, h, redraw, setText, show, viewHeading } from "./dom.js";
import { HAS_RESULT, plural } from "./format.js";
import { formula } from "./mathml.js";
import { mends, namesOf } from "./mend.js";

const ROLES = ["time", "state", "input", "trajectory", "weights", "unused"];
/** Options that name the columns of a role; without a choice by the user, the service decides. */
const OPTION_OF = { time: "time", state: "states", input: "inputs", trajectory: "trajectory", weights: "weights" };
/** Settings with another name than their option. */
const SETTINGS = { allow: "variables_of", require: "required_of" };
const SETTLE = 500;
/** Options for equations of which a part is given. */
const GIVEN = ["equation", "parameter"];
const MOST_CHARTS = 6;

export default function open(root, { parameters }, app) { return new NewJob(root, parameters, app); }

class NewJob {
  #options = {};
  #fields = new Map(); #beside = new Map(); #charts = []; #files = null; #from = null; #columns = []; #asked = null; #timer = null; #chosen = new Map();
  constructor(root, parameters, app) {
    this.app = app;
    this.#build(root);
    this.#begin(parameters);
  }

  #build(root) {
    const file = h("input", { type: "file", class: "unseen", id: "file", multiple: true, onchange: () => this.take([...file.files]) });
    const demo = h("button", { type: "button", onclick: () => this.#takeDemo() }, "Use the demo data");
    this.hint = h("p", { class: "lines", role: "status" });
    [this.unread, this.fault] = [faultBox(), faultBox()];
    [this.outline, this.preview, this.commands, this.mending] = [h("div"), h("div"), h("div"), h("div", { class: "tools", role: "group", "aria-label": "Corrections", hidden: true })];
    this.form = h("div");
    this.name = h("input", { maxlength: "200" });
    this.priority = h("input", { type: "number", min: "-10", max: "10", value: "0" });
    this.shared = h("input", { type: "checkbox" });
    this.send = h("button", { class: "primary", disabled: true }, "Submit the job");
    const step = (title, ...parts) => h("section", { id: title === "Submit" ? "submitting" : null }, h("h2", {}, title), parts);
    root.append(viewHeading("New job"), h("form", { onsubmit: (event) => this.#submit(event), onkeydown: takeEnter },
      step("Data", h("div", { class: "drop" }, h("span", {}, "Drop data files here, or "), file, h("label", { for: "file", class: "button" }, "choose files"), demo), this.hint, this.unread, this.mending, this.outline),
      (this.seen = step("Smoothed", this.preview)), step("Options", this.form), (this.same = step("Same job as a command", this.commands)),
      step("Submit", session.may_write ? null : h("p", { class: "faint" }, "You can only read. ", h("a", { href: "#/token" }, "Enter the token"), " to submit."),
        h("div", { class: "tools" }, h("label", {}, "Name ", this.name), h("label", {}, "Priority ", this.priority),
          h("label", {}, this.shared, " visible to all users"), this.send), this.fault)));
    [this.seen, this.same].forEach((part) => show(part, false));
  }

  async #begin(parameters) {
    try {
      this.#drawForm((await get("options")).groups);
      if (parameters.has("from")) await this.#takeOver(parameters.get("from"));
    } catch (error) { this.fault.say(error.message); }
    if (this.app.dropped) this.take(this.app.dropped);
    else if (parameters.has("demo")) this.#takeDemo();
    this.app.dropped = null;
  }

  take(files) {
    if (!files.length) return;
    [this.#files, this.#from] = [files, null];
    this.#columns = [];
    this.#chosen.clear();
    for (const option of Object.values(OPTION_OF)) this.#fill(option, null); // columns of another file
    redraw(this.outline, null, () => []);
    this.name.placeholder = files[0].name;
    setText(this.hint, `Reading ${this.#source}…`);
    this.#ask();
  }

  #takeDemo() {
    return this.fault.guard(async () => {
      const { filename, text } = await get("demo");
      this.take([new File([text], filename, { type: "text/csv" })]);
    });
  }
  /** Copies the data and options of another job, and its equations as initial guesses. */
  async #takeOver(id) {
    const job = await get(paths.job(id));
    this.name.value = job.name;
    this.priority.value = job.priority;
    this.shared.checked = job.shared;
    const result = HAS_RESULT.includes(job.state) ? await get(paths.of(id, "result")).catch(() => null) : null;
    this.#options = this.#optionsOf(result?.config ?? {}, job);
    const given = Object.keys(result?.config?.prior?.equations ?? {}); // guesses are for the unknown part of these equations
    const guess = ({ variable, expression, candidates }) => (given.includes(variable) ? candidates.find(({ selected }) => selected)?.unknown : expression);
    const found = (result?.equations ?? []).filter((equation) => equation.why !== "known" && guess(equation)).map((equation) => `${equation.lhs}=${guess(equation)}`);
    if (found.length) this.#options.guess = found; // the search continues from the other job's equations
    this.#fields.forEach((field, name) => field.show(this.#options[name]));
    for (const [role, option] of Object.entries(OPTION_OF)) namesOf(this.#options[option]).forEach((name) => this.#chosen.set(name, role));
    this.#from = job;
    setText(this.hint, `Data and options come from ${job.name}${found.length ? "; the search begins from its equations (--guess)" : ""}.`);
    this.#ask();
  }
  /** Returns the options that give a configuration; its settings have nearly the same names. */
  #optionsOf(config, { seed, preset }) {
    const settings = Object.assign({ seed, preset }, ...Object.values(config).filter((section) => section && typeof section === "object"));
    const options = {};
    for (const [name, { option }] of this.#fields) {
      const texts = [SETTINGS[name] ?? name, `${name}s`, `${name}_of`].filter((setting) => setting in settings).flatMap((setting) => asTexts(name, settings[setting]));
      if (texts.length) options[name] = option.metavar === null ? true : option.is_repeatable ? texts : texts.join(",");
    }
    return options;
  }

  #drawForm(groups) {
    this.form.replaceChildren(...Object.entries(groups).map(([heading, options]) => h("details", {},
      h("summary", {}, heading, h("span", { class: "faint" }, ` · ${plural(options.length, "option")}`)),
      h("div", { class: "options" }, options.map((option) => this.#field(option))))));
  }

  #field(option) {
    const id = `option-${option.name}`;
    const choices = /^[a-z0-9]+(\|[a-z0-9]+)+$/.test(option.metavar ?? "") ? ["", ...option.metavar.split("|")] : null;
    const read = () => {
      const lines = option.metavar === null ? input.checked : option.is_repeatable ? input.value.split("\n").filter((line) => line.trim()) : input.value.trim();
      this.#set(option.name, lines);
    };
    const common = { id, "aria-describedby": `${id}-help`, oninput: read };
    const input = option.metavar === null ? h("input", { type: "checkbox", ...common })
      : choices ? h("select", common, choices.map((choice) => h("option", { value: choice }, choice || "(default)")))
        : option.is_repeatable ? h("textarea", { rows: "1", placeholder: `${option.metavar}, one per line`, ...common })
          : h("input", { placeholder: option.metavar, autocomplete: "off", ...common });
    const fill = (value) => {
      if (option.metavar === null) input.checked = Boolean(value);
      else input.value = [value ?? ""].flat().join("\n");
    };
    this.#fields.set(option.name, { option, show: fill });
    return h("div", { class: "field" }, h("label", { for: id }, option.label, " ", h("code", { class: "faint" }, option.flag)), input, this.#besideField(option.name), h("small", { class: "faint", id: `${id}-help` }, option.help));
  }

  /** Returns the place beside a field for an error in it, and for typeset equations; most fields have none. */
  #besideField(name) {
    if (!GIVEN.includes(name)) return "";
    const fault = h("small", { class: "fault", hidden: true });
    this.#beside.set(name, fault);
    if (name === "equation") this.typeset = h("div", { class: "typeset", tabindex: "0", role: "group", "aria-label": "Typeset equations", hidden: true });
    return name === "equation" ? [this.typeset, fault] : fault;
  }
  /** Shows the given equations, or an error that names an option, beside the field. */
  #drawBeside(equations, sentence = "") {
    const given = equations.filter(({ mathml }) => mathml);
    const named = sentence.match(/(?:^|--)(equation|parameter)\b/)?.[1];
    for (const [name, fault] of this.#beside) {
      setText(fault, sentence);
      show(fault, named === name);
    }
    if (sentence) return; // the last equations that could be read stay
    redraw(this.typeset, JSON.stringify(given), () => given.map(({ mathml, lhs, given: side }) => formula(mathml, `${lhs} = ${side}`)));
    show(this.typeset, given.length > 0);
  }

  #set(name, value) {
    if (!value || value.length === 0) delete this.#options[name];
    else this.#options[name] = value;
    this.#askSoon();
  }

  #askSoon() { clearTimeout(this.#timer); this.#timer = setTimeout(() => this.#ask(), SETTLE); }
  get #query() {
    const data = this.#files ? { filename: this.#files.map(({ name }) => name), bytes: this.#files.map(({ size }) => size) } : { of: this.#from.job };
    return { ...data, options: JSON.stringify(this.#options) };
  }
  get #body() { return this.#files && new Blob(this.#files); }
  get #source() { return this.#files?.map(({ name }) => name).join(", ") ?? this.#from.name; }
  /** Requests how the data are read with these options, then their smoothed curves. */
  async #ask() {
    if (!this.#files && !this.#from) return;
    this.#asked?.abort();
    const { signal } = (this.#asked = new AbortController());
    this.unread.say();
    show(this.mending, false);
    try {
      const outline = await upload("outline", this.#body, this.#query, signal);
      this.#drawOutline(outline);
      this.#drawBeside(outline.equations);
      this.#offerMends(outline.warnings.join(" "), true);
      this.send.disabled = !session.may_write;
      this.fault.say();
      this.#drawPreview(await upload("preview", this.#body, this.#query, signal));
    } catch (error) {
      if (error.name === "AbortError") return;
      setText(this.hint, `${this.#source} cannot be read with these options.`);
      this.unread.say(error.message);
      this.#drawBeside([], error.message);
      this.send.disabled = true;
      this.#drawRefused(error.columns ?? []);
      this.#offerMends(error.message);
    }
  }
  /** Adds buttons that correct an error, or that follow the advice of a warning. */
  #offerMends(sentence, isWarning = false) {
    const parts = mends(sentence, {
      isWarning, assign: (names, role) => names.forEach((name) => this.#choose(name, role)),
      options: new Map([...this.#fields].map(([name, { option }]) => [name, option])), given: this.#options, columns: this.#columns.map(({ name }) => name),
      put: (name, value) => this.#put(name, value),
      choose: (column, option) => { this.#choose(column, Object.keys(OPTION_OF).find((role) => OPTION_OF[role] === option) ?? null, option); },
    });
    this.mending.replaceChildren(...parts);
    show(this.mending, parts.length > 0);
  }
  /** A file that cannot be read yet, for example without a time, has columns from which the user can choose. */
  #drawRefused(columns) {
    if (!this.#columns.length) this.#columns = columns;
    if (this.#columns.length) this.#drawColumns({ columns: this.#columns, equations: [] });
  }

  #drawOutline(outline) {
    setText(this.hint, outline.read_as);
    this.#columns = outline.columns;
    this.#drawColumns(outline);
    this.commands.replaceChildren(copyable("Command line", outline.command), copyable("Python", outline.python));
    show(this.same, true);
  }

  #drawColumns({ columns, equations, parameters = [] }) {
    const key = JSON.stringify([columns.map(({ name, role }) => [name, role]), equations, parameters]);
    const focused = document.activeElement?.id ?? ""; // the table is drawn again while the user changes it
    redraw(this.outline, key, () => this.#columnParts(columns, equations, parameters));
    if (/^(role|unit|angle)-/.test(focused)) document.getElementById(focused)?.focus();
  }

  #columnParts(columns, equations, parameters) {
    const heads = ["Column", "Role", "Unit", "Angle", "First values"].map((head) => h("th", { scope: "col" }, head));
    const rows = columns.map((column, index) => {
      const role = h("select", { id: `role-${index}`, "aria-label": `Role of ${column.name}`, onchange: () => this.#choose(column.name, role.value) },
        h("option", { value: "" }, column.role ? `automatic: ${column.role}` : "automatic"), ROLES.map((name) => h("option", {}, name)));
      role.value = this.#chosen.get(column.name) ?? "";
      const unit = h("input", { id: `unit-${index}`, size: "8", value: column.unit ?? "", "aria-label": `Unit of ${column.name}`, onchange: () => this.#collect("unit", columns, (name, text) => `${name}=${text}`) });
      const angle = h("select", { id: `angle-${index}`, "aria-label": `Whether ${column.name} is an angle`, onchange: () => this.#collect("angle", columns, (name, text) => (text === "degrees" ? `${name}:deg` : name)) }, ["", "radians", "degrees"].map((name) => h("option", { value: name }, name || "no")));
      angle.value = column.angle ?? "";
      return h("tr", {}, h("th", { scope: "row" }, column.name), h("td", { "data-head": "Role" }, role), h("td", { "data-head": "Unit" }, unit), h("td", { "data-head": "Angle" }, angle),
        h("td", { class: "numbers", "data-head": "First values" }, column.first.join(", ")));
    });
    const sought = equations.map((equation) => [equation.lhs, equation.known ? `given: ${equation.known}` : this.#means(equation)]);
    if (parameters.length) sought.push(["parameters", parameters.join("; ")]);
    return [h("div", { class: "wide" }, h("table", { class: "stacked" }, h("caption", { class: "unseen" }, "Columns"), h("thead", {}, h("tr", {}, heads)), h("tbody", {}, rows))),
      ...(sought.length ? [h("h3", {}, "Equations to find"), facts(sought)] : [])];
  }
  #means({ lhs, given, unknown, unit, mathml, variables, guesses }) {
    const of = `of ${variables.join(", ")}${guesses.length ? `, starting from ${guesses.join("; ")}` : ""}`;
    if (!mathml) return of;
    return h("span", {}, formula(mathml, `${lhs} = ${given}`), unknown ? `${unknown}${unit ? ` [${unit}]` : ""} is searched, ${of}` : "given");
  }
  /** Gives a column a role ("": the service decides); an `option` without a role names the column. */
  #choose(column, role, option = null) {
    if (role === null) return this.#put(option, quote(column));
    if (role) this.#chosen.set(column, role);
    else this.#chosen.delete(column);
    if (["time", "trajectory", "weights"].includes(role)) {
      for (const [name, other] of [...this.#chosen]) if (other === role && name !== column) this.#chosen.delete(name); // each of these roles has one column
    }
    const named = (wanted) => this.#columns.filter(({ name }) => this.#chosen.get(name) === wanted).map(({ name }) => quote(name));
    for (const wanted of ["time", "input", "trajectory", "weights"]) this.#put(OPTION_OF[wanted], named(wanted).join(","));
    this.#put("states", this.#states().map(quote).join(","));
    return undefined;
  }
  /** Returns the names of all states for the option, if the user has added or removed a state; otherwise no names. */
  #states() {
    const isChosen = this.#columns.some(({ name, role }) => this.#chosen.get(name) === "state" || (this.#chosen.get(name) === "unused" && role !== null));
    return isChosen ? this.#columns.filter(({ name, role }) => (this.#chosen.get(name) ?? role) === "state").map(({ name }) => name) : [];
  }

  #collect(option, columns, say) {
    const given = columns.map(({ name }, index) => [name, document.getElementById(`${option}-${index}`).value.trim()]);
    this.#put(option, given.filter(([, text]) => text).map(([name, text]) => say(name, text)));
  }

  #put(name, value) { this.#fill(name, value); this.#set(name, value); }
  #fill(name, value) {
    this.#fields.get(name)?.show(value);
    if (!value) delete this.#options[name];
  }

  #drawPreview({ time_name: label, trajectories }) {
    const choice = h("select", { onchange: () => this.#drawTrajectory(label ?? "time", trajectories[choice.value]) }, trajectories.map(({ name }, index) => h("option", { value: index }, name)));
    this.pictures = h("div", { class: "pair" });
    this.preview.replaceChildren(trajectories.length > 1 ? h("label", {}, "Trajectory ", choice) : "",
      legend([["c1", "measured"], ["c0", "smoothed, ± 2 standard errors"], ["c2", "derivative, ± 2 standard errors"]]), this.pictures);
    show(this.seen, trajectories.length > 0);
    if (trajectories.length) this.#drawTrajectory(label ?? "time", trajectories[0]);
  }

  #drawTrajectory(label, { time: xs, states }) {
    this.#charts.forEach((chart) => chart.close());
    const shift = (value, sigma) => (value === null || sigma === null ? null : value + 2 * sigma);
    const band = (values, sigma) => (sigma === null ? null : [-1, 1].map((side) => values.map((value, i) => shift(value, side * (sigma[i] ?? sigma)))));
    const pictures = states.slice(0, MOST_CHARTS).flatMap((state) => {
      const [curve, slope] = [new LinesChart(`${state.name}, smoothed`, { height: 200 }), new LinesChart(`Derivative of ${state.name}`, { height: 200 })];
      curve.set(label, state.name, xs, [{ values: state.smoothed, colour: "c0", band: band(state.smoothed, state.sigma) }, { values: thin(state.measured), colour: "c1", isPoints: true }]);
      slope.set(label, `d${state.name}/d${label}`, xs, [{ values: state.derivative, colour: "c2", band: band(state.derivative, state.derivative_sigma) }]);
      this.#charts.push(curve, slope);
      return [curve.box, slope.box];
    });
    this.pictures.replaceChildren(...pictures);
  }

  async #submit(event) {
    event.preventDefault();
    if (!this.#files && !this.#from) return;
    this.send.disabled = true;
    try {
      const more = { name: this.name.value, priority: this.priority.value, shared: String(this.shared.checked) };
      const job = await upload("jobs", this.#body, { ...this.#query, ...more });
      announce("The job is submitted.");
      location.hash = `#/jobs/${encodeURIComponent(job.job)}`;
    } catch (error) { this.fault.say(error.message); this.send.disabled = false; }
  }

  close() {
    clearTimeout(this.#timer);
    this.#asked?.abort();
    this.#charts.forEach((chart) => chart.close());
  }
}

/** Enter in a unit or an option accepts the value; it submits the job only in the section "Submit". */
function takeEnter(event) {
  const { key, target } = event;
  if (key !== "Enter" || target.tagName !== "INPUT" || target.type === "file" || target.closest("#submitting")) return;
  event.preventDefault();
  target.dispatchEvent(new Event("change"));
}

function quote(name) { return /[",]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name; }
/** Returns a setting as texts of its option. */
function asTexts(name, value) {
  if (value === null || value === false) return [];
  if (Array.isArray(value)) return [value.map((part) => (part?.column ? `${part.column}${part.degrees ? ":deg" : ""}` : quote(String(part)))).join(",")];
  if (typeof value !== "object") return [String(value)];
  return Object.entries(value).flatMap(([side, right]) => {
    if (name === "bound") return right.map((bound) => (side === "*" ? bound : `${side}: ${bound}`));
    if (["parameter", "initial"].includes(name)) return [`${side}${parameterText(right)}`];
    return ["guess", "monotone", "limit"].includes(name) ? right.map((one) => `${side}=${one}`) : [`${side}=${[right].flat().join(",")}`];
  });
}
/** Returns start value and bounds of a parameter or an initial value as its option has them, such as =1 in 0.1..10 by run. */
function parameterText({ start, lower, upper, by }) {
  const bounds = lower === undefined && upper === undefined ? [] : [`${lower ?? ""}..${upper ?? ""}`];
  const numbers = [...(start === undefined ? [] : [start]), ...bounds].join(" in ");
  return (numbers && `=${numbers}`) + (by ? ` by ${by}` : "");
}
