// One part of a net: what its tokens, its running actions and its last answers stand for, and its breakpoint.
const byId = (id) => document.getElementById(id);
const AGAIN_MS = 700;  // between two questions about the same part, however often its net fires

function make(tag, text, className = "") {
  return Object.assign(document.createElement(tag), { textContent: text, className });
}

// Values by name, as JSON texts: a term and its value each.
function values(title, named) {
  const rows = Object.entries(named ?? {});
  if (!rows.length) return [];
  const list = document.createElement("dl");
  for (const [name, value] of rows) list.append(make("dt", name), make("dd", value));
  return [make("h3", title), list];
}

function owner({ command, symbol, failure }) {
  const whose = symbol === undefined ? "of no command" : command ? `${symbol}, command ${command}` : symbol;
  return make("b", failure ? `${whose}, after: ${failure}` : whose, failure ? "failed" : "");
}

export class Part {
  // ask(net, request, argument) asks the node that runs the net; known(net, part) returns what the page knows itself:
  // tokens, whether it waits and has a breakpoint, its last firings, and the transitions inside; live tells whether values can be asked for.
  constructor(ask, known, live) {
    Object.assign(this, { ask, known, live, at: null, due: null, asked: 0 });
    byId("part-close").addEventListener("click", () => this.close());
    byId("part-break").addEventListener("click", () =>
      ask(this.at.net, this.known(this.at).breakpoint ? "clear" : "break", this.at.name));
    byId("part-go").addEventListener("click", () => ask(this.at.net, "confirm", this.at.name));
    addEventListener("keydown", (event) => { if (event.key === "Escape") this.close(); });
  }

  open(net, node) {
    this.at = { net, name: node.place || node.name, isPlace: node.kind !== "transition", subnet: Boolean(node.subnet) };
    byId("part").hidden = false;
    byId("part-name").textContent = `${net}.${this.at.name}`;
    byId("part-values").replaceChildren();
    byId("part-inside").replaceChildren(...this.known(this.at).inside.map((one) => {
      const button = make("button", one.name);
      button.addEventListener("click", () => this.open(net, one));
      return button;
    }));
    this.refresh(net);
  }

  close() {
    this.at = null;
    byId("part").hidden = true;
  }

  // Shows what is known, and asks for the rest; called with each change of a net.
  refresh(net) {
    if (this.at?.net !== net) return;
    const { tokens, waits, breakpoint, firings } = this.known(this.at), { isPlace, subnet } = this.at;
    byId("part-state").textContent = isPlace ? `${tokens} token${tokens === 1 ? "" : "s"}`
      : [waits && "waits to be confirmed", breakpoint && "breakpoint"].filter(Boolean).join(", ");
    byId("part-break").hidden = isPlace || subnet || !this.live();
    byId("part-break").textContent = breakpoint ? "clear the breakpoint" : "break before it";
    byId("part-go").hidden = !waits;
    byId("part-firings").replaceChildren(...firings.map(({ time, phase, duration, message }) => make("li",
      [`t = ${time.toFixed(3)} s ${phase.toLowerCase()}`, duration > 0 && `took ${duration.toFixed(2)} s`, message].filter(Boolean).join(", "))));
    if (!this.live() || this.due) return;
    this.due = setTimeout(() => {
      this.due = null;
      this.asked = performance.now();
      if (this.at) this.ask(this.at.net, "values", this.at.name);
    }, Math.max(0, this.asked + AGAIN_MS - performance.now()));
  }

  take({ net, part, content }) {
    if (this.at?.net !== net || this.at.name !== part) return;
    const { tokens = [], running = [], answers = [], objects = {} } = content;
    const parts = [
      ...tokens.flatMap((token) => [owner(token), ...values("arguments", token.arguments), ...values("results", token.results)]),
      ...running.flatMap((one) => [make("b", `${one.does}: ${one.state.replace("_", " ")} for ${one.lasts} s`), owner(one),
        ...values("arguments", one.arguments)]),
      ...answers.flatMap((one) => [make("b", "last answer, "), owner(one), ...values("answer", one.answer)]),
      ...values("data objects", objects),
    ];
    byId("part-values").replaceChildren(...(parts.length ? parts : [make("span", "no values now")]));
  }
}
