// The commands of the machine: what can be started, what is under way or waits, what has ended, and how to stop.
const byId = (id) => document.getElementById(id);
const make = (tag, properties, ...children) => {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
};
const button = (text, title, act) => {
  const element = make("button", { textContent: text, title, type: "button" });
  element.addEventListener("click", act);
  return element;
};
const LEVELS = ["ok", "warning", "error", "stale"];

// The value that stands in a field, as its schema wants it; undefined: nothing stands there, the default counts.
export function valueOf(schema, text) {
  if (text === "" && schema.type !== "string") return undefined;
  if (schema.type === "string") return text === (schema.default ?? null) ? undefined : text;
  if (schema.type === "boolean") return text === "true";
  if (schema.type === "array") return text.split(/[\s,]+/).filter(Boolean).map((one) => valueOf(schema.items, one) ?? one);
  const value = schema.type ? Number(text) : JSON.parse(text);
  if (schema.type && !Number.isFinite(value)) throw new Error(`${text} is no number`);
  return value;
}

function hint(schema) {
  const one = schema.items ?? schema, many = schema.items ? "several, a blank between them" : "";
  const range = one.minimum === undefined && one.maximum === undefined ? "" : `${one.minimum ?? "-∞"} to ${one.maximum ?? "∞"}`;
  const filled = schema.default === undefined ? "needed" : `else ${JSON.stringify(schema.default)}`;
  return [schema.description, schema.unit && `[${schema.unit}]`, many, range, filled].filter(Boolean).join("; ");
}

function field(name, schema, needed) {
  let input;
  const choices = schema.enum ?? (schema.type === "boolean" ? ["true", "false"] : null);
  if (choices) {
    input = make("select", {}, ...choices.map((choice) =>
      make("option", { value: choice, textContent: choice, selected: String(choice) === String(schema.default) })));
  } else {
    input = make("input", { type: "text", placeholder: JSON.stringify(schema.default ?? "") , autocomplete: "off" });
    input.required = needed;
  }
  input.name = name;
  input.title = hint(schema);
  return make("label", { title: input.title }, make("span", { textContent: name + (schema.unit ? ` [${schema.unit}]` : "") }), input);
}

export class Commands {
  // ask(request, argument) asks the machine; say(success, sentence) tells the viewer.
  constructor(ask, say) {
    Object.assign(this, { ask, say, known: [], listed: [], operable: false });
    byId("command").addEventListener("change", () => this.fill());
    byId("start").addEventListener("input", () => say(true, ""));  // what was refused has been changed
    byId("start").addEventListener("submit", (event) => { event.preventDefault(); this.start(); });
    byId("estop").addEventListener("click", () => ask("estop", ""));
    byId("protect").addEventListener("click", () => ask("protective_stop", ""));
    byId("reset").addEventListener("click", () => ask("reset", ""));
    byId("go-on").addEventListener("click", () => {
      for (const [group, owner] of Object.entries(this.stopped)) ask("go_on", JSON.stringify({ group, owner }));
    });
    this.stopped = {};
    this.begun = new Map();  // number of a command -> when its state was first seen, and how far it was
  }

  // Shows what this viewer may do.
  allow(operable) {
    this.operable = operable;
    document.body.classList.toggle("operable", operable);
    this.list();
  }

  take({ part, content }) {
    ({ known: () => this.know(content), listed: () => { this.listed = content; this.list(); },
      ended: () => this.end(content), diagnostics: () => this.diagnose(content) })[part]?.();
  }

  condition(mcs) {
    this.stopped = mcs?.stopped ?? {};
    byId("go-on").hidden = !Object.keys(this.stopped).length;
    byId("reset").hidden = mcs?.state !== "estopped";
  }

  know(known) {
    this.known = known.toSorted((a, b) => a.symbol.localeCompare(b.symbol));
    const chosen = byId("command").value;
    byId("command").replaceChildren(...this.known.map(({ symbol, description }) =>
      make("option", { value: symbol, textContent: symbol, title: description ?? "", selected: symbol === chosen })));
    if (byId("command").value !== chosen || !byId("arguments").children.length) this.fill();
  }

  chosen() { return this.known.find(({ symbol }) => symbol === byId("command").value); }

  fill() {
    const command = this.chosen(), schema = command?.arguments ?? {};
    byId("does").textContent = command?.description ?? "";
    byId("arguments").replaceChildren(...Object.entries(schema.properties ?? {}).map(([name, one]) =>
      field(name, one, (schema.required ?? []).includes(name))));
  }

