// The drawing: nets as SVG with running transitions and arcs traced under the pointer; above it tokens and flashes of firings.
const SVG = "http://www.w3.org/2000/svg";
const STILL = matchMedia("(prefers-reduced-motion: reduce)");
const GAP = 28, TITLE = 44, RADIUS = 11, REFERENCE = 6.5, LINE = 12;

function make(name, attributes, parent, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  if (parent) parent.append(element);
  return element;
}

function rim(node, other) {
  const dx = other.x - node.x, dy = other.y - node.y, length = Math.hypot(dx, dy) || 1;
  if (node.kind !== "transition") return [node.x + dx / length * RADIUS, node.y + dy / length * RADIUS];
  const half = node.box[2] / 2;
  const scale = Math.min(dx ? node.box[0] / Math.abs(dx) : 1e9, dy ? half / Math.abs(dy) : 1e9);
  return [node.x + dx * scale, node.y + dy * scale];
}

const straight = ([x, y], [u, v]) => `M${x} ${y}L${u} ${v}`;

// A request leaves its transition sideways and reaches the place of the other net sideways.
function sideways(from, to) {
  const turn = to.x < from.x ? -1 : 1;
  const x = from.x + turn * from.box[0], u = to.x - turn * RADIUS, reach = turn * Math.max(30, Math.abs(u - x) / 3);
  return `M${x} ${from.y}C${x + reach} ${from.y} ${u - reach} ${to.y} ${u} ${to.y}`;
}

// In an overview the parts keep their rows and their order in a row, but not the empty space between them.
function gathered(drawing, picked) {
  const rows = new Map();
  for (const node of drawing.nodes.filter(picked)) rows.set(node.y, [...(rows.get(node.y) || []), node]);
  const at = new Map();
  let y = 20, width = 0;
  for (const [, row] of [...rows].sort((a, b) => a[0] - b[0])) {
    let x = 24;
    const height = Math.max(...row.map((node) => node.box[2]));
    for (const node of row.sort((a, b) => a.x - b.x)) {
      at.set(node.name, { ...node, x: x + node.box[0], y: y + height / 2 });
      x += node.box[0] + node.box[1] + 28;
    }
    width = Math.max(width, x);
    y += height + 40;
  }
  const arcs = drawing.arcs.filter((arc) => at.has(arc.source) && at.has(arc.target)).map((arc) => {
    const a = at.get(arc.source), b = at.get(arc.target);
    return { ...arc, path: straight(rim(a, b), rim(b, a)), tip: rim(b, a) };
  });
  return { nodes: [...at.values()], arcs, size: [width, y - 16] };
}

// Columns of nets, as many as make the whole largest on the screen.
function packed(parts, aspect) {
  let best = null;
  for (let count = 1; count <= parts.length; count++) {
    const columns = Array.from({ length: count }, () => ({ width: 0, height: 0, parts: [] }));
    for (const part of [...parts].sort((a, b) => b.size[1] - a.size[1])) {
      const column = columns.reduce((a, b) => (b.height < a.height ? b : a));
      column.parts.push(part);
      column.width = Math.max(column.width, part.size[0]);
      column.height += part.size[1] + GAP;
    }
    const width = columns.reduce((sum, column) => sum + column.width + GAP, -GAP);
    const height = Math.max(...columns.map((column) => column.height)) - GAP;
    const need = Math.max(width, height * aspect);
    if (!best || need < best.need) best = { need, columns, extent: { width, height } };
  }
  let x = 0;
  for (const column of best.columns) {
    let y = 0;
    for (const part of column.parts) { Object.assign(part, { x, y }); y += part.size[1] + GAP; }
    x += column.width + GAP;
  }
  return best.extent;
}

