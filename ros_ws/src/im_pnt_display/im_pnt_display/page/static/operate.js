// The controls of one net: how it is operated, what waits to be confirmed, and what became of actions in doubt.
function button(text, title, act) {
  const element = Object.assign(document.createElement("button"), { textContent: text, title });
  element.addEventListener("click", act);
  return element;
}

// Puts the controls of a net into an element, or takes them out where the page may not operate it (shown is false).
// They are made anew only where they would be others: with each marking, clicks between press and release got lost.
export function showControls(element, shown, net, marking, breakpoints, ask) {
  const { mode, paused, proposed, in_doubt } = marking || {};
  const key = shown ? JSON.stringify([net, mode, paused, proposed, in_doubt, breakpoints]) : "";
  if (element.dataset.shown === key) return;
  element.dataset.shown = key;
  element.replaceChildren(...(shown ? controls(net, marking, breakpoints, ask) : []));
}

// ask(net, request, argument) sends a request to the node that runs the net.
function controls(net, marking, breakpoints, ask) {
  const { mode = "automatic", paused = false, proposed = [], in_doubt = [] } = marking || {};
  const modes = document.createElement("select");
  modes.title = `how ${net} fires: by itself, each firing confirmed, or one at a time`;
  modes.append(...["automatic", "supervised", "step"].map((name) =>
    Object.assign(document.createElement("option"), { value: name, textContent: name, selected: name === mode })));
  modes.addEventListener("change", () => ask(net, modes.value, ""));
  const parts = [modes, paused
    ? button("Resume", "let it fire again", () => ask(net, "resume", ""))
    : button("Pause", "fire nothing more; what runs goes on", () => ask(net, "pause", ""))];
  if (mode === "step") parts.push(button("Step", "fire one transition", () => ask(net, "step", "")));
  for (const transition of proposed)
    parts.push(button(`${breakpoints.includes(transition) ? "Go on" : "Confirm"} ${transition}`, "let it fire", () => ask(net, "confirm", transition)));
  for (const transition of breakpoints)
    parts.push(button(`Clear ${transition}`, "clear the breakpoint", () => ask(net, "clear", transition)));
  for (const transition of in_doubt) {
    const text = Object.assign(document.createElement("span"), { className: "doubt", textContent: `${transition}?` });
    text.title = "nobody has said what became of this action";
    parts.push(text, ...["done", "failed"].map((outcome) =>
      button(outcome, `it is ${outcome}: go on so`, () => ask(net, "resolve", `${transition}=${outcome}`))));
  }
  return parts;
}
