// The page of one arm: puts its parts together.

import { showActuators } from "./actuators.js";
import { showBoards } from "./boards.js";
import { divided, NOTHING } from "./bodies.js";
import { showCurves, showWear } from "./charts.js";
import { showCommission } from "./commission.js";
import { Connection } from "./connection.js";
import { showControl } from "./control.js";
import { el, fill, show } from "./dom.js";
import { Editor } from "./editor.js";
import { showFaults } from "./faults.js";
import { showGoal } from "./goal.js";
import { showHeader } from "./header.js";
import { showGoals, showLog } from "./history.js";
import { notifier } from "./notice.js";
import { showObstacles, sketcher } from "./obstacles.js";
import { PlaneView } from "./plane.js";
import { showPlay } from "./play.js";
import { showTimeline } from "./timeline.js";

const MODES = {
  2: { goal: "Goal", curve: "Curve", obstacle: "Obstacle", pan: "Pan" },
  3: { goal: "Goal", turn: "Turn", curve: "Curve", obstacle: "Obstacle", pan: "Orbit" },
};

const LEGEND = {
  measured: "measured",
  unknown: "position unknown, drawn as last known",
  commanded: "commanded",
  ghost: "planned",
  deviation: "greatest deviation on the way",
  refused: "refused goal",
  goal: "running goal",
  waypoints: "waypoints",
  obstacle: "obstacle",
  density: "density of reachable tips",
};

export function showArm(name, onLogin) {
  show("arm");
  const connection = new Connection(`arms/${name}/live`, { onLogin });
  const editor = new Editor(connection);
  const notify = notifier();
  showHeader(name, connection, notify);
  showCommission(connection, notify);
  showFaults(connection);
  showGoal(connection, editor, notify);
  showActuators(connection, notify);
  const append = showObstacles(connection, notify);
  showControl(connection, notify);
  showPlay(connection, notify);
  showGoals(connection, editor);
  showCurves(connection);
  showWear(connection);
  showBoards(connection);
  showLog(connection);
  showTimeline(connection, editor, notify);
  showPicture(connection, editor, append);
}

// The drawing: 2-D for planar arms, 3-D for spatial arms.
function showPicture(connection, editor, append) {
  const stage = document.querySelector(".stage");
  let view = null;
  const set = (values) => {
    if (view === null) return;
    Object.assign(view, values);
    view.draw();
  };
  let pictured = null; // description that the view was created for
  connection.on("arm", async (arm) => {
    if (!("lines" in arm)) return;
    const wanted = JSON.stringify([arm.dimension, arm.length, arm.base, arm.density]);
    if (wanted !== pictured) {
      pictured = wanted;
      const made = arm.dimension === 2 ? new PlaneView(stage, arm, editor) : await inSpace(stage, arm, editor);
      if (wanted !== pictured) return;
      view = made;
      view.onSketch = sketcher(view, append); // planar view
      view.onRegion = append; // spatial view
      showTools(view, editor);
    }
    if (view === null) return;
    const { latest } = connection;
    set({ arm, bodies: latest.bodies ? divided(latest.bodies, arm) : NOTHING, state: latest.state ?? null });
    set({ waypoints: latest.waypoints?.waypoints ?? [], obstacles: [...arm.obstacles, ...(arm.sent_obstacles ?? [])] });
  });
  connection.on("bodies", (bodies) => view && set({ bodies: divided(bodies, view.arm) }));
  connection.on("state", (state) => set({ state }));
  connection.on("waypoints", ({ waypoints }) => set({ waypoints }));
  editor.on(() => set({}));
}

// three.js is loaded only for arms that need it.
async function inSpace(stage, arm, editor) {
  try {
    const { SpaceView } = await import("./space.js");
    return new SpaceView(stage, arm, editor);
  } catch (error) {
    fill(stage, el("p", { class: "hint" }, `This browser cannot draw in 3-D: ${error.message}`));
    throw error;
  }
}

function showTools(view, editor) {
  const modes = document.querySelector(".modes");
  const choose = (mode) => () => editor.setMode(mode);
  const buttons = Object.entries(MODES[view.arm.dimension]).map(([mode, label]) =>
    el("button", { type: "button", data: { mode }, onclick: choose(mode) }, label));
  fill(modes, ...buttons);
  const describe = () => {
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.mode === editor.mode));
  };
  editor.on(describe);
  describe();
  const zoom = (label, title, act) => el("button", { type: "button", class: label === "⤢" ? "" : "step", title, "aria-label": title, onclick: act }, label);
  fill(
    document.querySelector(".zoom"),
    zoom("+", "Closer", () => view.zoomBy(1.4)),
    zoom("−", "Farther", () => view.zoomBy(1 / 1.4)),
    zoom("⤢", "All", () => view.fit()),
  );
  const marks = Object.entries(LEGEND).map(([name, text]) => [name, el("span", { class: `mark ${name}`, hidden: true }, text)]);
  const unit = el("span", {}, `lengths in ${view.arm.unit ?? "the unit of the arm's file"}`);
  fill(document.querySelector(".legend"), ...marks.map(([, mark]) => mark), unit);
  view.painted = (drawn) => {
    for (const [name, mark] of marks) mark.hidden = !drawn[name];
  };
}
