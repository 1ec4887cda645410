// The page: what the server tells of, which nets are shown, and how. It is its address:
// #nets=a,b (or nets=all) shows these nets, #overview=1&only=a.p1,b.t2 these parts, &filter=spot dims the others,
// &rare=1 shows what tokens reach only after a failure, &cell=0 hides the cell. ?token=... lets it operate.
// A counterexample that is played takes the place of the running nets. Of a recording &t=12.5 shows that time [s].
import { CellView, excuse } from "/static/cell.js";
import { Commands } from "/static/commands.js";
import { Log } from "/static/log.js";
import { showControls } from "/static/operate.js";
import { Part } from "/static/part.js";
import { Player, readCounterexample, shown } from "/static/player.js";
import { Recording } from "/static/recording.js";
import { Scene } from "/static/scene.js";

const KEPT = 300, REFUSALS_KEPT = 20, LISTED = 120, PLAYER = 52, READABLE = 1, WIDE = 1100;
const byId = (id) => document.getElementById(id);
const nets = new Map();      // name -> description with drawing
const markings = new Map();  // name -> {tokens, active, cancelling, in_doubt, mode, paused, proposed}
const breakpoints = new Map();  // name -> transitions that wait to be confirmed each time
const refusals = new Map();  // name -> {message, counterexample}
const commands = new Map();  // name -> {progress, end} of its newest command
let begun = null;  // the net of the newest command
const firings = [];
const unfolded = new Set();  // nets of which a failure has brought tokens to a part that is folded
const token = new URLSearchParams(location.search).get("token");
let wrongToken = false;
let page = readPage();
let followed = null;
let socket = null;
let operable = false;        // whether this page may operate nets
let view = { x: 0, y: 0, scale: 1 }, moved = false;
let size = { width: 0, height: 0 };  // of the drawing's window; to ask for it would have the layout made
const scene = new Scene(byId("scene"), byId("tokens"), (net, node) => {
  if (dragged) return;
  const key = `${net}.${node.name}`;
  if (!page.only.delete(key)) page.only.add(key);
  refresh(page.overview);
  if (!player.counterexample) part.open(net, node);
});
const player = new Player(showStep, () => show({}));
const recording = new Recording(showMoment, take, keepPage, (message) => say(false, message));
const desk = new Commands((request, argument) => ask("", request, argument), say);
const log = new Log();
const part = new Part(ask, knownOf, () => !recording.overview);
const cell = new CellView(byId("robot"), byId("cameras"));

function readPage() {
  const query = new URLSearchParams(location.hash.slice(1));
  const list = (key) => new Set((query.get(key) || "").split(",").filter(Boolean));
  return { nets: list("nets"), only: list("only"), overview: query.get("overview") === "1", filter: query.get("filter") || "",
    rare: query.get("rare") === "1", cell: (query.get("cell") ?? (innerWidth >= WIDE ? "1" : "0")) === "1",
    at: Number(query.get("t")) || 0 };
}

function keepPage() {
  const query = new URLSearchParams();
  if (page.nets.size) query.set("nets", [...page.nets].join(","));
  if (page.only.size) query.set("only", [...page.only].join(","));
  if (page.overview) query.set("overview", "1");
  if (page.filter) query.set("filter", page.filter);
  if (page.rare) query.set("rare", "1");
  if (page.cell !== (innerWidth >= WIDE)) query.set("cell", page.cell ? "1" : "0");
  if (recording.overview) query.set("t", recording.at.toFixed(3));
  history.replaceState(null, "", "#" + query);
}

// Unless told otherwise the page follows commands: it shows the net that reads the newest one from its tape.
function follow() {
  const readers = [...nets.values()].filter((net) => net.symbols.length);
  const largest = (a, b) => (b.drawing.nodes.length > a.drawing.nodes.length ? b : a);
  return nets.has(begun) ? begun : (readers.length ? readers.reduce(largest).net : [...nets.keys()].sort()[0]);
}

function shownNets() {
  const names = [...nets.keys()].sort();
  if (page.overview) return names.filter((name) => [...page.only].some((key) => key.startsWith(name + ".")));
  if (page.nets.has("all")) return names;
  return names.filter((name) => (page.nets.size ? page.nets.has(name) : name === followed));
}

function show(change) {
  Object.assign(page, change);
  moved = false;
  refresh(true);
}

