// Mouse, touch and keyboard input of the planar drawing, by the editor's mode.

import { handle } from "./plane-marks.js";

const NEAR = 24; // [pixels] within which a point or a handle is grabbed
const STILL = 10; // [pixels] within which a touch counts as a tap; a swipe scrolls the page and places nothing

const far = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

export function listenToPointers(view) {
  const { canvas, editor } = view;
  const pointers = new Map();
  let drag = null; // called with each position of the pointer while it is down
  let pinch = null;

  const at = (event) => [event.offsetX, event.offsetY];
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 1) return;
    pointers.set(event.pointerId, at(event));
    canvas.setPointerCapture(event.pointerId);
    if (pointers.size === 2) {
      drag = null;
      pinch = pinchShape();
    } else if (pointers.size === 1) {
      const where = at(event);
      if (event.button === 1) drag = pan(where);
      else if (event.pointerType === "touch" && swipes(where)) drag = tap(where);
      else drag = begin(where);
    }
  });
  canvas.addEventListener("touchstart", (event) => {
    const box = canvas.getBoundingClientRect();
    const { clientX, clientY } = event.touches[0];
    if (event.touches.length > 1 || !swipes([clientX - box.left, clientY - box.top])) event.preventDefault(); // no scrolling
  }, { passive: false });
  canvas.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return;
    pointers.set(event.pointerId, at(event));
    if (pointers.size === 2 && pinch) {
      const now = pinchShape();
      view.zoomBy(now.width / pinch.width, now.middle);
      shift(pinch.middle, now.middle);
      pinch = now;
    } else drag?.(at(event));
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => {
      pointers.delete(event.pointerId);
      pinch = null;
      if (drag?.end && (name === "pointerup" || !drag.tap)) drag.end();
      drag = null;
    });
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    view.zoomBy(Math.exp(-event.deltaY * 0.0015), at(event));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const step = steps[event.key];
    if (!step) return;
    event.preventDefault();
    const size = (event.shiftKey ? 10 : 1) * (view.arm.tolerance?.position ?? view.arm.length / 1000);
    const last = editor.points.length - 1;
    const from = last < 0 ? view.state?.tip?.position : editor.points[last].position;
    if (!from) return;
    const position = from.map((x, a) => x + size * step[a]);
    if (last < 0) editor.place(position);
    else editor.change(last, { position });
  });

  function pinchShape() {
    const [a, b] = [...pointers.values()];
    return { width: Math.hypot(a[0] - b[0], a[1] - b[1]) || 1, middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] };
  }

  function shift(from, to) {
    view.centre = [view.centre[0] - (to[0] - from[0]) / view.scale, view.centre[1] + (to[1] - from[1]) / view.scale];
    view.draw();
  }

  function pan(from) {
    return (to) => {
      shift(from, to);
      from = to;
    };
  }

  // Whether a touch that begins here may become a swipe that scrolls the page.
  function swipes(where) {
    return (editor.mode === "goal" || editor.mode === "curve") && grabbed(where) === null;
  }

  // Acts at the end of a touch that does not move.
  function tap(where) {
    const follow = (to) => {
      if (far(to, where) > STILL) follow.end = null;
    };
    follow.end = () => begin(where)?.end?.();
    follow.tap = true;
    return follow;
  }

  // The function that moves or turns the point under the pointer; null if there is none.
  function grabbed(where) {
    const last = editor.points.length - 1;
    if (editor.file !== null || last < 0) return null;
    if (far(handle(view, editor.points[last]), where) < NEAR) return turn(last);
    const hit = editor.points.findIndex((point) => far(view.toScreen(point.position), where) < NEAR);
    return hit < 0 ? null : move(hit);
  }

  // Returns the function that handles the drag that begins here.
  function begin(where) {
    if (editor.mode === "pan") return pan(where);
    if (editor.mode === "obstacle") return view.onSketch?.(view.toWorld(where)) ?? null;
    const held = grabbed(where);
    if (held !== null) return held;
    if (editor.mode === "curve") {
      editor.add(view.toWorld(where));
      return move(editor.points.length - 1);
    }
    editor.place(view.toWorld(where));
    return move(0);
  }

  function move(index) {
    return (to) => editor.change(index, { position: view.toWorld(to) });
  }

  // Drags the handle: sets the tip's orientation at the goal.
  function turn(index) {
    return (to) => {
      const [x, y] = view.toScreen(editor.points[index].position);
      const angle = Math.atan2(y - to[1], to[0] - x) - Math.PI / 2;
      editor.change(index, { orientation: Math.atan2(Math.sin(angle), Math.cos(angle)) });
    };
  }
}