// Columns of an overview: a net each, callers left of those that they ask.
function inOrder(parts) {
  const callers = (part) => parts.filter((other) => other !== part && other.net.drawing.nodes.some((node) =>
    node.link.startsWith(part.net.net + ".")));
  const rank = (part, depth) => (depth > parts.length ? depth : Math.max(depth, ...callers(part).map((c) => rank(c, depth + 1))));
  let x = 0;
  for (const part of parts.map((p) => [rank(p, 0), p]).sort((a, b) => a[0] - b[0]).map(([, p]) => p)) {
    Object.assign(part, { x, y: 0 });
    x += part.size[0] + 2 * GAP;
  }
  return { width: x - 2 * GAP, height: Math.max(...parts.map((part) => part.size[1])) };
}

export class Scene {
  // root and above are SVG groups of two layers: above the nets is what moves.
  constructor(root, above, onPick) {
    Object.assign(this, { root, above, onPick });
    this.clear();
  }

  clear() {
    this.root.replaceChildren();
    this.above.replaceChildren();
    this.nodes = new Map();    // net -> Map(name -> {group, node})
    this.places = new Map();   // "net.place" -> its nodes, references too
    this.tokens = new Map();   // "net.name" -> {count, element} of each node with tokens
    this.states = new Map();   // net -> Map(transition -> its classes)
    this.arcs = [];            // {line, net, arc}
    this.between = [];         // {line, net, transition}
    this.spots = new Map();    // "net.name" -> node, with its place in the whole
    this.extent = { width: 1, height: 1 };
    this.flashes = new Map();  // "net.name" -> whether it failed, of this frame
    this.fading = new Map();   // "net.name" -> element
    this.due = null;
  }

  draw(nets, picked, aspect) {
    this.clear();
    if (!nets.length) return;
    const parts = nets.map((net) => {
      const part = picked ? gathered(net.drawing, (node) => picked.has(`${net.net}.${node.name}`)) : net.drawing;
      const wide = Math.max(part.size[0], 40 + 9 * net.net.length, picked ? 0 : 40 + 5.6 * net.description.length);
      return { net, nodes: part.nodes, arcs: part.arcs, size: [wide, part.size[1] + TITLE] };
    });
    this.extent = picked ? inOrder(parts) : packed(parts, aspect);
    const spots = this.spots;
    for (const part of parts) {
      this.drawNet(part, picked);
      for (const node of part.nodes)
        spots.set(`${part.net.net}.${node.name}`, { ...node, x: node.x + part.x, y: node.y + part.y + TITLE, part });
    }
    for (const [key, node] of spots) {
      if (node.kind !== "transition") {
        const place = `${node.part.net.net}.${node.place}`;
        this.places.set(place, [...(this.places.get(place) ?? []), { key, node }]);
      }
      const target = node.link && spots.get(node.link);
      if (!target) continue;
      const line = make("path", { class: "arc between", d: sideways(node, target),
        "marker-end": "url(#tip)" }, this.root);
      this.between.push({ line, net: node.part.net.net, transition: node.name });
    }
  }

  drawNet({ net, nodes, arcs, size, x, y }, picked) {
    const name = net.net, drawn = new Map();
    const group = make("g", { class: "net", transform: `translate(${x},${y})` }, this.root);
    make("rect", { width: size[0], height: size[1], rx: 6 }, group);
    make("text", { x: 14, y: 22 }, group, name);
    if (!picked) make("text", { class: "about", x: 14, y: 38 }, group, net.description);
    const inner = make("g", { transform: `translate(0,${TITLE})` }, group);
    for (const arc of arcs) {
      const line = make("path", { class: `arc ${arc.kind}`, d: arc.path }, inner);
      const [tipX, tipY] = arc.tip;
      if (arc.kind === "inhibitor") make("circle", { cx: tipX, cy: tipY, r: 3, class: "inhibits" }, inner);
      else line.setAttribute("marker-end", "url(#tip)");
      if (arc.weight > 1) make("text", { x: tipX + 6, y: tipY - 6 }, inner, arc.weight);
      this.arcs.push({ line, net: name, arc });
    }
    this.nodes.set(name, drawn);
    for (const node of nodes) drawn.set(node.name, this.drawNode(inner, name, node));
  }