  start() {
    this.say(true, "");
    const { symbol, arguments: schema } = this.chosen(), given = {};
    try {
      for (const input of byId("arguments").querySelectorAll("input, select")) {
        const value = valueOf(schema.properties[input.name], input.value);
        if (value !== undefined) given[input.name] = value;
      }
    } catch (error) {
      this.say(false, `${symbol}: ${error.message}`);
      return;
    }
    this.ask("start", JSON.stringify({ symbol, arguments: given }));
  }

  // The time that a command still takes, in words, if it goes on as it did while it was seen; empty: nothing is known.
  left({ number, state, progress }) {
    const known = this.begun.get(number), goesOn = known?.state === state && known.progress >= 0;
    const begun = goesOn ? known : { state, progress, at: performance.now() }, gained = progress - begun.progress;
    this.begun.set(number, begun);
    if (state !== "running" || gained < 0.05) return "";
    const seconds = (performance.now() - begun.at) / 1000 * (1 - progress) / gained;
    return seconds > 90 ? `(about ${Math.round(seconds / 60)} min left)` : `(about ${Math.ceil(seconds)} s left)`;
  }

  // The line; what is under way stays in its place, so that no click is lost.
  list() {
    const line = byId("line"), rows = new Map([...line.children].map((row) => [row.dataset.number, row]));
    line.replaceChildren(...this.listed.map((command) => {
      const { number, symbol, state, progress, message } = command;
      const row = rows.get(String(number)) ?? make("li", {}, make("b"), make("progress", { max: 1 }), make("p"), make("span"));
      const [title, bar, told, buttons] = row.children;
      row.dataset.number = number;
      row.title = command.arguments;
      title.textContent = `${number} ${symbol} ${state === "running" ? "" : state}`;
      if (progress >= 0) bar.value = progress; else bar.removeAttribute("value");
      told.textContent = [progress > 0 ? `${Math.round(100 * progress)} %` : "", message, this.left(command)]
        .filter(Boolean).join(" ");
      const key = this.operable ? state : "";
      if (buttons.dataset.shown !== key) {
        buttons.dataset.shown = key;
        const ask = (request) => () => this.ask(request, String(number));
        const steer = () => [
          state === "paused" ? button("resume", `go on with command ${number}`, ask("resume"))
            : button("pause", `let what runs of command ${number} end, and begin nothing more`, ask("pause")),
          button("cancel", `end command ${number}`, ask("cancel"))];
        const lastResort = () => [button("abandon", `last resort: end command ${number} at once`, () => {
          if (confirm(`Abandon command ${number}? Its actions are cancelled and not awaited: something may still move.`)) ask("abandon")();
        })];
        buttons.replaceChildren(...(!this.operable ? [] : state === "cancelling" ? lastResort() : steer()));
      }
      return row;
    }));
    for (const number of this.begun.keys()) if (!this.listed.some((command) => command.number === number)) this.begun.delete(number);
    byId("idle").hidden = this.listed.length > 0;
  }

  end(ended) {
    const picture = (href, number) => make("a", { href, target: "_blank" },
      make("img", { src: href, alt: `${href.split("/").pop()} of command ${number}` }));
    byId("ended").replaceChildren(...ended.toReversed().map(({ number, symbol, success, message, results, pictures }) =>
      make("li", { className: success ? "done" : "failed" },
        make("b", { textContent: `${number} ${symbol} ${success ? "done" : "failed"}` }),
        make("p", { textContent: message }),
        ...Object.entries(results)
          .filter(([, value]) => success || value !== JSON.stringify(message))  // it is said above
          .map(([name, value]) => make("code", { textContent: `${name}: ${value}` })),
        ...(pictures ?? []).map((path) => picture(`results/${path}`, number)))));
  }

  diagnose(statuses) {
    const wrong = statuses.filter(({ level }) => level > 0);
    byId("health").textContent = wrong.length ? `Diagnostics: ${wrong.length} of ${statuses.length} not ok` : `Diagnostics: ${statuses.length} ok`;
    byId("health").classList.toggle("bad", wrong.length > 0);
    byId("diagnostics").replaceChildren(...statuses.map(({ name, level, message }) =>
      make("li", { className: level > 0 ? "failed" : "" }, make("b", { textContent: name }), ` ${LEVELS[level] ?? level}: ${message}`)));
  }
}
