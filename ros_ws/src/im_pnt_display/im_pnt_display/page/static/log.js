// The log of the machine's nodes: the last lines, by node and level.
const byId = (id) => document.getElementById(id);
const KEPT = 300, LEVELS = ["debug", "info", "warning", "error", "fatal"];

export class Log {
  constructor() {
    this.lines = [];
    this.nodes = new Set();
    this.due = false;
    for (const id of ["log-level", "log-node"]) byId(id).addEventListener("change", () => this.list());
    byId("log").addEventListener("toggle", () => this.list());
  }

  clear() {
    this.lines = [];
    this.take([]);
  }

  take(lines) {
    this.lines = [...this.lines, ...lines].slice(-KEPT);
    for (const [, , node] of lines) {
      if (this.nodes.has(node)) continue;
      this.nodes.add(node);
      byId("log-node").append(Object.assign(document.createElement("option"), { value: node, textContent: node }));
    }
    const wrong = this.lines.filter(([, level]) => LEVELS.indexOf(level) >= 2).length;
    byId("logged").textContent = wrong ? `Log: ${wrong} warnings and errors` : "Log";
    byId("logged").classList.toggle("bad", wrong > 0);
    this.list();
  }

  // A closed list is not made.
  list() {
    if (this.due || !byId("log").open) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      const least = LEVELS.indexOf(byId("log-level").value), node = byId("log-node").value;
      const shown = this.lines.filter(([, level, from]) => LEVELS.indexOf(level) >= least && (!node || from === node));
      byId("log-lines").replaceChildren(...shown.reverse().map(([at, level, from, text]) => {
        const row = Object.assign(document.createElement("li"), { className: level });
        const time = new Date(1000 * at).toLocaleTimeString();
        row.append(Object.assign(document.createElement("time"), { textContent: time }), ` ${from}${level === "info" ? "" : ` (${level})`}: ${text}`);
        return row;
      }));
    });
  }
}
