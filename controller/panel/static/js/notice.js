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