  drawNode(parent, net, node) {
    const told = [node.kind, node.label, ...node.notes].join(", ");
    const group = make("g", { class: `node ${node.kind}`, tabindex: 0, role: "button", "aria-label": told }, parent);
    const [left, , height] = node.box;
    if (node.kind === "transition") {
      const inner = node.subnet ? 3 : 0, top = node.y - height / 2 + inner;
      make("rect", { x: node.x - left, y: node.y - height / 2, width: 2 * left, height, rx: 3 }, group);
      if (inner) make("rect", { x: node.x - left + inner, y: top, width: 2 * (left - inner), height: height - 2 * inner,
        rx: 3 }, group);
      make("circle", { class: "stop", cx: node.x - left, cy: node.y - height / 2, r: 5 }, group);
      make("text", { x: node.x, y: top + 15, "text-anchor": "middle" }, group, node.label);
      node.notes.forEach((note, line) => make("text", { class: /^[?!]/.test(note) ? "note tape" : "note", x: node.x,
        y: top + 15 + LINE * (line + 1), "text-anchor": "middle" }, group, note));
    } else {
      const radius = node.kind === "reference" ? REFERENCE : RADIUS;
      make("circle", { class: "rim", cx: node.x, cy: node.y, r: radius }, group);
      make("text", { x: node.x + radius + 4, y: node.y + (node.notes.length ? 1 : 4) }, group, node.label);
      node.notes.forEach((note, line) =>
        make("text", { class: "note", x: node.x + radius + 5, y: node.y + LINE * (line + 1) }, group, note));
    }
    group.addEventListener("click", () => this.onPick(net, node));
    group.addEventListener("keydown", (event) => { if (event.key === "Enter") this.onPick(net, node); });
    group.addEventListener("pointerenter", () => this.trace(net, node, true));
    group.addEventListener("pointerleave", () => this.trace(net, node, false));
    return { group, node };
  }

  // Marks the arcs of a part, of a place at all its references too.
  trace(net, node, on) {
    const same = new Set([node.name]);
    for (const other of this.nodes.get(net).values()) {
      if (!node.place || other.node.place !== node.place) continue;
      same.add(other.node.name);
      other.group.classList.toggle("same", on);
    }
    for (const { line, net: of, arc } of this.arcs)
      if (of === net && (same.has(arc.source) || same.has(arc.target))) line.classList.toggle("traced", on);
  }

  mark({ net, tokens, active, cancelling, in_doubt, proposed }) {
    if (!this.nodes.has(net)) return;
    const inNet = (key) => key.startsWith(`${net}.`);
    const counts = new Map(), states = new Map();
    for (const [place, count] of Object.entries(tokens)) {
      if (count <= 0) continue;
      const key = `${net}.${this.part(net, place)}`, box = this.spots.get(key);
      for (const { key, node } of this.places.get(`${net}.${place}`) ?? []) counts.set(key, { count, node });
      if (box?.subnet) counts.set(key, { count: count + (counts.get(key)?.count ?? 0), node: box });
    }
    for (const [state, names] of Object.entries({ active, cancelling, doubt: in_doubt, waits: proposed }))
      for (const name of names ?? []) {
        const part = this.part(net, name);
        states.set(part, [...(states.get(part) ?? []), state]);
      }
    for (const [key, { count, element }] of this.tokens) {
      if (!inNet(key) || counts.get(key)?.count === count) continue;
      element.remove();
      this.tokens.delete(key);
    }
    for (const [key, { count, node }] of counts)
      if (!this.tokens.has(key)) this.tokens.set(key, { count, element: this.drawToken(node, count) });
    const shown = this.states.get(net) ?? new Map();
    for (const part of new Set([...shown.keys(), ...states.keys()]))
      for (const state of ["active", "cancelling", "doubt", "waits"])
        this.nodes.get(net).get(part)?.group.classList.toggle(state, states.get(part)?.includes(state) ?? false);
    this.states.set(net, states);
    for (const link of this.between)
      if (link.net === net) link.line.classList.toggle("live", states.get(link.transition)?.includes("active") ?? false);
  }

