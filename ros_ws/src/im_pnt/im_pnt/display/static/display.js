// Draws the nets that the server tells of. The page is its address: #nets=a,b&only=a.p1,b.t2&filter=spot
const SVG = "http://www.w3.org/2000/svg";
const GAP = 60, TITLE = 26, KEPT = 300;
const byId = (id) => document.getElementById(id);

const nets = new Map();      // name -> description with drawing
const markings = new Map();  // name -> {tokens, active}
const elements = new Map();  // "net.node" -> {group, token}
const firings = [];
const page = readPage();
let view = { x: 0, y: 0, scale: 1 };
let extent = { width: 1, height: 1 };

function readPage() {
  const query = new URLSearchParams(location.hash.slice(1));
  const list = (key) => new Set((query.get(key) || "").split(",").filter(Boolean));
  return { nets: list("nets"), only: list("only"), overview: query.get("overview") === "1", filter: query.get("filter") || "" };
}

function keepPage() {
  const query = new URLSearchParams();
  if (page.nets.size) query.set("nets", [...page.nets].join(","));
  if (page.only.size) query.set("only", [...page.only].join(","));
  if (page.overview) query.set("overview", "1");
  if (page.filter) query.set("filter", page.filter);
  history.replaceState(null, "", "#" + query);
}

function make(name, attributes, parent) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (parent) parent.append(element);
  return element;
}

const shownNets = () => [...nets.keys()].sort().filter((name) =>
  page.overview ? [...page.only].some((key) => key.startsWith(name + ".")) : !page.nets.size || page.nets.has(name));

function visible(net, node) { return !page.overview || page.only.has(`${net}.${node.name}`); }

// In an overview the parts keep their order but not the empty space between them.
function compact(values, step) {
  const levels = [...new Set(values.map((v) => Math.round(v / 8)))].sort((a, b) => a - b);
  let at = 0, last = null;
  const where = new Map();
  for (const level of levels) {
    at += last === null ? 0 : Math.min((level - last) * 8, step);
    where.set(level, at);
    last = level;
  }
  return (v) => where.get(Math.round(v / 8));
}

function placed(name) {
  const drawing = nets.get(name).drawing;
  const nodes = drawing.nodes.filter((node) => visible(name, node));
  if (!page.overview) return { nodes: nodes.map((n) => ({ ...n })), arcs: drawing.arcs, size: drawing.size };
  const mapX = compact(nodes.map((n) => n.x), 150), mapY = compact(nodes.map((n) => n.y), 56);
  const moved = nodes.map((n) => ({ ...n, x: mapX(n.x) + n.width / 2 + 20, y: mapY(n.y) + 30 }));
  const at = new Map(moved.map((n) => [n.name, n]));
  const arcs = drawing.arcs.filter((a) => at.has(a.source) && at.has(a.target)).map((a) => ({
    ...a, points: [rim(at.get(a.source), at.get(a.target)), rim(at.get(a.target), at.get(a.source))] }));
  const width = Math.max(120, ...moved.map((n) => n.x + n.width / 2 + 20));
  return { nodes: moved, arcs, size: [width, Math.max(60, ...moved.map((n) => n.y + 30))] };
}

function rim(node, other) {
  const dx = other.x - node.x, dy = other.y - node.y, length = Math.hypot(dx, dy) || 1;
  if (node.kind !== "transition") return [node.x + dx / length * 11, node.y + dy / length * 11];
  const scale = Math.min(dx ? node.width / 2 / Math.abs(dx) : 1e9, dy ? 11 / Math.abs(dy) : 1e9);
  return [node.x + dx * scale, node.y + dy * scale];
}

