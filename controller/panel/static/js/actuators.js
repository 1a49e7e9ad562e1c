// The actuators of each module: commanded and measured state, lock, number of switches; press and hold to jog.

import { el, fill } from "./dom.js";
import { onHold } from "./hold.js";

const WORDS = ["contracted", "extended"];

export function showActuators(connection, notify) {
  const card = document.getElementById("actuators");
  const grid = el("div", { class: "grid", role: "listbox", "aria-label": "Actuators", tabIndex: 0 });
  const sentence = el("p");
  const buttons = el("div", { class: "buttons" });
  const detail = el("div", { class: "detail" }, sentence, buttons);
  card.append(
    el("p", { class: "hint" }, "■ extended, □ contracted, ≠ measured differs, ? unknown, L locked"),
    grid,
    detail,
  );
  let labels = [];
  let cells = [];
  let chosen = null;
  let shown = "";
  let offered = "";

  connection.on("arm", (arm) => {
    if (String(arm.actuators) === String(labels)) return;
    labels = arm.actuators;
    cells = labels.map((label, k) => el("button", { type: "button", class: "cell", role: "option", tabIndex: -1, onclick: () => choose(k) }));
    const modules = new Map();
    labels.forEach((label, k) => {
      const module = label.split(".")[0];
      if (!modules.has(module)) modules.set(module, []);
      modules.get(module).push(cells[k]);
    });
    fill(grid, ...[...modules].map(([module, own]) => el("div", { class: "module" }, el("span", { class: "number" }, module), ...own)));
    shown = "";
    describe();
  });
  connection.on("state", describe);
  connection.on("bodies", describe);
  connection.on("you", describe);
  connection.on("diagnostics", () => describe());
  grid.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    choose(Math.min(Math.max((chosen ?? -step) + step, 0), labels.length - 1));
  });

  function choose(k) {
    chosen = k;
    shown = "";
    describe();
    cells[k]?.scrollIntoView({ block: "nearest" });
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
    if (chosen !== null) offer(labels[chosen], state.commanded?.[chosen] === 1 ? 0 : 1, locked.get(labels[chosen]), viewer);
  }

  // What is known of an actuator.
  function at({ commanded, measured }, k) {
    return { label: labels[k], commanded: commanded?.[k], measured: measured?.[k], last: connection.latest.bodies?.last?.[k] };
  }

  function tell(actuator, lock, count) {
    fill(sentence, el("b", {}, actuator.label), inWords(actuator).slice(actuator.label.length),
      lock === undefined ? "" : `, locked ${words(lock)}`, count === undefined ? "" : `; ${count} switches`);
  }

  // Draws the buttons anew only if they change: a button that is replaced between press and release is not clicked.
  function offer(label, to, lock, viewer) {
    const now = JSON.stringify([label, to, lock, viewer]);
    if (now === offered || buttons.querySelector(".holding")) return;
    offered = now;
    const ask = (request, what) => async () => notify(await connection.ask(request), what);
    const jog = el("button", { type: "button", id: "jog" }, `Hold to ${to ? "extend" : "contract"}`);
    onHold(jog, ask({ do: "jog", actuator: label, state: WORDS[to] }, `Jog ${label}`));
    const locks = [0, 1].map((state) =>
      el("button", { type: "button", onclick: ask({ do: "lock", actuator: label, state }, `Lock ${label}`) }, `Lock ${WORDS[state]}`));
    const unlock = el("button", { type: "button", onclick: ask({ do: "lock", actuator: label, state: null }, `Unlock ${label}`) }, "Unlock");
    fill(buttons, ...(viewer ? [] : [jog, ...(lock === undefined ? locks : [unlock])]));
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