  // Draws the tokens of a place: a dot for one, a number for several; those inside a folded subnet at a corner of its box.
  drawToken(node, count) {
    const token = make("g", {}, this.above), small = node.kind === "reference", inside = node.kind === "transition";
    const x = inside ? node.x + node.box[0] : node.x, y = inside ? node.y - node.box[2] / 2 : node.y;
    make("circle", { class: "under", cx: x, cy: y, r: (small ? REFERENCE : RADIUS) - 0.4 }, token);
    if (count > 1) make("text", { x, y: y + 4 }, token, count); else make("circle", { cx: x, cy: y, r: small ? 3 : 5 }, token);
    return token;
  }

  // Marks the breakpoints: transitions by net; those of a folded subnet at its box.
  stop(breakpoints) {
    for (const [net, nodes] of this.nodes) {
      const parts = new Set((breakpoints.get(net) ?? []).map((name) => this.part(net, name)));
      for (const [name, { group }] of nodes) group.classList.toggle("stops", parts.has(name));
    }
  }

  firstMarked() {
    for (const key of this.tokens.keys()) if (this.spots.get(key).kind === "place") return this.spots.get(key);
    return undefined;
  }

  // The drawn part that a transition belongs to: itself, or the subnet, or what the expanded net has made it of.
  part(net, name) {
    while (name && !this.nodes.get(net)?.has(name)) name = name.slice(0, Math.max(name.lastIndexOf("."), 0));
    return name;
  }

  flash({ net, transition, phase }) {
    const part = this.part(net, transition);
    if (!part) return;
    this.flashes.set(`${net}.${part}`, phase === "FAILED");
    this.due ??= requestAnimationFrame(() => this.flashAll(() => true));
  }

  // Shows the noted flashes of the parts that are seen, but for those that run.
  flashAll(isSeen) {
    cancelAnimationFrame(this.due);
    this.due = null;
    for (const [key, failed] of this.flashes) {
      const spot = this.spots.get(key), { net } = spot.part.net;
      if (STILL.matches || spot.kind !== "transition" || !isSeen(spot)) continue;
      if (!failed && this.states.get(net)?.get(spot.name)?.includes("active")) continue;
      this.fading.get(key)?.remove();
      const [left, , height] = spot.box;
      const box = make("rect", { class: failed ? "failed" : "fired", x: spot.x - left, y: spot.y - height / 2, width: 2 * left,
        height, rx: 3 }, this.above);
      this.fading.set(key, box);
      box.animate([{ opacity: 1 }, { opacity: 0 }], failed ? 1600 : 900).onfinish = () => {
        box.remove();
        if (this.fading.get(key) === box) this.fading.delete(key);
      };
    }
    this.flashes.clear();
  }

  flashPart(net, name) {
    this.flash({ net, transition: name, phase: /\.failed\b/.test(name) ? "FAILED" : "END" });
  }

  pick(picked) {
    for (const [net, nodes] of this.nodes)
      for (const [name, { group }] of nodes) group.classList.toggle("picked", picked.has(`${net}.${name}`));
  }

  filter(text) {
    const wanted = text.toLowerCase(), hits = new Set();
    for (const [net, nodes] of this.nodes)
      for (const { group, node } of nodes.values()) {
        const hit = [node.label, ...node.notes].some((line) => line.toLowerCase().includes(wanted));
        if (hit) hits.add(`${net}.${node.name}`);
        group.classList.toggle("dim", !hit);
      }
    for (const { line, net, arc } of this.arcs)
      line.classList.toggle("dim", !hits.has(`${net}.${arc.source}`) && !hits.has(`${net}.${arc.target}`));
  }
}
