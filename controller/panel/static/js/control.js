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
  connection.on("presence", ({ control, you }) => {
    const mine = control.page === you;
    const words = control.name === null
      ? "Nobody has control; the first command takes it."
      : `${mine ? "You have" : `${control.name} has`} control since ${clock(control.since)}.`;
    if (holder.textContent !== words) holder.textContent = words;
    card.classList.toggle("foreign", control.name !== null && !mine);
    take.hidden = mine || !connection.mayCommand;
    release.hidden = !mine;
    describeMe();
  });
  connection.on("you", describeMe); // it may come after the presence

  function describeMe() {
    const { you, presence } = connection.latest;
    if (!you || !presence) return;
    const pages = presence.pages === 1 ? "One page is" : `${presence.pages} pages are`;
    fill(who, `You are ${you.name}, ${you.role}. ${pages} open.`);
  }
}
