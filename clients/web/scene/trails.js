// Where bodies have been: the last three hundred places, five centimetres apart or more.
import * as THREE from "three";
import { wet } from "./water.js";

const POINTS = 300;
const APART_M = 0.05;
export const TRAIL_COLOURS = ["#5fe3f5", "#ffc24d", "#8cf09a", "#e0a6ff", "#ff9d7d", "#a3c1ff"];

/** A trail in N. */
export class Trail {
  /** @param {number} index of the body, for its colour @param {string | null} [own] colour of its own */
  constructor(index, own = null) {
    this.colour = own ?? TRAIL_COLOURS[index % TRAIL_COLOURS.length];
    this.base = new THREE.Color(this.colour);
    /** Places, the oldest first; also for the map. @type {number[]} */
    this.places = [];
    this.apart = APART_M;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * (POINTS + 1)), 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(4 * (POINTS + 1)), 4));
    geometry.setDrawRange(0, 0);
    this.line = new THREE.Line(geometry, wet(new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false })));
    this.line.frustumCulled = false;
  }

  /** @param {Float32Array} poses @param {number} i */
  add(poses, i) {
    const { places } = this;
    const n = places.length;
    const far = n < 3 || Math.hypot(poses[i] - places[n - 3], poses[i + 1] - places[n - 2], poses[i + 2] - places[n - 1]) >= this.apart;
    if (far) {
      places.push(poses[i], poses[i + 1], poses[i + 2]);
      if (places.length > 3 * POINTS) places.splice(0, 3);
      this.draw();
    }
    this.end(poses, i, far);
  }

  /** All places, fading towards the oldest. */
  draw() {
    const geometry = this.line.geometry;
    const points = /** @type {THREE.BufferAttribute} */ (geometry.getAttribute("position"));
    const colours = /** @type {THREE.BufferAttribute} */ (geometry.getAttribute("color"));
    const n = this.places.length / 3;
    /** @type {Float32Array} */ (points.array).set(this.places);
    for (let k = 0; k <= n; k += 1) colours.setXYZW(k, this.base.r, this.base.g, this.base.b, Math.min(1, (k + 1) / n));
    points.clearUpdateRanges();
    points.needsUpdate = colours.needsUpdate = true;
    geometry.setDrawRange(0, n + 1);
  }

  /** The way from the last place to where the body is now. @param {Float32Array} poses @param {number} i @param {boolean} whole all is sent to the card anyway */
  end(poses, i, whole) {
    const points = /** @type {THREE.BufferAttribute} */ (this.line.geometry.getAttribute("position"));
    const n = this.places.length / 3;
    points.setXYZ(n, poses[i], poses[i + 1], poses[i + 2]);
    if (!whole && !points.updateRanges.length) points.addUpdateRange(3 * n, 3);
    points.needsUpdate = true;
  }

  clear() {
    this.places.length = 0;
    this.line.geometry.setDrawRange(0, 0);
  }
}
