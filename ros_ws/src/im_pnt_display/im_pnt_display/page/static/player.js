// Plays a firing sequence, for instance a counterexample, step by step on the drawings that come with it.
const byId = (id) => document.getElementById(id);
const ACTIVE = /^(.+)\.(active|cancelling|in_doubt)$/;

// The marking of an expanded net as the scene shows it: an action that runs is a transition that is lit.
export function shown(net, tokens) {
  const lit = { active: [], cancelling: [], in_doubt: [] };
  for (const name of Object.keys(tokens)) {
    const match = ACTIVE.exec(name);
    if (!match) continue;
    lit.active.push(match[1]);
    if (match[2] !== "active") lit[match[2]].push(match[1]);
  }
  return { net, tokens, ...lit };
}

// Throws what is wrong with a text that is to be played.
export function readCounterexample(text) {
  const counterexample = JSON.parse(text);
  if (!Array.isArray(counterexample?.steps) || !counterexample.steps.length || !Array.isArray(counterexample.drawings))
    throw new Error("it is no counterexample with drawings: scripts/im pnt verify --counterexample FILE writes one");
  for (const net of counterexample.drawings)
    if (typeof net.net !== "string" || !Array.isArray(net.drawing?.nodes)) throw new Error("a net in it has no drawing");
  return counterexample;
}

// Whether a key is for the field that has the focus; Escape never is.
export function isTyping({ key, target }) {
  return key !== "Escape" && target.matches("input[type=search], input[type=text], select, textarea");
}

export class Player {
  // onStep(counterexample, step) draws; onEnd() goes back to the live nets.
  constructor(onStep, onEnd) {
    this.onStep = onStep;
    this.onEnd = onEnd;
    this.counterexample = null;
    byId("first").addEventListener("click", () => this.go(0));
    byId("previous").addEventListener("click", () => this.go(this.at - 1));
    byId("next").addEventListener("click", () => this.go(this.at + 1));
    byId("last").addEventListener("click", () => this.go(Infinity));
    byId("leave").addEventListener("click", () => this.close());
    addEventListener("keydown", (event) => {
      if (!this.counterexample || isTyping(event)) return;
      const move = { ArrowLeft: this.at - 1, ArrowRight: this.at + 1, Home: 0, End: Infinity }[event.key];
      if (move !== undefined) { event.preventDefault(); this.go(move); }
      if (event.key === "Escape") this.close();
    });
  }

  open(counterexample) {
    this.counterexample = counterexample;
    document.body.classList.add("playing");
    byId("reason").textContent = byId("reason").title = counterexample.reason;
    this.go(0);
  }

  close() {
    this.counterexample = null;
    document.body.classList.remove("playing");
    this.onEnd();
  }

  go(step) {
    const last = this.counterexample.steps.length - 1;
    this.at = Math.min(Math.max(step, 0), last);
    const { fired } = this.counterexample.steps[this.at], { repeats } = this.counterexample;
    const again = repeats !== null && this.at > repeats ? " (can be repeated for ever)" : "";
    byId("step").textContent = `${this.at} of ${last}`;
    byId("fired").textContent = this.at ? fired + again : "initial marking";
    for (const id of ["first", "previous"]) byId(id).disabled = this.at === 0;
    for (const id of ["next", "last"]) byId(id).disabled = this.at === last;
    this.onStep(this.counterexample, this.counterexample.steps[this.at]);
  }
}
