// Answers to requests, shown at the lower edge.

import { inWords } from "./connection.js";
import { el } from "./dom.js";

// Shows the answer to a request for some seconds.
export function notifier() {
  const box = el("div", { class: "notice", role: "status", hidden: true });
  document.body.append(box);
  let timer;
  return (answer, what) => {
    box.textContent = `${what}: ${inWords(answer)}`;
    box.classList.toggle("bad", !answer.accepted);
    box.hidden = false;
    clearTimeout(timer);
    timer = setTimeout(() => (box.hidden = true), answer.accepted ? 4000 : 9000);
  };
}

// Shows which endpoints the server has no connection to, why, and what to do.
export function showMissing(missing = []) {
  const list = document.querySelector(".missing");
  const lines = missing.map(inWords);
  if (!list || lines.join("\n") === list.dataset.lines) return; // a screen reader says it once
  list.dataset.lines = lines.join("\n");
  list.replaceChildren(...lines.map((line) => el("li", {}, line)));
  list.hidden = lines.length === 0;
}
