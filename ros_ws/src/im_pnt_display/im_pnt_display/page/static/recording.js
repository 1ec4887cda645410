// A recording: the server tells the nets at any moment and what follows it; here is the time line to scroll in.
import { isTyping } from "./player.js";

const byId = (id) => document.getElementById(id);
const ROW = 13, LABELS = 250, AXIS = 18, ENOUGH = 60;
const COLORS = ["paper", "ground", "soft", "ink", "line", "bad", "doubt", "pick"];

export class Recording {
  // onMoment(moment) shows the nets as they were, onChange(change) what happens next; onRest() is told that it stands
  // still, onError(message) why it cannot go on.
  constructor(onMoment, onChange, onRest, onError) {
    Object.assign(this, { onMoment, onChange, onRest, onError });
    this.overview = null;
    this.colors = {};
    this.at = 0;          // testbed time since the first firing [s]
    this.firing = 0;      // how many have been
    this.steps = [];      // what comes next
    this.more = false;    // whether something comes after them
    this.playing = false;
    this.asked = 0;
    this.sought = 0;
    this.played = 0;
    this.arrival = Promise.resolve();  // of the last place or step that was asked for
    byId("begin").addEventListener("click", () => this.seek({ firing: 0 }));
    byId("back").addEventListener("click", () => this.back());
    byId("play").addEventListener("click", () => this.play(!this.playing));
    byId("on").addEventListener("click", () => this.on());
    byId("end").addEventListener("click", () => this.seek({ firing: this.overview.firings }));
    byId("seek").addEventListener("input", (event) => this.seek({ at: event.target.value }));
    const lines = byId("timeline");
    const there = (event) => (event.offsetX - this.labels) / this.perSecond();
    lines.addEventListener("pointerdown", (event) => {
      lines.setPointerCapture(event.pointerId);
      this.seek({ at: this.within(there(event)) });
    });
    lines.addEventListener("pointermove", (event) => {
      if (event.buttons === 1) this.seek({ at: this.within(there(event)) });
      lines.title = this.told(Math.floor(event.offsetY / ROW), there(event));
    });
    addEventListener("keydown", (event) => {
      if (!this.overview || document.body.classList.contains("playing") || isTyping(event)) return;
      const act = { " ": () => this.play(!this.playing), ArrowLeft: () => this.back(), ArrowRight: () => this.on(),
        Home: () => this.seek({ firing: 0 }), End: () => this.seek({ firing: this.overview.firings }) }[event.key];
      if (act) { event.preventDefault(); act(); }
    });
  }

  // Shows a recording from a time on; again after a lost connection, where it was.
  open(overview, at) {
    this.overview = overview;
    this.cellAt = null;
    document.body.classList.add("recorded");
    byId("name").textContent = overview.name;
    byId("seek").max = overview.end;
    byId("gaps").textContent = overview.gaps.join("; ");
    this.draw();
    if (!this.drawn) {
      this.drawn = new ResizeObserver(() => this.draw());
      this.drawn.observe(byId("lines"));
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    }
    this.seek({ at: this.within(at) });
  }

  // Shows the cell of each moment, or no more; what changed since the last one is fetched, one after the other.
  watchCell(yes) {
    this.watching = yes && Boolean(this.overview?.cell);
    if (this.watching) this.fetchCell();
  }

  async fetchCell() {
    if (this.fetching) return;
    this.fetching = true;
    try {
      while (this.watching && this.cellAt !== this.at) {
        const at = this.at, answer = await fetch(`/cell.json?${new URLSearchParams({ at, since: this.cellAt ?? "" })}`);
        if (!answer.ok) throw new Error(await answer.text());
        for (const change of await answer.json()) this.onChange(change);
        this.cellAt = at;
      }
    } catch (error) {
      this.watching = false;
      this.onError(error.message);
    } finally {
      this.fetching = false;
    }
  }

  within(at) { return Math.min(Math.max(at, 0), this.overview.end); }

  async load(place) {
    const answer = await fetch(`/recording.json?${new URLSearchParams(place)}`);
    if (!answer.ok) throw new Error(await answer.text());
    return answer.json();
  }

  // Goes to {at: seconds} or {firing: number}; what was asked for before it counts no more.
  seek(place) {
    if (!("at" in place)) this.play(false);
    this.asked++;
    return this.arrival = this.go(place);
  }

  // Takes a step from where everything leads that was asked for before it.
  step(act) {
    this.play(false);
    const { asked } = this;
    return this.arrival = this.arrival.then(() => asked === this.asked ? act() : null);
  }

  async go(place) {
    const sought = ++this.sought;
    if ("at" in place) this.at = Number(place.at);
    this.tell();
    try {
      const moment = await this.load(place);
      if (sought !== this.sought) return;
      Object.assign(this, { at: moment.at, firing: moment.firing, steps: moment.steps, more: moment.more });
      this.onMoment(moment);
    } catch (error) {
      this.onError(error.message);
    }
    this.tell();
  }

  // Fetches what comes after the steps that are here.
  extend() { return this.more ? this.extending ??= this.fetchSteps() : null; }

  async fetchSteps() {
    const sought = this.sought;
    try {
      const moment = await this.load({ firing: this.steps.at(-1)?.firing ?? this.firing });
      if (sought !== this.sought) return;
      this.steps.push(...moment.steps);
      this.more = moment.more;
    } catch (error) {
      this.play(false);
      this.onError(error.message);
    } finally {
      this.extending = null;
    }
  }

