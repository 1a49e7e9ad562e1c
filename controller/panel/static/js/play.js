// Faults that are played in the boards of a simulated arm, for operators.

import { el, fill } from "./dom.js";

export function showPlay(connection, notify) {
  const card = document.getElementById("play");
  const verb = el("select", { name: "verb" });
  const target = el("select", { name: "target" });
  const number = el("input", { name: "number", size: 8 });
  const field = el("label", {}, el("span", {}), " ", number);
  const words = el("p", { class: "hint" });
  const play = el("button", { type: "button" }, "Play");
  card.append(el("div", { class: "fields" }, el("label", {}, "fault ", verb), el("label", {}, "of ", target), field), words, play);
  let faults = [];
  let offered = "";

  const chosen = () => faults.find((fault) => fault.verb === verb.value);
  const names = (kind) => {
    const { simulation, actuators } = connection.latest.arm ?? {};
    return { board: simulation?.boards, bus: simulation?.buses, interlock: simulation?.interlocks, actuator: actuators }[kind] ?? [];
  };
  const describe = () => {
    const fault = chosen();
    if (!fault) return;
    fill(target, ...names(fault.target).map((name) => el("option", { value: name }, name)));
    field.hidden = fault.argument === "";
    field.firstChild.textContent = fault.argument.toLowerCase();
    words.textContent = `${fault.text[0].toUpperCase()}${fault.text.slice(1)}.`;
  };
  const offer = () => {
    const simulation = connection.latest.arm?.simulation;
    card.hidden = !simulation || !connection.mayCommand;
    if (!simulation || offered === JSON.stringify(simulation)) return;
    offered = JSON.stringify(simulation);
    faults = simulation.faults.filter((fault) => names(fault.target).length > 0);
    fill(verb, ...faults.map((fault) => el("option", { value: fault.verb }, fault.verb.replaceAll("_", " "))));
    describe();
  };
  verb.addEventListener("change", describe);
  play.addEventListener("click", async () => {
    const fault = [verb.value, target.value, chosen()?.argument ? number.value : ""].join(" ").trim();
    notify(await connection.ask({ do: "fault", fault }), "Fault");
  });
  for (const section of ["arm", "you"]) connection.on(section, offer);
}