function refresh(redraw) {
  keepPage();
  if (redraw) {
    followed = follow();
    if (player.counterexample) drawCounterexample(); else drawLive();
    scene.filter(page.filter);
    if (!moved) settle();
  }
  scene.pick(page.only);
  byId("follow").classList.toggle("on", !page.overview && !page.nets.size);
  byId("all").classList.toggle("on", !page.overview && page.nets.has("all"));
  byId("overview").textContent = `overview of ${page.only.size}`;
  byId("overview").classList.toggle("on", page.overview);
  byId("rare").classList.toggle("on", page.rare);
  listNets();
}

function aspect() {
  const box = byId("canvas").getBoundingClientRect();
  return box.width / box.height;
}

// The drawing of a net: without what tokens reach only after a failure, until they do.
function drawn(net) {
  const whole = page.rare || page.overview || unfolded.has(net.net) || !net.usual;
  return whole ? net : { ...net, drawing: net.usual };
}

function drawLive() {
  scene.draw(shownNets().map((name) => drawn(nets.get(name))), page.overview ? page.only : null, aspect());
  for (const marking of markings.values()) scene.mark(marking);
  scene.stop(breakpoints);
}

let staged = null;
function drawCounterexample() {
  staged = player.counterexample;
  scene.draw(player.counterexample.drawings, null, aspect());
  markStep(player.counterexample.steps[player.at]);
}

function markStep({ markings }) {
  for (const [net, tokens] of Object.entries(markings)) scene.mark(shown(net, tokens));
}

function showStep(counterexample, step) {
  if (staged !== counterexample) show({}); else markStep(step);
  const several = counterexample.drawings.length > 1, dot = step.fired.indexOf(".");
  const net = several ? step.fired.slice(0, dot) : counterexample.drawings[0].net;
  scene.flashPart(net, several ? step.fired.slice(dot + 1) : step.fired);
}

// The nets of a recording as they were; they are drawn again only if they are others.
function showMoment(moment) {
  const drawn = JSON.stringify(moment.nets) === JSON.stringify(recording.shown);
  recording.shown = moment.nets;
  nets.clear(); markings.clear(); commands.clear(); firings.length = 0; begun = null;
  for (const number of moment.nets) enterNet(recording.overview.drawings[number]);
  for (const marking of moment.markings) markings.set(marking.net, marking);
  firings.push(...moment.firings);
  firings.forEach(noteCommand);
  if (drawn && followed === follow() && !player.counterexample) {
    for (const marking of moment.markings) scene.mark(marking);
    refresh(false);
  } else refresh(true);
  soon();
}

function enterNet(net) {
  const { nodes } = net.usual ?? net.drawing, shown = new Set(nodes.map((node) => node.place || node.name));
  const boxes = nodes.filter((node) => node.subnet).map((node) => `${node.name}.`);  // they show the tokens inside
  net.folded = new Set(net.drawing.nodes.map((node) => node.place || node.name)
    .filter((name) => !shown.has(name) && !boxes.some((box) => name.startsWith(box))));
  nets.set(net.net, net);
  unfolded.delete(net.net);
}

// Whether a marking has something in the part of its net that is folded.
function isRare({ net, tokens, active }) {
  const folded = nets.get(net)?.folded;
  return folded?.size > 0 && [...Object.keys(tokens).filter((place) => tokens[place]), ...active].some((name) => folded.has(name));
}

// Unfolds the net of a marking; returns whether that was needed.
function unfold(marking) {
  if (page.rare || unfolded.has(marking.net) || !isRare(marking)) return false;
  unfolded.add(marking.net);
  return shownNets().includes(marking.net);
}

function play(counterexample) {
  staged = null;
  player.open(counterexample);
  byId("player").scrollIntoView({ block: "nearest" });
}

async function playFile(file) {
  try {
    play(readCounterexample(await file.text()));
    say(true, "");
  } catch (error) {
    say(false, `${file.name} cannot be played: ${error.message}`);
  }
}

function say(success, message) {
  byId("answer").textContent = message;
  byId("answer").classList.toggle("bad", !success);
}

function ask(net, request, argument) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ net, request, argument }));
}

