// Control of the arm, and the person of this page.

import { clock, el, fill } from "./dom.js";
import { leave } from "./login.js";

export function showControl(connection, notify) {
  const card = document.getElementById("control");
  const who = el("p", { class: "who" });
  const holder = el("p", { class: "holder", "aria-live": "polite" });
  const take = el("button", { type: "button", id: "take" }, "Take control");
  const release = el("button", { type: "button" }, "Release control");
  const out = el("button", { type: "button", onclick: leave }, "Log out");
  const others = el("p", { class: "hint others" },
    "Control orders the pages of this panel only: programs that send goals over Zenoh move the arm whoever has control.");
  card.append(holder, who, others, el("div", { class: "buttons" }, take, release, out));
  take.addEventListener("click", async () => notify(await connection.ask({ do: "take" }), "Control"));
  release.addEventListener("click", async () => notify(await connection.ask({ do: "release" }), "Control"));
  connection.on("presence", ({ control, pages, you }) => {
    const mine = control.page === you;
    const words = control.name === null
      ? "Nobody has control; the first command takes it."
      : `${mine ? "You have" : `${control.name} has`} control since ${clock(control.since)}.`;
    if (holder.textContent !== words) holder.textContent = words;
    card.classList.toggle("foreign", control.name !== null && !mine);
    take.hidden = mine || !connection.mayCommand;
    release.hidden = !mine;
    const { name, role } = connection.latest.you ?? {};
    fill(who, `You are ${name}, ${role}. ${pages === 1 ? "One page is" : `${pages} pages are`} open.`);
  });
}