function drawAll() {
  const scene = byId("scene");
  scene.replaceChildren();
  elements.clear();
  const spots = new Map();
  let x = 0, height = 0;
  for (const name of shownNets()) {
    const part = placed(name);
    const group = make("g", { class: "net", transform: `translate(${x},0)` }, scene);
    make("rect", { width: part.size[0], height: part.size[1] + TITLE, rx: 6 }, group);
    make("text", { x: 10, y: 18 }, group).textContent = name;
    const inner = make("g", { transform: `translate(0,${TITLE})` }, group);
    for (const arc of part.arcs) drawArc(inner, name, arc);
    for (const node of part.nodes) {
      drawNode(inner, name, node);
      spots.set(`${name}.${node.name}`, { ...node, x: node.x + x, y: node.y + TITLE });
    }
    x += part.size[0] + GAP;
    height = Math.max(height, part.size[1] + TITLE);
  }
  for (const node of spots.values()) {
    const target = node.link && spots.get(node.link);
    if (!target) continue;
    const points = [rim(node, target), rim(target, node)];
    make("polyline", { class: "arc between", points: points.join(" "), "marker-end": "url(#tip)" }, scene);
  }
  extent = { width: Math.max(1, x - GAP), height: Math.max(1, height) };
  for (const name of markings.keys()) showMarking(name);
  applyFilter();
  listNets();
  byId("overview").textContent = `overview of ${page.only.size}`;
  byId("overview").classList.toggle("on", page.overview);
}

function drawArc(parent, net, arc) {
  const line = make("polyline", { class: `arc ${arc.kind}`, points: arc.points.join(" ") }, parent);
  line.dataset.ends = `${arc.source} ${arc.target}`;
  const [x, y] = arc.points[arc.points.length - 1];
  if (arc.kind === "inhibitor") make("circle", { cx: x, cy: y, r: 3, fill: "white", stroke: "#7b8794" }, parent);
  else line.setAttribute("marker-end", "url(#tip)");
  if (arc.weight > 1) make("text", { x: x + 5, y: y - 6 }, parent).textContent = arc.weight;
}

function drawNode(parent, net, node) {
  const key = `${net}.${node.name}`;
  const group = make("g", { class: `node ${node.kind}` + (page.only.has(key) ? " chosen" : "") }, parent);
  group.dataset.name = node.name;
  make("title", {}, group).textContent = node.note ? `${node.name}: ${node.note}` : node.name;
  let token = null;
  if (node.kind === "transition") {
    make("rect", { x: node.x - node.width / 2, y: node.y - 11, width: node.width, height: 22, rx: 2 }, group);
    make("text", { x: node.x, y: node.y + 4, "text-anchor": "middle" }, group).textContent = node.label;
  } else {
    make("circle", { class: "rim", cx: node.x, cy: node.y, r: 11 }, group);
    token = make("g", { class: "token" }, group);
    make("text", { x: node.x + 15, y: node.y + 4 }, group).textContent = node.label;
  }
  group.addEventListener("click", () => {
    if (!page.only.delete(key)) page.only.add(key);
    group.classList.toggle("chosen", page.only.has(key));
    byId("overview").textContent = `overview of ${page.only.size}`;
    keepPage();
    if (page.overview) drawAll();
  });
  elements.set(key, { group, token, x: node.x, y: node.y });
}

function showMarking(net) {
  const { tokens, active } = markings.get(net);
  const running = new Set(active);
  for (const [key, element] of elements) {
    if (!key.startsWith(net + ".")) continue;
    const name = element.group.dataset.name;
    if (`${net}.${name}` !== key) continue;
    if (!element.token) { element.group.classList.toggle("active", running.has(name)); continue; }
    const count = tokens[name] || 0;
    element.group.classList.toggle("marked", count > 0);
    element.token.replaceChildren();
    if (count === 1) make("circle", { cx: element.x, cy: element.y, r: 4.5 }, element.token);
    else if (count > 1) make("text", { x: element.x, y: element.y + 4, "text-anchor": "middle" }, element.token).textContent = count;
  }
}

function flash(firing) {
  const element = elements.get(`${firing.net}.${firing.transition}`);
  if (!element) return;
  const kind = firing.phase === "FAILED" ? "failed" : "fired";
  element.group.classList.remove("fired", "failed");
  element.group.getBoundingClientRect();
  element.group.classList.add(kind);
}

function applyFilter() {
  const wanted = page.filter.toLowerCase();
  const hit = (name) => !wanted || name.toLowerCase().includes(wanted);
  for (const { group } of elements.values()) group.classList.toggle("dim", !hit(group.dataset.name));
  for (const line of document.querySelectorAll(".arc"))
    line.classList.toggle("dim", Boolean(wanted) && !(line.dataset.ends || "").split(" ").every(hit));
}

