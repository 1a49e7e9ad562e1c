// The list of all arms that are alive on the network.

import { Connection } from "./connection.js";
import { el, fill, show } from "./dom.js";
import { modeMark } from "./header.js";

export function showList(onLogin) {
  show("list");
  document.title = "hyperbit: arms";
  const connection = new Connection("/live", { onLogin });
  const list = document.querySelector(".arms");
  const none = document.querySelector(".none");
  const silence = document.querySelector("main .silence");
  connection.on("you", (you) => (document.querySelector(".who").textContent = `${you.name}, ${you.role}`));
  connection.on("arms", ({ arms }) => {
    none.hidden = arms.length > 0;
    fill(list, ...arms.map(entry));
  });
  setInterval(() => {
    const silent = connection.silence();
    silence.hidden = silent?.who !== "the server";
    silence.textContent = `Nothing heard from the server for ${Math.round(silent?.seconds ?? 0)} s.`;
    list.classList.toggle("old", !silence.hidden);
  }, 250);
}

function entry(arm) {
  const old = !arm.alive || arm.age === null || arm.age > 1.5;
  const heard = arm.age === null ? "nothing heard yet" : `nothing heard for ${Math.round(arm.age)} s`;
  return el(
    "li",
    { class: old ? "old" : "" },
    el(
      "a",
      { href: `/arms/${arm.name}` },
      el("b", {}, arm.name),
      modeMark(arm.mode ?? "unknown"),
      el("span", { class: "reason" }, arm.reason ?? ""),
      old ? el("span", { class: "silence" }, arm.alive ? heard : `the daemon is gone, ${heard}`) : null,
    ),
  );
}
