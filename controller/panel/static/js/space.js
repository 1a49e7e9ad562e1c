// A spatial arm in three.js. The server computes the line segments.

import * as THREE from "three";
import { OrbitControls } from "../vendor/OrbitControls.js";
import { NOTHING } from "./bodies.js";
import { listenInSpace } from "./space-input.js";
import { Bars, capsule, cloud, frameOf, obstacleMesh } from "./space-parts.js";
import { Scale } from "./space-scale.js";
import { View } from "./view.js";

const HALF_ANGLE = 0.4; // tangent of half the vertical field of view, in a picture that is wide enough
const WIDE = 1.12; // width by height of a picture that is wide enough for the scale

export class SpaceView extends View {
  constructor(stage, arm, editor) {
    super();
    Object.assign(this, { stage, arm, editor, state: null, waypoints: [], obstacles: [], sketch: null });
    this.bodies = NOTHING;
    this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    this.canvas = this.renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("aria-label", "The arm in space; arrow keys move the view, with Shift they turn it");
    stage.replaceChildren(this.canvas);
    this.scene = new THREE.Scene();
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8890a0, 2.6));
    const sun = new THREE.DirectionalLight(0xffffff, 1.4);
    sun.position.set(2, -3, 5);
    this.scene.add(sun);
    this.camera = new THREE.PerspectiveCamera(1, 1, arm.length / 500, arm.length * 50);
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.listenToKeyEvents(this.canvas);
    this.orbit.addEventListener("change", () => this.draw());
    const thin = arm.length / 260;
    this.bars = { measured: new Bars(this.scene, thin), unknown: new Bars(this.scene, thin, 0.6), commanded: new Bars(this.scene, thin * 0.7, 0.55), ghosts: [] };
    this.tip = new THREE.Mesh(new THREE.SphereGeometry(3 * thin, 16, 12), new THREE.MeshLambertMaterial());
    this.goal = new THREE.Mesh(new THREE.OctahedronGeometry(4 * thin), new THREE.MeshLambertMaterial({ wireframe: true }));
    this.target = new THREE.Mesh(new THREE.OctahedronGeometry(4 * thin), new THREE.MeshLambertMaterial());
    this.path = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineDashedMaterial({ dashSize: 3 * thin, gapSize: 3 * thin }));
    this.stray = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ transparent: true, opacity: 0.55 }));
    this.regions = new THREE.Group();
    this.scene.add(this.tip, this.goal, this.target, this.path, this.stray, this.regions);
    this.scale = new Scale(this.scene, arm);
    const axes = new THREE.AxesHelper(arm.length / 8);
    axes.applyMatrix4(frameOf(arm.base));
    this.scene.add(axes);
    this.input = listenInSpace(this);
    this.fit();
    this.repaintWith(stage);
    this.loadDensity();
  }

  async loadDensity() {
    if (!this.arm.density) return;
    const response = await fetch(`arms/${this.arm.name}/density`);
    if (!response.ok) return;
    this.cloud = cloud(await response.json(), this.arm.density.pixel * 2, 0x808890);
    this.cloud.applyMatrix4(frameOf(this.arm.base));
    this.scene.add(this.cloud);
    this.draw();
  }

  fit() {
    const { base, length } = this.arm;
    const middle = new THREE.Vector3(0, 0, length * 0.4).applyMatrix4(frameOf(base));
    this.orbit.target.copy(middle);
    this.camera.position.set(middle.x + 1.3 * length, middle.y - 1.7 * length, middle.z + 0.7 * length);
    this.orbit.update();
    this.draw();
  }

  zoomBy(factor) {
    this.camera.position.sub(this.orbit.target).divideScalar(factor).add(this.orbit.target);
    this.orbit.update();
    this.draw();
  }

  paint() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    if (width === 0) return;
    if (this.size !== `${width} ${height}`) {
      this.size = `${width} ${height}`;
      this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      const half = HALF_ANGLE * Math.max(1, WIDE / this.camera.aspect); // a narrow picture shows the whole scale, too
      this.camera.fov = (360 / Math.PI) * Math.atan(half);
      this.pixel = (2 * half) / height;
      this.camera.updateProjectionMatrix();
    }
    const style = getComputedStyle(this.stage);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const { bodies, state, editor } = this;
    this.bars.measured.set(bodies.known, colour("measured"));
    this.bars.unknown.set(bodies.unknown, colour("unknown"));
    this.bars.commanded.set(bodies.commanded, colour("commanded"));
    this.paintGhosts(colour("ghost"));
    this.place(this.tip, state?.tip?.position, colour("measured"));
    this.place(this.target, state?.target?.position, colour("goal"));
    const last = editor.points.at(-1);
    this.place(this.goal, last?.position, colour(editor.refused ? "bad" : "ghost"));
    this.input.follow(last);
    this.paintPath(colour("goal"));
    this.paintRegions(colour("obstacle"));
    this.scale.paint(colour("edge"), colour("faint"), this.pixel);
    this.renderer.render(this.scene, this.camera);
  }

  place(mesh, position, colour) {
    mesh.visible = Boolean(position);
    if (!position) return;
    mesh.position.fromArray(position);
    mesh.material.color.set(colour);
  }

  // The planned configurations, and the outline of the region that the tip does not leave on the way to the first.
  paintGhosts(colour) {
    const plan = this.editor.validPlan;
    const points = plan?.accepted ? plan.waypoints.filter((waypoint) => waypoint.body).slice(0, 20) : [];
    while (this.bars.ghosts.length < points.length) this.bars.ghosts.push(new Bars(this.scene, this.arm.length / 300, 0.45));
    this.bars.ghosts.forEach((bars, k) => bars.set(points[k]?.body ?? [], colour));
    const from = this.state?.tip?.position;
    this.stray.visible = Boolean(from && points[0]?.excursion);
    if (!this.stray.visible) return;
    this.stray.material.color.set(colour);
    const now = JSON.stringify([from, points[0].position, points[0].excursion]);
    if (now === this.shownStray) return;
    this.shownStray = now;
    this.stray.geometry.dispose();
    this.stray.geometry = capsule(from, points[0].position, points[0].excursion);
  }

  paintPath(colour) {
    const points = (this.waypoints.length > 1 ? this.waypoints : this.editor.points).map((point) => new THREE.Vector3(...point.position));
    this.path.visible = points.length > 1;
    if (points.length < 2) return;
    this.path.geometry.dispose();
    this.path.geometry = new THREE.BufferGeometry().setFromPoints(points);
    this.path.computeLineDistances();
    this.path.material.color.set(colour);
  }

  paintRegions(colour) {
    const all = [...this.obstacles, ...(this.sketch ? [this.sketch] : [])];
    const now = JSON.stringify([all, colour]);
    if (now === this.shownRegions) return;
    this.shownRegions = now;
    for (const mesh of this.regions.children) mesh.geometry.dispose();
    this.regions.clear();
    for (const region of all) this.regions.add(obstacleMesh(region, colour, this.arm.length));
  }
}
