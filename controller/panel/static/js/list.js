// The list of all arms that are alive on the network.

import { Connection } from "./connection.js";
import { el, fill, show } from "./dom.js";
import { modeMark, simulatedBadge } from "./header.js";
import { notifier, showMissing } from "./notice.js";
import { pressToStop } from "./stop.js";

export function showList(onLogin) {
  show("list");
  document.title = "hyperbit: arms";
  const connection = new Connection("live", { onLogin });
  const list = document.querySelector(".arms");
  const none = document.querySelector(".none");
  const silence = document.querySelector("main .silence");
  showStopAll(connection);
  const entries = new Map();
  connection.on("arms", ({ arms, missing }) => {
    showMissing(missing);
    none.hidden = arms.length + missing.length > 0;
    for (const arm of arms) {
      if (!entries.has(arm.name)) entries.set(arm.name, entry(arm.name));
      entries.get(arm.name).set(arm);
    }
    const shown = arms.map((arm) => entries.get(arm.name).item);
    if (shown.length !== list.children.length || shown.some((item, k) => item !== list.children[k])) fill(list, ...shown);
  });
  setInterval(() => {
    const silent = connection.silence();
    silence.hidden = silent?.who !== "the server";
    const refused = connection.refusal ? ` The reason: ${connection.refusal}.` : "";
    silence.textContent = `Nothing heard from the server for ${Math.round(silent?.seconds ?? 0)} s.${refused}`;
    list.classList.toggle("old", !silence.hidden);
  }, 250);
}

// The person of the page, and the button that stops all arms, also arms that the list does not show yet.
function showStopAll(connection) {
  const stop = document.getElementById("stop-all");
  const notify = notifier();
  connection.on("you", (you) => {
    document.querySelector(".who").textContent = `${you.name}, ${you.role}`;
    stop.disabled = !connection.mayStop;
  });
  pressToStop(stop, { path: "stop", what: "Stop all", notify });
}

// An arm's entry stays the same element: a press on it, or the focus, outlasts the next message.
function entry(name) {
  const mode = el("span", {});
  const reason = el("span", { class: "reason" });
  const silence = el("span", { class: "silence" });
  const badge = simulatedBadge();
  const item = el("li", {}, el("a", { href: `arms/${name}` }, el("b", {}, name), badge, mode, reason, silence));
  const set = (arm) => {
    const old = !arm.alive || arm.age === null || arm.age > 1.5;
    const heard = arm.age === null ? "nothing heard yet" : `nothing heard for ${Math.round(arm.age)} s`;
    item.classList.toggle("old", old);
    fill(mode, modeMark(arm.mode ?? "unknown"));
    reason.textContent = arm.reason ?? "";
    badge.hidden = !arm.simulated;
    silence.hidden = !old;
    silence.textContent = arm.alive ? heard : `the daemon is gone, ${heard}`;
  };
  return { item, set };
}
