// Parts of a spatial scene: bars of the arm's structure, obstacles, density points.

import * as THREE from "three";

const UP = new THREE.Vector3(0, 1, 0);

// Line segments as instanced thin cylinders; there may be thousands.
export class Bars {
  constructor(scene, radius, opacity = 1) {
    this.scene = scene;
    this.geometry = new THREE.CylinderGeometry(radius, radius, 1, 8, 1);
    this.material = new THREE.MeshLambertMaterial({ transparent: opacity < 1, opacity, depthWrite: opacity === 1 });
    this.mesh = null;
    this.shown = null;
  }

  set(body, colour) {
    this.material.color.set(colour);
    if (body === this.shown) return;
    this.shown = body;
    const count = (body?.length ?? 0) / 6;
    if (this.mesh && this.mesh.instanceMatrix.count < count) {
      this.scene.remove(this.mesh);
      this.mesh.dispose();
      this.mesh = null;
    }
    if (!this.mesh && count > 0) {
      this.mesh = new THREE.InstancedMesh(this.geometry, this.material, count);
      this.mesh.frustumCulled = false;
      this.scene.add(this.mesh);
    }
    if (!this.mesh) return;
    this.mesh.count = count;
    const [from, to, along, turn, size, matrix] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3(), new THREE.Quaternion(), new THREE.Vector3(), new THREE.Matrix4()];
    for (let k = 0; k < count; k += 1) {
      from.fromArray(body, 6 * k);
      to.fromArray(body, 6 * k + 3);
      const length = along.subVectors(to, from).length();
      turn.setFromUnitVectors(UP, along.divideScalar(length || 1));
      this.mesh.setMatrixAt(k, matrix.compose(from.add(to).multiplyScalar(0.5), turn, size.set(1, length, 1)));
    }
    this.mesh.instanceMatrix.needsUpdate = true;
  }
}

// The mesh of an obstacle; of a half-space, a square of its boundary plane near the arm.
export function obstacleMesh(region, colour, reach) {
  const material = new THREE.MeshLambertMaterial({ color: colour, transparent: true, opacity: 0.35, side: THREE.DoubleSide, depthWrite: false });
  const mesh = new THREE.Mesh(undefined, material);
  if (region.sphere) {
    mesh.geometry = new THREE.SphereGeometry(region.sphere.radius, 24, 16);
    mesh.position.fromArray(region.sphere.centre);
  } else if (region.box) {
    mesh.geometry = new THREE.BoxGeometry(...region.box.size);
    mesh.position.fromArray(region.box.centre);
    if (region.box.orientation) mesh.quaternion.fromArray(region.box.orientation);
  } else if (region.half_space) {
    const { point, normal } = region.half_space;
    mesh.geometry = new THREE.PlaneGeometry(2 * reach, 2 * reach);
    mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3().fromArray(normal).normalize());
    mesh.position.fromArray(point);
  }
  mesh.add(new THREE.LineSegments(new THREE.EdgesGeometry(mesh.geometry, 30), new THREE.LineBasicMaterial({ color: colour })));
  return mesh;
}

// The outline of all points within a radius of a line: circles at both ends, half circles beyond, and lines between.
export function capsule(from, to, radius) {
  const [begin, end] = [new THREE.Vector3(...from), new THREE.Vector3(...to)];
  const along = end.clone().sub(begin).normalize();
  if (along.lengthSq() === 0) along.set(0, 0, 1);
  const side = new THREE.Vector3(1, 0, 0);
  if (Math.abs(along.x) > 0.9) side.set(0, 1, 0);
  side.cross(along).normalize();
  const other = along.clone().cross(side);
  const points = [];
  const arc = (centre, first, second, least, most) => {
    const at = (k) => {
      const angle = least + ((most - least) * k) / 24;
      return centre.clone().addScaledVector(first, radius * Math.cos(angle)).addScaledVector(second, radius * Math.sin(angle));
    };
    for (let k = 0; k < 24; k += 1) points.push(at(k), at(k + 1));
  };
  for (const [centre, sign] of [[begin, -1], [end, 1]]) {
    arc(centre, side, other, 0, 2 * Math.PI);
    for (const across of [side, other]) arc(centre, across, along.clone().multiplyScalar(sign), 0, Math.PI);
  }
  for (const across of [side, other]) {
    for (const sign of [-radius, radius]) {
      points.push(begin.clone().addScaledVector(across, sign), end.clone().addScaledVector(across, sign));
    }
  }
  return new THREE.BufferGeometry().setFromPoints(points);
}

// Points (x, y, z, density) in the base's frame.
export function cloud(points, size, colour) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flatMap(([x, y, z]) => [x, y, z]), 3));
  const material = new THREE.PointsMaterial({ size, color: colour, transparent: true, opacity: 0.22, depthWrite: false });
  return new THREE.Points(geometry, material);
}

export function frameOf(rows) {
  return new THREE.Matrix4().set(...rows.flat());
}
