// Where a pilot's training leads to next: an amber ring that turns, seen through everything.
import * as THREE from "three";
import { shown } from "./stage.js";

const RADIUS_M = 0.35;
const TURN_RADPS = 0.8;
/** Where it has its whole size; nearer it is smaller, so that it does not fill the picture. */
const WHOLE_M = 8;

/** A mark in N. */
export class Aim {
  constructor() {
    this.group = new THREE.Group();
    this.group.visible = false;
    const paint = new THREE.MeshBasicMaterial({ color: "#f0b441", transparent: true, opacity: 0.75, depthTest: false, fog: false });
    for (const turned of [0, Math.PI / 2]) {
      const ring = new THREE.Mesh(new THREE.TorusGeometry(RADIUS_M, 0.018, 8, 40), paint);
      ring.rotation.set(Math.PI / 2, turned, 0);
      ring.renderOrder = 7;
      this.group.add(ring);
    }
  }

  /** @param {number[] | null} p in N; null for none @param {number} t s of simulation @param {THREE.Camera} camera */
  show(p, t, camera) {
    this.group.visible = p !== null;
    if (!p) return;
    this.group.position.set(p[0], p[1], p[2]);
    this.group.scale.setScalar(Math.max(0.12, Math.min(1, shown(p).distanceTo(camera.position) / WHOLE_M)));
    this.group.rotation.z = (TURN_RADPS * t) % (2 * Math.PI);
  }
}
