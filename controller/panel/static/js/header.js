// The header, always visible: name, mode and reason, silence, Stop and Reset.

import { el } from "./dom.js";
import { onHold } from "./hold.js";
import { showMissing } from "./notice.js";
import { pressToStop } from "./stop.js";

const MARKS = { starting: "◌", ready: "●", executing: "▶", fault: "▲", stopped: "■", unknown: "?" };

export function modeMark(mode) {
  return el("span", { class: "mode", data: { mode } }, `${MARKS[mode] ?? "?"} ${mode}`);
}

export function simulatedBadge() {
  return el("span", { class: "badge" }, "simulated");
}

export function showHeader(name, connection, notify) {
  const part = (id) => document.getElementById(id);
  part("name").textContent = name;
  connection.on("state", (state) => {
    part("mode").dataset.mode = state.mode;
    part("mode").textContent = `${MARKS[state.mode] ?? "?"} ${state.mode}`;
    part("reason").textContent = part("reason").title = state.reason;
    part("simulated").hidden = !state.simulated;
    document.title = `${connection.latest.you?.replay ? "Replay: " : ""}${MARKS[state.mode] ?? "?"} ${name}: ${state.mode}`;
    part("reset").classList.toggle("wanted", state.mode === "stopped" || (state.mode === "fault" && state.faults.some((fault) => fault.reset)));
  });
  connection.on("presence", ({ alive, missing }) => showMissing(alive ? [] : missing)); // others may be down
  connection.on("you", () => {
    const viewer = !connection.mayCommand;
    part("stop").disabled = !connection.mayStop;
    part("reset").disabled = viewer;
    document.body.classList.toggle("viewer", viewer);
  });
  pressToStop(part("stop"), { path: `arms/${name}/stop`, what: "Stop", notify, connection });
  onHold(part("reset"), async () => notify(await connection.ask({ do: "reset" }), "Reset"), notify);
  const watch = setInterval(() => {
    if (!part("silence")) return clearInterval(watch); // the login form is shown
    const silent = connection.silence();
    part("silence").hidden = silent === null;
    if (silent !== null) {
      const heard = Number.isFinite(connection.heardAt) ? `nothing heard for ${Math.floor(silent.seconds)} s` : "nothing heard yet";
      part("silence").textContent = { "the daemon": `the daemon is gone, ${heard}`, "the server": `${connection.refusal || "no connection to the server"}, ${heard}` }[silent.who] ?? heard;
    }
    document.body.classList.toggle("old", silent !== null);
  }, 200);
}