// What motion control says of itself; what is stale is said to be.
function showMcs(mcs) {
  const line = byId("mcs");
  line.hidden = !mcs;
  if (!mcs) return;
  const groups = Object.entries(mcs.groups).map(([group, state]) => `${group} ${state}`).join(", ");
  desk.condition(mcs);
  const said = `MCS ${mcs.state}${groups && ` (${groups})`}, power ${mcs.power ? "on" : "off"}, brakes ${mcs.brakes ? "on" : "off"}`;
  line.textContent = mcs.stale ? `/mcs is silent; it said last: ${said}` : [said, mcs.reason, mcs.protective_stop && `protective stop: ${mcs.protective_stop}`].filter(Boolean).join(": ");
  byId("stopped").hidden = !(mcs.state === "estopped" || mcs.protective_stop);
  byId("stopped").textContent = mcs.state === "estopped" ? `Emergency stop: ${mcs.reason}` : `Protective stop: ${mcs.protective_stop}`;
  line.title = mcs.reason;
  line.classList.toggle("stale", mcs.stale);
}

// What the page itself knows of a part of a net.
function knownOf({ net, name }) {
  const { tokens = {}, proposed = [] } = markings.get(net) ?? {};
  return { tokens: tokens[name] ?? 0, waits: proposed.includes(name), breakpoint: (breakpoints.get(net) ?? []).includes(name),
    inside: nets.get(net)?.drawing.nodes.filter((node) => node.kind === "transition" && node.name.startsWith(`${name}.`)) ?? [],
    firings: firings.filter((firing) => firing.net === net && firing.transition === name).slice(-3).reverse() };
}

// The breakpoints of the nets of a node; of a net that has moved to another node, those of the newest message.
const stopped = new Map();  // node -> transitions by net
function takeBreakpoints({ node, breakpoints: told }) {
  for (const net of Object.keys(stopped.get(node) ?? {})) breakpoints.delete(net);
  stopped.set(node, told);
  for (const [net, transitions] of Object.entries(told)) breakpoints.set(net, transitions);
  scene.stop(breakpoints);
  nets.forEach((_, name) => listRunning(name));
}

function listRefusals() {
  byId("refusals").replaceChildren(...[...refusals.values()].map(({ net, message, counterexample }) => {
    const row = document.createElement("li");
    row.append(Object.assign(document.createElement("span"), { textContent: `${net} was refused`, title: message }));
    if (counterexample.steps?.length) {
      const button = Object.assign(document.createElement("button"), { textContent: "play", title: "show why" });
      button.addEventListener("click", () => play(counterexample));
      row.append(button);
    }
    return row;
  }));
}

function dropRefusal(name) { if (refusals.delete(name)) listRefusals(); }

function listNets() {
  const shown = new Set(shownNets());
  byId("nets").replaceChildren(...[...nets.values()].sort((a, b) => a.net.localeCompare(b.net)).flatMap((net) => {
    const name = net.net;
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: shown.has(name) });
    box.setAttribute("aria-label", `show ${name}`);
    box.addEventListener("change", () => {
      if (box.checked) shown.add(name); else shown.delete(name);
      show({ nets: shown.size === nets.size ? new Set(["all"]) : shown, overview: false });
    });
    const link = Object.assign(document.createElement("a"), { href: `#nets=${name}`, textContent: name });
    link.title = `${net.description} (${net.node})`;
    link.addEventListener("click", (event) => {
      event.preventDefault();
      show({ nets: new Set([name]), overview: false });
    });
    const running = Object.assign(document.createElement("small"), { id: `running-${name}` });
    const bar = Object.assign(document.createElement("div"), { id: `bar-${name}`, className: "bar" });
    const operate = Object.assign(document.createElement("div"), { id: `operate-${name}`, className: "operate" });
    return [box, link, running, bar, operate];
  }));
  for (const name of nets.keys()) { listRunning(name); listProgress(name); }
}

function listRunning(name) {
  part.refresh(name);
  const running = byId(`running-${name}`);
  const active = (markings.get(name)?.active || []).join(", ");
  if (running && running.textContent !== active) running.textContent = active;
  const operate = byId(`operate-${name}`);
  if (operate) showControls(operate, operable && shownNets().includes(name), name, markings.get(name), breakpoints.get(name) ?? [], ask);
}

function listProgress(name) {
  const bar = byId(`bar-${name}`), command = commands.get(name);
  if (!bar || !command) return;
  bar.style.width = `${100 * (command.end ? 1 : command.progress)}%`;
  bar.className = `bar ${command.end}`;
}

// What the commands of nets with a tape came to, the newest last; its beginning may lie before this viewer's.
function noteCommand(firing) {
  const net = nets.get(firing.net);
  if (!net?.symbols.length) return;
  const { progress, symbol } = firing, begins = net.symbols.includes(symbol), ends = symbol && !begins;
  if (begins) {
    commands.delete(firing.net);
    unfolded.delete(firing.net);
  }
  if (begins || !ends && !commands.has(firing.net)) begun = firing.net;
  if (!commands.has(firing.net)) commands.set(firing.net, { progress: 0, end: "" });
  const command = commands.get(firing.net);
  command.progress = Math.max(progress, 0);
  if (ends) command.end = symbol.endsWith("_failed") ? "failed" : "done";
  listProgress(firing.net);
}