function listNets() {
  const shown = new Set(shownNets());
  byId("nets").replaceChildren(...[...nets.values()].sort((a, b) => a.net.localeCompare(b.net)).map((net) => {
    const label = document.createElement("label");
    label.title = net.description || net.net;
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: shown.has(net.net) });
    box.addEventListener("change", () => {
      page.nets = new Set(shownNets());
      if (box.checked) page.nets.add(net.net); else page.nets.delete(net.net);
      if (page.nets.size === nets.size) page.nets.clear();
      page.overview = false;
      keepPage(); drawAll(); fit();
    });
    const node = document.createElement("small");
    node.textContent = net.node;
    label.append(box, net.net, node);
    return label;
  }));
}

function listFirings() {
  const rows = firings.slice(-120).reverse().map((firing) => {
    const row = document.createElement("li");
    row.className = firing.phase;
    const time = document.createElement("time");
    time.textContent = firing.time.toFixed(3);
    const took = firing.duration > 0 ? ` ${firing.duration.toFixed(2)} s` : "";
    const symbol = firing.symbol ? ` [${firing.symbol}]` : "";
    const phase = firing.phase === "END" && !took ? "" : " " + firing.phase.toLowerCase();
    row.append(time, `${firing.net}.${firing.transition}${phase}${symbol}${took} ${firing.message}`);
    return row;
  });
  byId("firings").replaceChildren(...rows);
}

let listing = false;
function soon() {
  if (listing) return;
  listing = true;
  requestAnimationFrame(() => { listing = false; listFirings(); });
}

function take(change) {
  switch (change.kind) {
    case "snapshot": {
      nets.clear(); markings.clear(); firings.length = 0;
      for (const net of change.nets) nets.set(net.net, net);
      for (const marking of change.markings) markings.set(marking.net, marking);
      firings.push(...change.firings);
      drawAll(); fit(); soon();
      break;
    }
    case "net": nets.set(change.net, change); drawAll(); fit(); break;
    case "marking": markings.set(change.net, change); showMarking(change.net); break;
    case "firing":
      firings.push(change);
      if (firings.length > KEPT) firings.shift();
      flash(change); soon();
  }
}

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket.onopen = () => byId("link").classList.remove("off");
  socket.onmessage = (event) => take(JSON.parse(event.data));
  socket.onclose = () => { byId("link").classList.add("off"); setTimeout(connect, 1000); };
}

function applyView() { byId("scene").setAttribute("transform", `translate(${view.x},${view.y}) scale(${view.scale})`); }

function fit() {
  const box = byId("canvas").getBoundingClientRect();
  const scale = Math.min((box.width - 40) / extent.width, (box.height - 40) / extent.height, 1.4);
  view = { scale, x: (box.width - extent.width * scale) / 2, y: 20 };
  applyView();
}

byId("canvas").addEventListener("wheel", (event) => {
  event.preventDefault();
  const factor = Math.exp(-event.deltaY * 0.0015), box = byId("canvas").getBoundingClientRect();
  const x = event.clientX - box.left, y = event.clientY - box.top;
  view = { scale: view.scale * factor, x: x - (x - view.x) * factor, y: y - (y - view.y) * factor };
  applyView();
}, { passive: false });
byId("canvas").addEventListener("pointermove", (event) => {
  if (event.buttons !== 1) return;
  view.x += event.movementX; view.y += event.movementY;
  applyView();
});
byId("filter").value = page.filter;
byId("filter").addEventListener("input", (event) => { page.filter = event.target.value; keepPage(); applyFilter(); });
byId("fit").addEventListener("click", fit);
byId("all").addEventListener("click", () => { page.nets.clear(); page.overview = false; keepPage(); drawAll(); fit(); });
byId("clear").addEventListener("click", () => { page.only.clear(); page.overview = false; keepPage(); drawAll(); fit(); });
byId("overview").addEventListener("click", () => {
  page.overview = !page.overview && page.only.size > 0;
  keepPage(); drawAll(); fit();
});
addEventListener("resize", fit);
addEventListener("hashchange", () => { Object.assign(page, readPage()); drawAll(); fit(); });
connect();
