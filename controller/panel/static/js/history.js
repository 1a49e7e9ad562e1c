// The last goals with their results, and the log.

import { clock, el, fill, number, unitMark } from "./dom.js";

const MARKS = { succeeded: "✓", running: "▶", canceled: "◼", replaced: "↷", aborted: "✗", skipped: "»" };

export function showGoals(connection, editor) {
  const list = el("ol", { class: "goals", reversed: true });
  document.getElementById("goals").append(el("div", { class: "scroll", role: "region", tabIndex: 0, "aria-label": "Last goals" }, list));
  connection.on("goals", ({ goals }) =>
    fill(list, ...goals.toReversed().map((goal) =>
      el("li", { data: { status: goal.status } },
        el("b", {}, `${MARKS[goal.status] ?? "?"} ${goal.status}`), ` ${goal.id} `,
        el("span", { class: "faint" }, [
          clock(goal.ended ?? goal.at),
          goal.waypoints > 1 ? `${goal.reached} of ${goal.waypoints} points` : null,
          typeof goal.error === "number" ? `error ${number(goal.error, 5)}${unitMark(connection.latest.arm)}` : null,
          typeof goal.switches === "number" ? `${goal.switches} switches` : null,
          goal.status === "succeeded" ? null : goal.message,
        ].filter(Boolean).join(", ")),
        goal.again ? el("button", { type: "button", class: "again", onclick: () => editor.open({ do: "again", id: goal.id }) }, "Plan again") : null)),
      goals.length ? null : el("li", { class: "faint" }, "No goal since the panel started.")));
}

export function showLog(connection) {
  const list = el("ol", { class: "lines" });
  document.getElementById("log").append(el("div", { class: "scroll", role: "log", tabIndex: 0, "aria-label": "Log" }, list));
  connection.on("log", ({ lines }) => {
    fill(list, ...lines.toReversed().map((line) =>
      el("li", { data: { kind: line.kind } }, el("time", {}, clock(line.at)), ` ${inKind(line)}`)));
  });
}

// A line of the log that begins with its kind, said once; notes have none.
function inKind({ kind, text }) {
  return kind === "note" || text.startsWith(`${kind}:`) ? text : `${kind}: ${text}`;
}
