// The scale of a spatial scene: a grid on the floor of the base, with numbers along x, y and z in the world.

import * as THREE from "three";
import { digitsOf, niceStep } from "./scale.js";

const HEIGHT = 17; // [pixels] of a number on the screen, with its margin
const PIXELS = 64; // height of a number's texture

export class Scale {
  constructor(scene, arm) {
    this.group = new THREE.Group();
    this.arm = arm;
    this.shown = "";
    scene.add(this.group);
  }

  // Builds the scale in its colours; again only if a colour or the pixel's size at distance 1 has changed.
  paint(edge, text, pixel) {
    const now = `${edge} ${text} ${pixel}`;
    if (now === this.shown) return;
    this.shown = now;
    for (const part of this.group.children) {
      part.material.map?.dispose();
      part.material.dispose();
      part.geometry.dispose();
    }
    this.group.clear();
    const { base, length } = this.arm;
    const step = niceStep(length / 8);
    const count = Math.ceil(0.4 * length / step); // lines on each side of the base
    const middle = [0, 1].map((axis) => Math.round(base[axis][3] / step) * step);
    const floor = base[2][3];
    const grid = new THREE.GridHelper(2 * count * step, 2 * count, edge, edge);
    grid.rotation.x = Math.PI / 2;
    grid.position.set(...middle, floor);
    const [left, right] = [-1, 1].map((side) => middle.map((x) => x + side * count * step));
    const add = (words, ...at) => this.group.add(numeral(words, text, at, HEIGHT * pixel));
    const tick = (value) => value.toFixed(digitsOf(step));
    for (let k = -count; k <= count; k += 1) {
      add(tick(middle[0] + k * step), middle[0] + k * step, left[1] - 0.3 * step, floor);
      add(tick(middle[1] + k * step), right[0] + 0.3 * step, middle[1] + k * step, floor);
    }
    add("x", middle[0] + 0.5 * step, left[1] - 0.9 * step, floor);
    add("y", right[0] + 0.9 * step, middle[1] + 0.5 * step, floor);
    const top = Math.floor((floor + length) / step) * step;
    for (let z = Math.ceil(floor / step + 0.5) * step; z <= top + step / 2; z += step) add(tick(z), left[0] - 0.3 * step, left[1], z);
    add("z", left[0] - 0.3 * step, left[1], top + 0.6 * step);
    const upright = new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(left[0], left[1], floor), new THREE.Vector3(left[0], left[1], top)]);
    this.group.add(grid, new THREE.Line(upright, new THREE.LineBasicMaterial({ color: edge })));
  }
}

// A text of constant size on the screen that faces the camera.
function numeral(words, colour, at, height) {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  const font = `${PIXELS * 0.72}px system-ui, sans-serif`;
  context.font = font;
  canvas.width = Math.ceil(context.measureText(words).width) + 8;
  canvas.height = PIXELS;
  context.font = font; // a canvas forgets its font when its size changes
  context.fillStyle = colour;
  context.textBaseline = "middle";
  context.fillText(words, 4, PIXELS / 2);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, sizeAttenuation: false, depthWrite: false }));
  sprite.scale.set((height * canvas.width) / PIXELS, height, 1);
  sprite.position.set(...at);
  return sprite;
}
