// The actuators of each module: commanded and measured state, lock, number of switches; press and hold to jog.

import { el, fill } from "./dom.js";
import { onHold } from "./hold.js";

const WORDS = ["contracted", "extended"];

export function showActuators(connection, notify) {
  const card = document.getElementById("actuators");
  const grid = el("div", { class: "grid", role: "listbox", "aria-label": "Actuators", tabIndex: 0 });
  const sentence = el("p");
  const jog = el("button", { type: "button", id: "jog" });
  const lockTo = (state) => async () =>
    notify(await connection.ask({ do: "lock", actuator: labels[chosen], state }), `${state === null ? "Unlock" : "Lock"} ${labels[chosen]}`);
  const locks = [0, 1].map((state) => el("button", { type: "button", onclick: lockTo(state) }, `Lock ${WORDS[state]}`));
  const unlock = el("button", { type: "button", onclick: lockTo(null) }, "Unlock");
  const buttons = el("div", { class: "buttons", hidden: true }, jog, ...locks, unlock);
  const detail = el("div", { class: "detail", hidden: true }, sentence, buttons);
  card.append(
    el("p", { class: "hint" }, "■ extended, □ contracted, ≠ measured differs, ? unknown, L locked"),
    grid,
    detail,
  );
  let labels = [];
  let cells = [];
  let chosen = null;
  let shown = "";
  let jogged = null; // the request of a hold
  onHold(jog, async () => notify(await connection.ask(jogged), `Jog ${jogged.actuator}`), notify);

  connection.on("arm", (arm) => {
    if (String(arm.actuators) === String(labels)) return;
    labels = arm.actuators;
    chosen = null;
    grid.removeAttribute("aria-activedescendant");
    detail.hidden = true;
    cells = labels.map((label, k) => el("button", { type: "button", id: `cell-${k}`, class: "cell", role: "option", tabIndex: -1, onclick: () => choose(k) }));
    const modules = new Map();
    labels.forEach((label, k) => {
      const module = label.split(".")[0];
      if (!modules.has(module)) modules.set(module, []);
      modules.get(module).push(cells[k]);
    });
    fill(grid, ...[...modules].map(([module, own]) => el("div", { class: "module", role: "group", "aria-label": `module ${module}` }, el("span", { class: "number", "aria-hidden": "true" }, module), ...own)));
    shown = "";
    describe();
  });
  connection.on("state", describe);
  connection.on("bodies", describe);
  connection.on("you", describe);
  connection.on("diagnostics", () => describe());
  grid.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: 1, ArrowUp: -1, Home: -Infinity, End: Infinity }[event.key];
    if (!step) return;
    event.preventDefault();
    choose(Math.min(Math.max((chosen ?? -Math.sign(step)) + step, 0), labels.length - 1));
  });

  function choose(k) {
    chosen = k;
    detail.hidden = false;
    grid.setAttribute("aria-activedescendant", cells[k].id);
    shown = "";
    describe();
    cells[k].scrollIntoView({ block: "nearest" });
  }

  function describe() {
    const state = connection.latest.state;
    if (!state || !cells.length) return;
    const locked = new Map(state.degraded.map((entry) => [entry.actuator, entry.state]));
    const count = chosen === null ? 0 : connection.latest.diagnostics?.counts?.[chosen];
    const viewer = !connection.mayCommand;
    const last = connection.latest.bodies?.last;
    const now = JSON.stringify([state.commanded, state.measured, last, state.degraded, chosen, count, viewer]);
    if (now !== shown) {
      shown = now;
      labels.forEach((label, k) => paint(cells[k], at(state, k), locked.has(label), k === chosen));
      if (chosen !== null) tell(at(state, chosen), locked.get(labels[chosen]), count);
    }
    if (chosen !== null) offer(labels[chosen], state.commanded?.[chosen] === 1 ? 0 : 1, locked.get(labels[chosen]));
  }

  // What is known of an actuator.
  function at({ commanded, measured }, k) {
    return { label: labels[k], commanded: commanded?.[k], measured: measured?.[k], last: connection.latest.bodies?.last?.[k] };
  }

  function tell(actuator, lock, count) {
    fill(sentence, el("b", {}, actuator.label), inWords(actuator).slice(actuator.label.length),
      lock === undefined ? "" : `, locked ${words(lock)}`, count === undefined ? "" : `; ${count} switches`);
  }

  // The buttons stay the same elements, so that a press and the focus outlast the next message.
  function offer(label, to, lock) {
    if (buttons.querySelector(".holding")) return;
    const focused = buttons.contains(document.activeElement) ? document.activeElement : null;
    buttons.hidden = !connection.mayCommand;
    jog.textContent = `Hold to ${to ? "extend" : "contract"}`;
    jog.setAttribute("aria-label", `${jog.textContent} ${label}`);
    jogged = { do: "jog", actuator: label, state: WORDS[to] };
    for (const it of locks) it.hidden = lock !== undefined;
    unlock.hidden = lock === undefined;
    if (focused?.hidden) (unlock.hidden ? locks[0] : unlock).focus();
  }
}

function words(state) {
  return WORDS[state] ?? "unknown";
}

function inWords({ label, commanded, measured, last }) {
  const before = isState(measured) || !isState(last) ? "" : `, last known ${words(last)}`;
  return `${label}: commanded ${words(commanded)}, measured ${words(measured)}${before}`;
}

// Fills the cell of an extended actuator; of unknown ones, by what was commanded or last known.
function paint(cell, actuator, locked, chosen) {
  const { commanded, measured, last } = actuator;
  const unknown = !isState(measured);
  const differs = !unknown && isState(commanded) && commanded !== measured;
  cell.textContent = unknown ? "?" : locked ? "L" : differs ? "≠" : "";
  cell.classList.toggle("extended", [commanded, measured, last].find(isState) === 1);
  cell.classList.toggle("differs", differs);
  cell.classList.toggle("unknown", unknown);
  cell.setAttribute("aria-selected", String(chosen));
  cell.title = `${inWords(actuator)}${locked ? ", locked" : ""}`;
  cell.setAttribute("aria-label", cell.title);
}

function isState(value) {
  return value === 0 || value === 1;
}
