// Boards, buses and their load, and what else the executor tells of its health.

import { el, fill, number } from "./dom.js";

export function showBoards(connection) {
  const card = document.getElementById("boards");
  const body = el("div", { class: "health" });
  card.append(body);
  connection.on("diagnostics", (told) => {
    fill(
      body,
      ...told.buses.map((bus) =>
        el("div", {},
          el("p", {}, el("b", {}, bus.name), ` ${bus.state}, ${Math.round(bus.frames_per_second)} frames/s`,
            bus.tx_errors + bus.rx_errors ? `, errors ${bus.tx_errors}/${bus.rx_errors}` : ""),
          el("label", {}, "load ", el("meter", { min: 0, max: 1, low: 0.5, high: 0.8, optimum: 0, value: bus.load }),
            ` ${percent(bus.load)}, at worst ${percent(bus.worst_case?.load)}`))),
      el("ul", { class: "boards" }, ...told.boards.map((board) => {
        const fine = board.state === "operational";
        return el("li", { class: fine ? "" : "bad", title: `${board.bus}/${board.node}: ${board.state}, heartbeat ${number(board.heartbeat_age, 2)} s ago` },
          `${fine ? "●" : "▲"} ${board.bus}/${board.node}${fine ? "" : ` ${board.state}`}`);
      })),
      el("dl", {}, ...pair("executor", told.executor), ...pair("real time", told.real_time), ...pair("ledger", told.ledger),
        ...pair("late at worst", `${number(told.loop.late_worst * 1000, 2)} ms`),
        ...(told.waits ? pair("waits", String(told.waits)) : []), ...pair("messages dropped", String(told.dropped))),
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
