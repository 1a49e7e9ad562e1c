// The page of one arm: puts its parts together.

import { Connection } from "./connection.js";
import { el, fill, show } from "./dom.js";
import { Editor } from "./editor.js";
import { showGoal } from "./goal.js";
import { showHeader } from "./header.js";
import { PlaneView } from "./plane.js";

const MODES = { goal: "Goal", curve: "Curve", look: "Move" };

export function showArm(name, onLogin) {
  show("arm");
  const connection = new Connection(`/arms/${name}/live`, { onLogin });
  const editor = new Editor(connection);
  const notify = notifier();
  showHeader(name, connection, notify);
  showGoal(connection, editor, notify);
  showPicture(connection, editor);
}

// The picture: in the plane or in space, as the arm is.
function showPicture(connection, editor) {
  const stage = document.querySelector(".stage");
  let view = null;
  const set = (values) => {
    if (view === null) return;
    Object.assign(view, values);
    view.draw();
  };
  connection.on("arm", (arm) => {
    if (!("lines" in arm)) return;
    if (view === null) {
      view = new PlaneView(stage, arm, editor);
      showTools(view, editor);
    }
    const { latest } = connection;
    set({ arm, bodies: latest.bodies ?? view.bodies, state: latest.state ?? null });
    set({ waypoints: latest.waypoints?.waypoints ?? [], obstacles: [...arm.obstacles, ...(arm.sent_obstacles ?? [])] });
  });
  connection.on("bodies", (bodies) => set({ bodies }));
  connection.on("state", (state) => set({ state }));
  connection.on("waypoints", ({ waypoints }) => set({ waypoints }));
  editor.on(() => set({}));
}

function showTools(view, editor) {
  const modes = document.querySelector(".modes");
  const choose = (mode) => () => editor.setMode(mode);
  const buttons = Object.entries(MODES).map(([mode, label]) =>
    el("button", { type: "button", data: { mode }, onclick: choose(mode) }, label));
  fill(modes, ...buttons);
  const describe = () => {
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.mode === editor.mode));
  };
  editor.on(describe);
  describe();
  const zoom = (label, title, act) => el("button", { type: "button", title, "aria-label": title, onclick: act }, label);
  fill(
    document.querySelector(".zoom"),
    zoom("+", "Closer", () => view.zoomBy(1.4)),
    zoom("−", "Farther", () => view.zoomBy(1 / 1.4)),
    zoom("⤢", "All", () => view.fit()),
  );
  const mark = (name, text) => el("span", { class: `mark ${name}` }, text);
  fill(
    document.querySelector(".legend"),
    mark("measured", "measured"),
    mark("commanded", "commanded"),
    mark("ghost", "planned"),
    mark("goal", "goal"),
  );
}

// Says for a while what became of a request.
function notifier() {
  const box = el("div", { class: "notice", role: "status", hidden: true });
  document.body.append(box);
  let timer;
  return (answer, what) => {
    box.textContent = `${what}: ${answer.message}`;
    box.classList.toggle("bad", !answer.accepted);
    box.hidden = false;
    clearTimeout(timer);
    timer = setTimeout(() => (box.hidden = true), answer.accepted ? 4000 : 9000);
  };
}