function listFirings() {
  byId("clock").textContent = firings.length ? `t = ${firings.at(-1).time.toFixed(3)} s` : "";
  byId("firings").replaceChildren(...firings.slice(-LISTED).reverse().map((firing) => {
    const row = document.createElement("li");
    const add = (tag, text) => row.append(Object.assign(document.createElement(tag), { textContent: text }));
    row.className = firing.phase;
    const symbol = firing.symbol && (nets.get(firing.net)?.symbols.includes(firing.symbol) ? "?" : "!") + firing.symbol;
    const ends = firing.phase === "END" && firing.duration > 0;
    add("time", firing.time.toFixed(3));
    const signs = { START: "▸ ", FAILED: "✗ ", CANCEL: "◂ ", DOUBT: "? ", END: ends ? "✓ " : "· " };
    add("b", (signs[firing.phase] ?? "") + firing.transition);
    add("em", [symbol, firing.message, firing.net].filter(Boolean).join("  "));
    add("span", firing.duration > 0 ? firing.duration.toFixed(2) : "");
    row.title = [`${firing.net}.${firing.transition}`, firing.phase.toLowerCase(), symbol, firing.message].join(" ");
    return row;
  }));
}

// What has changed is drawn once a frame, however often nets fire; the list of firings and the view follow less often,
// for nobody reads so fast.
const LIST_MS = 250, FOLLOW_MS = 500;
const changed = new Set();  // nets with a marking that is not drawn yet
let drawing = false, listed = 0, unlisted = false, led = 0, newest = null;
function soon(change = {}) {
  if (change.kind === "marking") changed.add(change.net);
  else unlisted = true;
  if (change.kind === "firing" && scene.nodes.has(change.net)) newest = change;  // other nets fire out of sight
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(drawChanges);
}

function drawChanges(now) {
  drawing = false;
  const names = [...changed].filter((name) => markings.has(name));
  changed.clear();
  if (names.filter((name) => unfold(markings.get(name))).length) refresh(true);
  else if (!player.counterexample) for (const name of names) scene.mark(markings.get(name));
  names.forEach(listRunning);
  scene.flashAll(isSeen);
  if (newest && now - led >= FOLLOW_MS) {
    if (!moved) keepInView(newest.net, scene.part(newest.net, newest.transition));
    newest = null;
    led = now;
  }
  if (unlisted && now - listed >= LIST_MS) {
    listFirings();
    unlisted = false;
    listed = now;
  }
  if (newest || unlisted) {
    drawing = true;
    requestAnimationFrame(drawChanges);
  }
}

function take(change) {
  switch (change.kind) {
    case "snapshot":
      nets.clear(); markings.clear(); commands.clear(); refusals.clear(); firings.length = 0; begun = null;
      operable = change.operable && token !== null && !wrongToken;
      desk.allow(operable);
      stopped.clear();
      change.breakpoints.forEach(takeBreakpoints);
      cell.clear();
      log.clear();
      log.take(change.log);
      unfolded.clear();
      change.nets.forEach(enterNet);
      for (const marking of change.markings) { markings.set(marking.net, marking); unfold(marking); }
      for (const part of change.commands) desk.take(part);
      for (const refusal of change.refusals) refusals.set(refusal.net, refusal);
      firings.push(...change.firings);
      firings.forEach(noteCommand);
      listRefusals(); showMcs(change.mcs); refresh(true); soon();
      if (change.recording) recording.open(change.recording, recording.overview ? recording.at : page.at);
      look();
      break;
    case "drawing":
      recording.shown = null;
      enterNet(recording.overview.drawings[change.drawing]); refresh(true);
      break;
    case "mcs": showMcs(change); break;
    case "breakpoints": takeBreakpoints(change); break;
    case "log": log.take(change.lines); break;
    case "values": part.take(change); break;
    case "commands": desk.take(change); break;
    case "cell": cell.take(change); break;
    case "net": enterNet(change); dropRefusal(change.net); refresh(true); break;
    case "gone":
      recording.shown = null;
      for (const known of [nets, markings, commands, page.nets]) known.delete(change.net);
      dropRefusal(change.net);
      refresh(true);
      break;
    case "marking":
      markings.set(change.net, change);
      soon(change);
      break;
    case "refusal":
      refusals.delete(change.net);
      refusals.set(change.net, change);
      if (refusals.size > REFUSALS_KEPT) refusals.delete(refusals.keys().next().value);
      listRefusals();
      break;
    case "answer":
      say(change.success, [change.net, change.message].filter(Boolean).join(": "));
      if (!change.success) {  // what was chosen is not so
        byId(`operate-${change.net}`)?.removeAttribute("data-shown");
        listRunning(change.net);
      }
      break;
    case "firing":
      firings.push(change);
      if (firings.length > KEPT) firings.shift();
      noteCommand(change);
      soon(change);
      if (player.counterexample) break;
      if (!page.nets.size && !page.overview && followed !== change.net && follow() === change.net) show({});
      scene.flash(change);
  }
}

