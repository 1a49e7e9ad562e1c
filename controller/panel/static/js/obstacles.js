// Obstacles of the arm's file, and sent obstacles, which can be drawn and removed.

import { el, fill, numberField } from "./dom.js";
import { inWords } from "./shapes.js";

export function showObstacles(connection, notify) {
  const card = document.getElementById("obstacles");
  const list = el("ul", { class: "regions" });
  const form = el("div", { class: "fields" });
  const shape = { centre: [], radius: null };
  const add = el("button", { type: "button" }, "Add");
  card.append(list, el("details", {}, el("summary", {}, "By numbers"), form, add));
  let sent = [];
  let shown = "";

  const send = async (regions, what) => {
    const answer = await connection.ask({ do: "obstacles", regions });
    notify(answer, what);
    return answer;
  };
  const append = (region) => send([...sent, { ...region, name: freshName(sent) }], "Obstacle");

  connection.on("arm", (arm) => {
    const now = JSON.stringify([arm.obstacles, arm.sent_obstacles]);
    if (now === shown) return;
    shown = now;
    sent = arm.sent_obstacles ?? [];
    const focused = list.contains(document.activeElement);
    const own = (arm.obstacles ?? []).map((region) =>
      el("li", {}, el("span", {}, `${region.name ? `${region.name}: ` : ""}${inWords(region)}`), el("span", { class: "faint" }, "arm's file")));
    const others = sent.map((region, k) =>
      el("li", {}, el("span", {}, `${region.name ? `${region.name}: ` : ""}${inWords(region)}`),
        el("button", { type: "button", class: "remove", onclick: () => send(sent.filter((_, j) => j !== k), "Obstacle removed") }, "Remove")));
    fill(list, ...own, ...others, own.length + others.length ? null : el("li", { class: "faint" }, "There are none."));
    if (focused) (list.querySelector("button") ?? card.querySelector("summary")).focus();
    if (form.childElementCount === 0) {
      const set = (axis) => (value) => (shape.centre[axis] = value);
      fill(form, ...["x", "y", "z"].slice(0, arm.dimension).map((name, k) => numberField(name, set(k))),
        numberField("radius", (value) => (shape.radius = value), { min: 0 }));
      add.onclick = () => append({ [arm.dimension === 2 ? "disc" : "sphere"]: { centre: [...shape.centre], radius: shape.radius } });
    }
  });
  return append;
}

// Draws a box by dragging; returns the function that a view calls with the first corner.
export function sketcher(view, append) {
  return (corner) => {
    const draw = (at) => {
      const to = view.toWorld(at);
      const size = [0, 1].map((a) => Math.abs(to[a] - corner[a]));
      const centre = [0, 1].map((a) => (to[a] + corner[a]) / 2);
      view.sketch = Math.min(...size) * view.scale > 4 ? { box: { centre, size } } : null;
      view.draw();
    };
    draw.end = async () => {
      const { sketch } = view;
      if (sketch) await append(sketch);
      view.sketch = null;
      view.draw();
    };
    return draw;
  };
}

function freshName(regions) {
  const names = new Set(regions.map((region) => region.name));
  let number = 1;
  while (names.has(`drawn-${number}`)) number += 1;
  return `drawn-${number}`;
}
