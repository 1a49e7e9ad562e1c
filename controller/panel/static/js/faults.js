// Faults with advice; faults of one kind and one advice stand together.

import { el, fill } from "./dom.js";

export function showFaults(connection) {
  const card = document.getElementById("faults");
  let before = "";
  connection.on("state", ({ faults, mode }) => {
    const now = JSON.stringify([faults, mode]);
    if (now === before) return;
    before = now;
    card.hidden = faults.length === 0;
    card.classList.toggle("warnings", mode !== "fault");
    fill(
      card,
      el("h2", {}, mode === "fault" ? "▲ Fault" : "Warnings"),
      ...grouped(faults).map(({ code, advice, of }) =>
        el("div", { class: "fault" },
          el("p", {}, el("b", {}, `${code} `), el("span", { class: "faint" }, of.map((fault) => fault.source).join(", "))),
          ...of.map((fault) => el("p", {}, fault.message)),
          advice ? el("p", { class: "advice" }, `→ ${advice}`) : null)),
    );
  });
}

function grouped(faults) {
  const groups = new Map();
  for (const fault of faults) {
    const key = `${fault.code}\n${fault.advice}`;
    if (!groups.has(key)) groups.set(key, { code: fault.code, advice: fault.advice, of: [] });
    groups.get(key).of.push(fault);
  }
  return [...groups.values()];
}
