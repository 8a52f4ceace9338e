// Current as arrows that drift with it, about the place one looks at; and touches, where the vehicle's contact sensor tells of them.
import * as THREE from "three";
import { wet } from "./water.js";
/** @typedef {import("../types").Water} Water @typedef {import("../types").Vec3} Vec3 */

const SIDE = 5;
const LAYERS = 3;

/** Velocity of the current at a depth. @param {Water} water @param {number} depth @returns {Vec3} */
export function currentAt(water, depth) {
  const sum = /** @type {Vec3} */ ([...water.current]);
  for (const profile of water.profiles) {
    const k = profile.findIndex(([deep]) => deep > depth);
    const [above, below] = [profile[k < 0 ? profile.length - 1 : Math.max(0, k - 1)], profile[k < 0 ? profile.length - 1 : k]];
    const part = below[0] > above[0] ? (depth - above[0]) / (below[0] - above[0]) : 0;
    for (let axis = 0; axis < 3; axis += 1) sum[axis] += above[1][axis] + (below[1][axis] - above[1][axis]) * part;
  }
  return sum;
}

/** A field of arrows in N. */
export class Flow {
  constructor() {
    const arrow = new THREE.ConeGeometry(0.09, 0.28, 7).translate(0, 0.86, 0);
    const shaft = new THREE.CylinderGeometry(0.025, 0.025, 0.72, 5).translate(0, 0.36, 0);
    const material = wet(new THREE.MeshBasicMaterial({ color: "#bff0ff", transparent: true, opacity: 0.5, depthWrite: false }));
    this.group = new THREE.Group();
    this.parts = [arrow, shaft].map((geometry) => {
      const mesh = new THREE.InstancedMesh(geometry.rotateZ(-Math.PI / 2), material, SIDE * SIDE * LAYERS);
      mesh.frustumCulled = false;
      this.group.add(mesh);
      return mesh;
    });
    this.dummy = new THREE.Object3D();
    this.drift = new THREE.Vector3();
  }

  /** @param {Water} water @param {ArrayLike<number>} about N @param {number} spacing m @param {number} dt s of simulation @param {number} floor depth of the bottom */
  update(water, about, spacing, dt, floor) {
    let k = 0;
    const [vx, vy] = currentAt(water, about[2]);
    this.drift.x = (this.drift.x + vx * dt) % spacing;
    this.drift.y = (this.drift.y + vy * dt) % spacing;
    for (let layer = 0; layer < LAYERS; layer += 1) {
      const depth = Math.min(Math.max(0.4, about[2] + (layer - 1) * spacing * 0.7), Math.max(0.4, floor - 0.3));
      const v = currentAt(water, depth);
      const speed = Math.hypot(...v);
      for (let a = 0; a < SIDE; a += 1) {
        for (let b = 0; b < SIDE; b += 1) {
          const north = (Math.round(about[0] / spacing) + a - (SIDE - 1) / 2) * spacing + this.drift.x;
          const east = (Math.round(about[1] / spacing) + b - (SIDE - 1) / 2) * spacing + this.drift.y;
          this.dummy.position.set(north, east, depth);
          this.dummy.scale.setScalar(speed < 0.005 ? 0 : spacing * Math.min(0.8, 0.15 + 0.6 * speed));
          if (speed > 0) this.dummy.quaternion.setFromUnitVectors(new THREE.Vector3(1, 0, 0), new THREE.Vector3(...v).divideScalar(speed));
          this.dummy.updateMatrix();
          for (const part of this.parts) part.setMatrixAt(k, this.dummy.matrix);
          k += 1;
        }
      }
    }
    for (const part of this.parts) part.instanceMatrix.needsUpdate = true;
  }
}

/** Points that touch, in B of a vehicle. */
export class Touches {
  constructor() {
    this.group = new THREE.Group();
    const material = new THREE.MeshBasicMaterial({ color: "#ff3b30", transparent: true, opacity: 0.9, depthTest: false });
    this.dots = [0, 1, 2, 3].map(() => {
      const dot = new THREE.Mesh(new THREE.SphereGeometry(0.02, 10, 8), material);
      dot.visible = false;
      dot.renderOrder = 8;
      this.group.add(dot);
      return dot;
    });
  }

  /** @param {import("../types").Sample} sample */
  take(sample) {
    const points = Array.isArray(sample.value.points_B) ? sample.value.points_B : [];
    const count = typeof sample.value.count === "number" ? sample.value.count : 0;
    this.dots.forEach((dot, k) => {
      const point = points[k];
      dot.visible = k < count && Array.isArray(point) && point.every(Number.isFinite);
      if (dot.visible) dot.position.set(point[0], point[1], point[2]);
    });
  }
}
