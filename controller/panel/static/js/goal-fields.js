// Number fields of the goal's last point, for input without a mouse. Each field stays the same element: what is typed is never lost.

import { el, fill, numberField } from "./dom.js";

const DEGREE = Math.PI / 180; // [rad]

export function showFields(editor, arm) {
  const fields = el("fieldset", { class: "fields", "aria-label": "Numbers of the goal" });
  const last = () => editor.points.length - 1;
  const draft = []; // position as typed; null where a field has no number
  const angles = [null, null, null]; // orientation in space as typed [°]
  let turned = null; // the orientation that the angles are
  let known = null; // the editor's points that the fields show

  const axes = ["x", "y", "z"].slice(0, arm.dimension).map((name, k) => numberField(name, (value) => {
    draft[k] = value;
    if (draft.some((x) => x === null)) editor.changed({ plan: false });
    else if (last() < 0) editor.place([...draft]);
    else editor.change(last(), { position: [...draft] });
  }, { required: true }));
  const turn = (degrees) => editor.change(last(), { orientation: degrees === null ? null : degrees * DEGREE });
  const orientation = numberField("orientation [°]", turn, { placeholder: "any", digits: 2 });
  const turns = ["roll", "pitch", "yaw"].map((name, k) => numberField(`${name} [°]`, (value) => {
    angles[k] = value;
    if (angles.some((x) => x === null)) return editor.changed({ plan: false });
    return editor.change(last(), { orientation: (turned = quaternionOf(angles.map((angle) => angle * DEGREE))) });
  }, { placeholder: "any", digits: 2 }));
  const free = el("button", { type: "button", onclick: () => editor.change(last(), { orientation: null }) }, "Any orientation");
  const tolerance = numberField("tolerance", (value) => editor.set({ tolerance: value }), { placeholder: String(arm.tolerance?.position ?? ""), min: 0 });
  const step = numberField("step [s]", (value) => editor.set({ step: value > 0 ? value : null }), { placeholder: "as needed", min: 0 });
  const path = numberField("line tolerance", (value) => editor.set({ pathTolerance: value }), { placeholder: "off", min: 0 });
  const remove = el("button", { type: "button", onclick: () => editor.removeLast() });
  const add = el("button", { type: "button", onclick: () => editor.add([...editor.points[last()].position]) }, "Add a point");
  fill(fields, ...axes, orientation, ...turns, free, tolerance, step, path, add, remove);

  const describe = () => {
    const point = editor.points[last()];
    if (editor.points !== known) {
      known = editor.points;
      axes.forEach((axis, k) => axis.set((draft[k] = point?.position[k] ?? null)));
    }
    if (arm.dimension === 2) orientation.set(typeof point?.orientation === "number" ? point.orientation / DEGREE : null);
    else if (turned !== (point?.orientation ?? null)) {
      turned = point?.orientation ?? null;
      const shown = turned === null ? [null, null, null] : anglesOf(turned);
      turns.forEach((field, k) => field.set((angles[k] = shown[k] === null ? null : shown[k] / DEGREE)));
    }
    tolerance.set(editor.tolerance);
    if (!step.contains(document.activeElement)) step.set(editor.step);
    path.set(editor.pathTolerance);
    orientation.hidden = arm.dimension !== 2 || !point;
    for (const field of turns) field.hidden = arm.dimension !== 3 || !point;
    free.hidden = arm.dimension !== 3 || !point?.orientation;
    step.hidden = path.hidden = editor.mode !== "curve" && last() <= 0;
    const begun = angles.some((x) => x !== null);
    for (const field of turns) field.querySelector("input").required = begun;
    add.hidden = editor.mode !== "curve" || last() < 0;
    remove.hidden = last() < (editor.mode === "curve" ? 0 : 1);
    remove.textContent = `Remove point ${last() + 1}`;
    fields.disabled = editor.file !== null;
    fields.title = editor.file === null ? "" : "The goal is a named pose, a file or an earlier goal: Clear it to type another.";
  };
  editor.on(describe);
  describe();
  return fields;
}

// Whether a field of a placed goal has no number, so that the goal is not what the fields say.
export function incomplete(fields, editor) {
  return editor.file === null && editor.points.length > 0 && fields.querySelector("label:not([hidden]) input:invalid") !== null;
}

// Roll, pitch and yaw [rad], about the fixed axes x, y, z in this order, of a quaternion (x, y, z, w).
function anglesOf([x, y, z, w]) {
  const roll = Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y));
  const pitch = Math.asin(Math.min(Math.max(2 * (w * y - z * x), -1), 1));
  return [roll, pitch, Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))];
}

function quaternionOf([roll, pitch, yaw]) {
  const [cr, cp, cy] = [roll, pitch, yaw].map((angle) => Math.cos(angle / 2));
  const [sr, sp, sy] = [roll, pitch, yaw].map((angle) => Math.sin(angle / 2));
  return [sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy];
}
