// Progress of the running goal: reached waypoints, and the remaining time, which counts down between two states.

import { el } from "./dom.js";

const EVERY = 250; // [ms]

// `brief` gets the progress in a line, for small screens.
export function showProgress(connection, brief) {
  const bar = el("progress", { max: 1, "aria-label": "Progress of the goal" });
  const words = el("span", {});
  const box = el("p", { class: "progress", hidden: true }, bar, words);
  let offset = 0; // the daemon's UNIX time less the time of this page [s]
  connection.on("state", () => describe());
  connection.on("presence", ({ stamp, age }) => {
    offset = (stamp ?? 0) + (age ?? 0) - performance.now() / 1000;
    describe();
  });
  const describe = () => {
    const { mode, progress } = connection.latest.state ?? {};
    box.hidden = !progress || mode !== "executing";
    if (box.hidden) {
      brief.textContent = "";
      return;
    }
    const now = offset + performance.now() / 1000;
    const { begins, ends, reached, waypoints } = progress;
    bar.value = Math.min(Math.max((now - begins) / Math.max(ends - begins, 0.1), 0), 1);
    const points = waypoints > 1 ? `${reached} of ${waypoints} points, ` : "";
    const left = ends - now;
    const text = `${points}${left >= 0 ? `${left.toFixed(1)} s left` : `${(-left).toFixed(0)} s late`}`;
    words.textContent = text;
    brief.textContent = `${text} `;
  };
  const timer = setInterval(() => (box.isConnected ? describe() : clearInterval(timer)), EVERY);
  return box;
}
