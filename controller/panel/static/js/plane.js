// A planar arm on a 2-D canvas. The server computes the line segments.

import { drawCross, drawGhost, drawGoal, drawQuestion, drawTip, drawWaypoints } from "./plane-marks.js";
import { listenToPointers } from "./plane-input.js";
import { NOTHING } from "./bodies.js";
import { drawObstacles } from "./shapes.js";
import { digitsOf, niceStep } from "./scale.js";
import { View } from "./view.js";

export class PlaneView extends View {
  constructor(stage, arm, editor) {
    super();
    this.arm = arm;
    this.editor = editor;
    this.bodies = NOTHING;
    this.state = null;
    this.waypoints = [];
    this.obstacles = []; // of the arm's file, and sent ones
    this.sketch = null; // an obstacle that is being drawn
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.className = "plane";
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "The arm in the plane; arrow keys move the goal");
    stage.replaceChildren(this.canvas);
    this.picture = null;
    this.fit();
    this.repaintWith(stage);
    this.input = listenToPointers(this);
    this.loadDensity();
  }

  loadDensity() {
    if (!this.arm.density) return;
    const image = new Image();
    image.onload = () => {
      this.picture = image;
      this.draw();
    };
    image.src = `arms/${this.arm.name}/density`;
  }

  // Fits the view to the workspace, or to a square of the arm's length.
  fit() {
    const { density, base, length } = this.arm;
    const corners = density
      ? [0, 1].flatMap((i) => [0, 1].map((j) => this.fromBase(density.first[0] + i * density.shape[2] * density.pixel, density.first[1] + j * density.shape[1] * density.pixel)))
      : [-1, 1].flatMap((i) => [-1, 1].map((j) => [base[0][3] + i * length, base[1][3] + j * length]));
    const low = [0, 1].map((a) => Math.min(base[a][3], ...corners.map((c) => c[a])));
    const high = [0, 1].map((a) => Math.max(base[a][3], ...corners.map((c) => c[a])));
    this.centre = [0, 1].map((a) => (low[a] + high[a]) / 2);
    this.extent = [0, 1].map((a) => 1.08 * (high[a] - low[a]));
    this.zoom = 1;
    this.draw();
  }

  fromBase(x, y) {
    const m = this.arm.base;
    return [m[0][0] * x + m[0][1] * y + m[0][3], m[1][0] * x + m[1][1] * y + m[1][3]];
  }

  get scale() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return this.zoom * Math.min(width / this.extent[0], height / this.extent[1]); // pixels per unit of length
  }

  toScreen([x, y]) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [width / 2 + (x - this.centre[0]) * this.scale, height / 2 - (y - this.centre[1]) * this.scale];
  }

  toWorld([px, py]) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [this.centre[0] + (px - width / 2) / this.scale, this.centre[1] - (py - height / 2) / this.scale];
  }

  zoomBy(factor, at = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    const fixed = this.toWorld(at);
    this.zoom = Math.min(Math.max(this.zoom * factor, 0.2), 200);
    const now = this.toWorld(at);
    this.centre = this.centre.map((c, a) => c + fixed[a] - now[a]);
    this.draw();
  }

  paint() {
    const { canvas } = this;
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (width === 0) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const context = (this.context = canvas.getContext("2d"));
    const style = getComputedStyle(canvas);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.lineJoin = context.lineCap = "round";
    this.drawDensity();
    this.drawGrid(width, height);
    drawObstacles(this, [...this.obstacles, ...(this.sketch ? [this.sketch] : [])]);
    drawWaypoints(this);
    drawGhost(this);
    this.drawBody(this.bodies.known, "measured", 2.4);
    this.drawBody(this.bodies.unknown, "unknown", 2.4, [3, 5]);
    for (const middle of this.bodies.marks) drawQuestion(this, middle);
    this.drawBody(this.bodies.commanded, "commanded", 1.6, [5, 4]);
    if (this.state?.target) drawCross(this, this.state.target.position, "goal");
    this.editor.points.forEach((point, k) => drawGoal(this, point, k));
    if (this.state?.tip) drawTip(this, this.state.tip);
  }

  drawDensity() {
    if (!this.picture) return;
    const { density, base } = this.arm;
    const { context, scale } = this;
    const [x, y] = this.toScreen([base[0][3], base[1][3]]);
    context.save();
    context.transform(scale * base[0][0], -scale * base[1][0], scale * base[0][1], -scale * base[1][1], x, y);
    const [left, low] = [density.first[0] - density.pixel / 2, density.first[1] - density.pixel / 2];
    const [wide, tall] = [density.shape[2] * density.pixel, density.shape[1] * density.pixel];
    context.scale(1, -1); // the first row of the picture has the greatest y
    context.imageSmoothingEnabled = scale * density.pixel < 3;
    context.drawImage(this.picture, left, -low - tall, wide, tall);
    context.restore();
  }

  drawGrid(width, height) {
    const { context } = this;
    const step = niceStep(90 / this.scale);
    const [left, top] = this.toWorld([0, 0]);
    const [right, bottom] = this.toWorld([width, height]);
    context.strokeStyle = this.colour("grid");
    context.fillStyle = this.colour("faint");
    context.lineWidth = 1;
    const digits = digitsOf(step);
    const labels = [];
    for (let x = Math.ceil(left / step) * step; x <= right; x += step) {
      const [px] = this.toScreen([x, 0]);
      this.line([[px, 0], [px, height]]);
      labels.push([x.toFixed(digits), px + 3, height - 4]);
    }
    for (let y = Math.ceil(bottom / step) * step; y <= top; y += step) {
      const [, py] = this.toScreen([0, y]);
      this.line([[0, py], [width, py]]);
      labels.push([y.toFixed(digits), 3, py - 3]);
    }
    context.font = "11px system-ui, sans-serif";
    context.strokeStyle = this.colour("card"); // no line crosses a number
    context.lineWidth = 3;
    for (const label of labels) {
      context.strokeText(...label);
      context.fillText(...label);
    }
    context.font = "italic bold 13px system-ui, sans-serif";
    context.fillText("x", width - 12, height - 16);
    context.fillText("y", 22, 14);
  }

  line(points) {
    this.context.beginPath();
    points.forEach(([x, y], k) => (k ? this.context.lineTo(x, y) : this.context.moveTo(x, y)));
    this.context.stroke();
  }

  drawBody(body, colour, width, dash = []) {
    if (!body) return;
    const { context } = this;
    context.setLineDash(dash);
    context.strokeStyle = this.colour(colour);
    context.lineWidth = width;
    context.beginPath();
    for (let k = 0; k < body.length; k += 4) {
      context.moveTo(...this.toScreen([body[k], body[k + 1]]));
      context.lineTo(...this.toScreen([body[k + 2], body[k + 3]]));
    }
    context.stroke();
    context.setLineDash([]);
  }
}
