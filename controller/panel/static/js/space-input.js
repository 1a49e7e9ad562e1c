// Input of the spatial drawing: clicks place a goal on the plane through the last one that faces the camera; a gizmo moves it.

import * as THREE from "three";
import { TransformControls } from "../vendor/TransformControls.js";

const STILL = 5; // [pixels] within which a press counts as a click

export function listenInSpace(view) {
  const { canvas, camera, scene, orbit, editor } = view;
  const handle = new THREE.Object3D(); // moved by the gizmo: the last point
  scene.add(handle);
  const gizmo = new TransformControls(camera, canvas);
  gizmo.setSize(0.7);
  gizmo.attach(handle);
  scene.add(gizmo.getHelper());
  let dragging = false;
  gizmo.addEventListener("dragging-changed", ({ value }) => {
    dragging = value;
    orbit.enabled = !value && !sketching;
  });
  gizmo.addEventListener("change", () => view.draw());
  gizmo.addEventListener("objectChange", () => {
    const last = editor.points.length - 1;
    if (last < 0) return;
    if (gizmo.mode === "translate") editor.change(last, { position: handle.position.toArray() });
    else editor.change(last, { orientation: handle.quaternion.toArray() });
  });

  let down = null;
  let sketching = false;
  canvas.addEventListener("pointerdown", (event) => {
    down = [event.clientX, event.clientY];
    if (editor.mode === "obstacle" && event.button === 0) {
      sketching = true;
      orbit.enabled = false;
      view.sketchFrom = onPlane(event);
    }
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!sketching) return;
    const radius = onPlane(event).distanceTo(view.sketchFrom);
    view.sketch = radius > view.arm.length / 200 ? { sphere: { centre: view.sketchFrom.toArray(), radius } } : null;
    view.draw();
  });
  canvas.addEventListener("pointerup", async (event) => {
    if (sketching) {
      sketching = false;
      orbit.enabled = true;
      if (view.sketch) await view.onRegion?.(view.sketch);
      view.sketch = null;
      view.draw();
      return;
    }
    const still = down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < STILL;
    if (!still || dragging || gizmo.axis !== null || event.button !== 0) return;
    if (editor.mode === "goal") editor.place(onPlane(event).toArray());
    else if (editor.mode === "curve") editor.add(onPlane(event).toArray());
  });

  // Returns the point under the pointer on the plane through the last point, or through the tip.
  function onPlane(event) {
    const box = canvas.getBoundingClientRect();
    const at = new THREE.Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    const through = new THREE.Vector3(...(editor.points.at(-1)?.position ?? view.state?.tip?.position ?? orbit.target.toArray()));
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(camera.getWorldDirection(new THREE.Vector3()), through);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(at, camera);
    return ray.ray.intersectPlane(plane, new THREE.Vector3()) ?? through;
  }

  return {
    // Moves the gizmo to the last point.
    follow(point) {
      const shown = Boolean(point) && (editor.mode === "goal" || editor.mode === "turn" || editor.mode === "curve");
      gizmo.getHelper().visible = gizmo.enabled = shown;
      if (!point || dragging) return;
      gizmo.setMode(editor.mode === "turn" ? "rotate" : "translate");
      handle.position.fromArray(point.position);
      handle.quaternion.fromArray(point.orientation ?? view.state?.tip?.orientation ?? [0, 0, 0, 1]);
      handle.updateMatrixWorld();
    },
  };
}
