// Faults, each with advice.

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
      ...faults.map((fault) =>
        el("div", { class: "fault" },
          el("p", {}, el("b", {}, `${fault.code} `), el("span", { class: "faint" }, fault.source)),
          el("p", {}, fault.message),
          fault.advice ? el("p", { class: "advice" }, `→ ${fault.advice}`) : null)),
    );
  });
}