  take() {
    const step = this.steps.shift();
    this.firing = step.firing;
    step.changes.forEach((change) => this.onChange(change));
    return step.at;
  }

  back() { return this.step(() => this.go({ firing: Math.max(this.firing - 1, 0) })); }

  on() {
    return this.step(async () => {
      if (!this.steps.length) await this.extend();
      for (const before = this.firing; this.steps.length && this.firing === before;) this.at = this.take();
      this.tell();
      this.onRest();
    });
  }

  // Plays or pauses; of several that are asked for quickly the last one counts.
  async play(yes) {
    if (yes && this.playing) return;
    const rewound = yes && this.at >= this.overview.end ? this.seek({ firing: 0 }) : null;
    const played = ++this.played;  // after the seek, which pauses
    if (rewound) await rewound;
    if (played !== this.played || yes === this.playing) return;
    this.playing = yes;
    byId("play").textContent = yes ? "❚❚" : "▶";
    byId("play").title = yes ? "pause (space)" : "play (space)";
    if (!yes) { this.onRest(); return; }
    let last = performance.now();
    const tick = (now) => {
      if (played !== this.played) return;
      const until = this.within(this.at + (now - last) / 1000 * Number(byId("rate").value));
      last = now;
      while (this.steps.length && this.steps[0].at <= until) this.take();
      if (this.steps.length || !this.more) this.at = until;
      if (this.steps.length < ENOUGH) this.extend();
      this.tell();
      if (this.at >= this.overview.end && !this.steps.length && !this.more) this.play(false);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  // Says where it is, in numbers and on the time line.
  tell() {
    if (this.watching) this.fetchCell();
    byId("seek").value = this.at;
    byId("at").textContent = `${this.at.toFixed(3)} of ${this.overview.end.toFixed(1)} s`;
    byId("count").textContent = `firing ${this.firing} of ${this.overview.firings}`;
    const lines = byId("timeline"), pen = lines.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.drawImage(this.picture, 0, 0);
    pen.scale(devicePixelRatio, devicePixelRatio);
    pen.fillStyle = this.colors.bad;
    pen.fillRect(this.labels + this.at * this.perSecond() - 0.75, 0, 1.5, this.overview.rows.length * ROW);
  }

  // Width of the names beside the bars [px].
  get labels() { return Math.min(LABELS, 0.4 * byId("timeline").clientWidth); }

  perSecond() { return (byId("timeline").clientWidth - this.labels - 14) / (this.overview.end || 1); }

  // Draws the time line, once for a size: a row for each action, a bar for each time that it ran.
  draw() {
    const lines = byId("timeline"), { rows, bars, end } = this.overview, height = rows.length * ROW + AXIS;
    lines.style.height = `${height}px`;
    const width = lines.clientWidth;
    this.picture = document.createElement("canvas");
    for (const canvas of [lines, this.picture])
      Object.assign(canvas, { width: width * devicePixelRatio, height: height * devicePixelRatio });
    const pen = this.picture.getContext("2d"), scale = this.perSecond(), css = getComputedStyle(document.documentElement);
    for (const name of COLORS) this.colors[name] = css.getPropertyValue(`--${name}`);
    pen.scale(devicePixelRatio, devicePixelRatio);
    pen.fillStyle = this.colors.paper;
    pen.fillRect(0, 0, width, height);
    pen.font = "10px Arial, 'Liberation Sans', Helvetica, sans-serif";
    rows.forEach((label, row) => {
      pen.fillStyle = row % 2 ? this.colors.ground : this.colors.soft;
      pen.fillRect(0, row * ROW, width, ROW);
      pen.fillStyle = this.colors.ink;
      pen.fillText(label, 6, row * ROW + 10, this.labels - 10);
    });
    for (const [row, begin, stop, failed] of bars) {
      pen.fillStyle = failed ? this.colors.bad : stop === null ? this.colors.doubt : this.colors.pick;
      pen.fillRect(this.labels + begin * scale, row * ROW + 2, Math.max(((stop ?? end) - begin) * scale, 1), ROW - 4);
    }
    const raw = 80 / scale, power = 10 ** Math.floor(Math.log10(raw)), tick = [1, 2, 5, 10].find((n) => n * power >= raw) * power;
    pen.fillStyle = this.colors.line;
    for (let at = 0; at <= end; at += tick) {
      pen.fillRect(this.labels + at * scale, rows.length * ROW, 1, 4);
      pen.fillText(`${+at.toPrecision(6)} s`, this.labels + at * scale + 3, rows.length * ROW + 13);
    }
    this.tell();
  }

  // What ran there, in words.
  told(row, at) {
    const near = 2 / this.perSecond(), { rows, bars, end } = this.overview;
    const found = bars.find((bar) => bar[0] === row && bar[1] - near <= at && at <= (bar[2] ?? end) + near);
    if (!found) return rows[row] ?? "";
    const [, begin, stop, failed, command] = found, took = stop === null ? "not ended" : `${(stop - begin).toFixed(3)} s`;
    return `${rows[row]}: at ${begin.toFixed(3)} s, ${took}${failed ? ", failed" : ""}, command ${command}`;
  }
}
