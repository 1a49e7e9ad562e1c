// Boards, buses with their load, and the health of the executor.

import { el, fill, number } from "./dom.js";

export function showBoards(connection) {
  const card = document.getElementById("boards");
  const body = el("div", { class: "health" });
  card.append(body);
  connection.on("diagnostics", (diagnostics) => {
    body.replaceChildren(el("p", { class: "bad" }, "The daemon's diagnostics cannot be read."));
    fill(
      body,
      ...diagnostics.buses.map((bus) =>
        el("div", {},
          el("p", {}, el("b", {}, bus.name), ` ${bus.state}, ${Math.round(bus.frames_per_second)} frames/s`,
            bus.tx_errors + bus.rx_errors ? `, errors ${bus.tx_errors}/${bus.rx_errors}` : ""),
          el("label", {}, "load ", el("meter", { min: 0, max: 1, low: 0.5, high: 0.8, optimum: 0, value: bus.load }),
            ` ${percent(bus.load)}, worst case ${percent(bus.worst_case?.load)}`))),
      el("ul", { class: "boards" }, ...diagnostics.boards.map((board) => {
        const fine = board.state === "operational";
        return el("li", { class: fine ? "" : "bad", title: `${board.bus}/${board.node}: ${board.state}, heartbeat ${number(board.heartbeat_age, 2)} s ago` },
          `${fine ? "●" : "▲"} ${board.bus}/${board.node}${fine ? "" : ` ${board.state}`}`);
      })),
      el("dl", {}, ...pair("executor", diagnostics.executor), ...pair("real time", diagnostics.real_time), ...pair("ledger", diagnostics.ledger),
        ...pair("worst lateness", `${number(diagnostics.loop.late_worst * 1000, 2)} ms`),
        ...(diagnostics.waits ? pair("waits", String(diagnostics.waits)) : []), ...pair("messages dropped", String(diagnostics.dropped))),
      ...(connection.latest.arm?.limits ?? []).map((limit) => el("p", { class: "hint" }, limit)),
    );
  });
}

function percent(share) {
  return typeof share === "number" ? `${(share * 100).toFixed(1)} %` : "–";
}

function pair(name, value) {
  return [el("dt", {}, name), el("dd", {}, value ?? "–")];
}
