// Named poses of the arm, in the card of the goal: plan one, save the goal or the present configuration, remove one.

import { el, fill } from "./dom.js";

export function showPoses(connection, editor, notify) {
  const chosen = el("select", { id: "pose" });
  const use = el("button", { type: "button", id: "use-pose" }, "Plan");
  const remove = el("button", { type: "button", id: "remove-pose" }, "Remove");
  const name = el("input", { id: "pose-name", size: 12, maxlength: 40 });
  const save = el("button", { type: "button", id: "save-pose" }, "Save");
  const what = el("p", { class: "hint" });
  let poses = [];
  let replaced = null; // name of the pose that the next Save replaces
  const goalOf = (wanted) => poses.find((pose) => pose.name === wanted)?.goal;

  connection.on("arm", (description) => {
    poses = description.poses ?? [];
    const before = chosen.value;
    fill(chosen, ...poses.map((pose) => el("option", { value: pose.name }, pose.name)));
    if (goalOf(before)) chosen.value = before;
  });
  const describe = () => {
    what.textContent = `Save keeps ${editor.goal === null ? "the measured configuration" : "the goal above"} under a name.`;
  };
  editor.on(describe);
  describe();
  name.addEventListener("input", () => (replaced = null));
  use.addEventListener("click", async () => {
    if (chosen.value) await editor.open({ do: "file", text: JSON.stringify(goalOf(chosen.value)) });
  });
  remove.addEventListener("click", async () => {
    if (chosen.value) notify(await connection.ask({ do: "pose", remove: chosen.value }), "Remove pose");
  });
  save.addEventListener("click", async () => {
    const configuration = connection.latest.state?.configuration;
    const goal = editor.goal ?? (configuration ? { waypoints: [{ configuration }] } : null);
    if (goal === null) return notify({ accepted: false, message: "The arm is in no configuration." }, "Save pose");
    const wanted = name.value.trim();
    if (goalOf(wanted) && replaced !== wanted) {
      replaced = wanted;
      return notify({ accepted: false, message: `there is a pose ${wanted}: press Save again to replace it` }, "Save pose");
    }
    const answer = await connection.ask({ do: "pose", save: wanted, goal });
    replaced = null;
    if (answer.accepted) name.value = "";
    return notify(answer, "Save pose");
  });
  return el("details", { class: "poses" }, el("summary", {}, "Named poses"),
    el("div", { class: "fields" }, el("label", {}, "pose ", chosen), use, remove),
    el("div", { class: "fields" }, el("label", {}, "name ", name), save), what);
}