// Has the server tell of the cell while it is seen, and only then.
function look() {
  const there = !recording.overview || recording.overview.cell, seen = page.cell && there && !document.hidden;
  document.body.classList.toggle("with-cell", page.cell && there);
  byId("show-cell").hidden = !there;
  recording.watchCell(seen);
  byId("show-cell").classList.toggle("on", page.cell);
  if (seen) cell.open().catch(excuse);
  ask("", "look", seen ? "cell" : "");
}

// A token that a former machine gave out is refused with a sentence; the page goes on without it.
async function checkToken() {
  if (token === null) return;
  const answer = await fetch(`/?${new URLSearchParams({ token })}`, { method: "HEAD", signal: AbortSignal.timeout(CONNECT_MS) });
  if (answer.status === 403 && !wrongToken) say(false, "the token in the address is not that of this machine; scripts/im view prints the right address");
  wrongToken = answer.status === 403;
}

// A connection that neither opens nor fails in time is given up, and tried again as one that has failed.
const CONNECT_MS = 10000;

async function connect() {
  await checkToken().catch(() => {});
  const query = token !== null && !wrongToken ? `?${new URLSearchParams({ token })}` : "";
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws${query}`);
  const connected = (yes) => {
    byId("link").classList.toggle("off", !yes);
    byId("link").textContent = yes ? "connected" : "disconnected";
    document.body.classList.toggle("lost", !yes);
  };
  socket.onopen = () => connected(true);
  socket.onmessage = (event) => { for (const line of event.data.split("\n")) take(JSON.parse(line)); };
  socket.onclose = () => { connected(false); setTimeout(connect, 1000); };
  const attempt = socket;
  setTimeout(() => { if (attempt.readyState === WebSocket.CONNECTING) attempt.close(); }, CONNECT_MS);
}

function applyView() {
  for (const layer of ["scene", "tokens"]) byId(layer).setAttribute("transform", `translate(${view.x},${view.y}) scale(${view.scale})`);
}

// The first sight: the whole where its letters can be read, else as large as that asks for, around the newest firing.
function settle() {
  fit();
  if (view.scale >= READABLE || page.overview) return;
  const box = canvas.getBoundingClientRect(), at = focus();
  view = { scale: READABLE, x: box.width / 2 - at.x * READABLE, y: box.height / 2 - at.y * READABLE };
  hold();
  applyView();
}

// Where the eye belongs: the newest firing, else the first marked place of the nets that are shown.
function focus() {
  const names = shownNets();
  const drawn = ({ net, transition }) => scene.spots.get(`${net}.${scene.part(net, transition)}`);
  const fired = firings.findLast((firing) => names.includes(firing.net) && drawn(firing));
  if (fired) return drawn(fired);
  return scene.firstMarked() ?? { x: scene.extent.width / 2, y: 0 };
}

// No empty space is shown beside a drawing that is larger than the window.
function hold() {
  const box = canvas.getBoundingClientRect(), { width, height } = scene.extent, edge = 16;
  const within = (at, room, size) => (size + 2 * edge < room ? (room - size) / 2 : Math.min(edge, Math.max(room - size - edge, at)));
  view.x = within(view.x, box.width, width * view.scale);
  view.y = within(view.y, box.height, height * view.scale);
}

// Whether a place of the drawing is in the window.
function isSeen({ x, y }) {
  const { width, height } = size, u = view.x + x * view.scale, v = view.y + y * view.scale;
  return u > -50 && v > -50 && u < width + 50 && v < height + 50;
}

// Moves the view to a part of a net that is outside its middle.
function keepInView(net, name) {
  const at = scene.spots.get(`${net}.${name}`), box = size;
  if (!at || player.counterexample) return;
  const x = view.x + at.x * view.scale, y = view.y + at.y * view.scale;
  if (x > 0.15 * box.width && x < 0.85 * box.width && y > 0.15 * box.height && y < 0.85 * box.height) return;
  view.x += box.width / 2 - x;
  view.y += box.height / 2 - y;
  hold();
  applyView();
}

// Goes to the next part that the search finds, in any net, folded or not.
let found = "";
function jump() {
  const wanted = page.filter.toLowerCase();
  if (!wanted) return;
  const first = shownNets(), order = [...first, ...[...nets.keys()].sort().filter((name) => !first.includes(name))];
  const hits = order.flatMap((net) => nets.get(net).drawing.nodes
    .filter((node) => node.kind !== "reference" && [node.label, ...node.notes].some((line) => line.toLowerCase().includes(wanted)))
    .map((node) => ({ net, node })));
  if (!hits.length) { say(false, `nothing is called ${page.filter}`); return; }
  const keys = hits.map(({ net, node }) => `${net}.${node.name}`), next = hits[(keys.indexOf(found) + 1) % hits.length];
  found = `${next.net}.${next.node.name}`;
  say(true, `${keys.indexOf(found) + 1} of ${hits.length}: ${found}`);
  if (!first.includes(next.net)) show({ nets: new Set([next.net]), overview: false });
  if (!scene.spots.has(found)) show({ rare: true, overview: false });
  const at = scene.spots.get(found), box = canvas.getBoundingClientRect(), scale = Math.max(view.scale, READABLE);
  view = { scale, x: box.width / 2 - at.x * scale, y: box.height / 2 - at.y * scale };
  moved = true;
  applyView();
  scene.flash({ net: next.net, transition: next.node.name, phase: "END" });
}

function fit() {
  const box = byId("canvas").getBoundingClientRect(), { width, height } = scene.extent;
  const top = player.counterexample ? PLAYER : 0;
  const scale = Math.max(Math.min((box.width - 32) / width, (box.height - top - 32) / height, 1.4), 0.05);
  view = { scale, x: (box.width - width * scale) / 2, y: Math.max(top + 16, (box.height - height * scale) / 3) };
  applyView();
}

let dragged = false;
const canvas = byId("canvas");
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  const box = canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
  const scale = Math.min(8, Math.max(0.1, view.scale * Math.exp(-event.deltaY * 0.0015))), factor = scale / view.scale;
  view = { scale, x: x - (x - view.x) * factor, y: y - (y - view.y) * factor };
  moved = true;
  applyView();
}, { passive: false });
canvas.addEventListener("pointerdown", () => { dragged = false; });
canvas.addEventListener("pointermove", (event) => {
  if (event.buttons !== 1 || (!event.movementX && !event.movementY)) return;
  view.x += event.movementX; view.y += event.movementY;
  dragged = moved = true;
  applyView();
});
byId("filter").value = page.filter;
byId("filter").addEventListener("input", (event) => {
  page.filter = event.target.value;
  keepPage(); scene.filter(page.filter);
});
byId("filter").addEventListener("keydown", (event) => { if (event.key === "Enter") jump(); });
byId("file").addEventListener("change", (event) => {
  if (event.target.files[0]) playFile(event.target.files[0]);
  event.target.value = "";
});
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  if (event.dataTransfer.files[0]) playFile(event.dataTransfer.files[0]);
});
byId("fit").addEventListener("click", () => { moved = true; fit(); });
byId("rare").addEventListener("click", () => show({ rare: !page.rare }));
byId("show-cell").addEventListener("click", () => { page.cell = !page.cell; keepPage(); look(); });
document.addEventListener("visibilitychange", look);
byId("follow").addEventListener("click", () => show({ nets: new Set(), overview: false }));
byId("all").addEventListener("click", () => show({ nets: new Set(["all"]), overview: false }));
byId("clear").addEventListener("click", () => show({ only: new Set(), overview: false }));
byId("overview").addEventListener("click", () => show({ overview: !page.overview && page.only.size > 0 }));
new ResizeObserver(([{ contentRect }]) => { size = contentRect; if (!moved) settle(); }).observe(canvas);
addEventListener("hashchange", () => {
  show(readPage());
  look();
  byId("filter").value = page.filter;
  if (recording.overview) recording.seek({ at: recording.within(page.at) });
});
connect();
