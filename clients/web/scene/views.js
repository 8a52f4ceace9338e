// From where one looks: around the vehicle, behind it, out of it, or from above with north up.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { shown } from "./stage.js";
/** @typedef {"orbit" | "follow" | "board" | "top"} View */

export const VIEWS = /** @type {const} */ ({ orbit: "Orbit", follow: "Follow", board: "On board", top: "Top" });

/** Moves the camera. */
export class Views {
  /** @param {THREE.PerspectiveCamera} camera @param {HTMLElement} canvas */
  constructor(camera, canvas) {
    this.camera = camera;
    this.controls = new OrbitControls(camera, canvas);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.12;
    this.controls.minDistance = 0.35;
    this.controls.maxDistance = 600;
    this.controls.keyPanSpeed = 0;
    /** @type {View} */
    this.view = "orbit";
    this.size = 0.6;
    this.tilt = 0;
    this.last = new THREE.Vector3();
    this.bearing = NaN;
    this.fresh = true;
    /** How far away the camera wants to be, m. */
    this.reach = 3;
  }

  /** @param {View} view @param {number} size of the vehicle, m */
  choose(view, size) {
    this.view = view;
    this.size = Math.max(0.3, size);
    this.fresh = true;
    this.camera.up.set(0, 1, 0);
    this.controls.enabled = view !== "board";
    this.controls.enableRotate = view !== "top";
    this.controls.enablePan = view === "orbit" || view === "top";
    this.camera.near = view === "board" ? 0.03 : 0.05;
    this.camera.fov = view === "board" ? 75 : 55;
    this.camera.updateProjectionMatrix();
  }

  /**
   * Follow the chosen vehicle.
   * @param {THREE.Group} craft in N @param {ArrayLike<number>} pose @param {number} i @param {number} dt s
   * @param {{ceiling: number, floor: number}} room heights (up) between which the camera begins
   * @param {(from: THREE.Vector3, to: THREE.Vector3) => number} free how far one sees from the one place towards the other, m
   */
  update(craft, pose, i, dt, room, free) {
    const target = shown(pose, i, new THREE.Vector3());
    if (!Number.isFinite(target.x + target.y + target.z)) return;
    const heading = this.heading(craft);
    if (this.view === "board") {
      this.board(craft);
      return;
    }
    const { camera, controls } = this;
    if (this.fresh) {
      const reach = (this.view === "top" ? 9 : 3.2) * this.size + 0.4;
      if (this.view === "top") {
        camera.position.set(target.x, target.y + reach, target.z + 1e-3 * reach);
      } else {
        const aside = this.view === "follow" ? Math.PI : 2.45;
        camera.position.set(target.x + reach * Math.sin(heading + aside), target.y + 0.42 * reach, target.z - reach * Math.cos(heading + aside));
        camera.position.y = Math.max(room.floor, Math.min(room.ceiling, camera.position.y));
      }
      controls.target.copy(target);
      this.bearing = heading;
      this.fresh = false;
      this.reach = camera.position.distanceTo(target);
      this.comeIn(target, free);
    } else {
      const moved = target.clone().sub(this.last);
      camera.position.add(moved);
      controls.target.add(moved);
      if (this.view === "follow") {
        this.swing(heading, target, dt);
        this.comeIn(target, free);
      }
    }
    this.last.copy(target);
    camera.position.y = Math.max(camera.position.y, Math.min(room.floor, target.y + 0.1));
    const before = camera.position.distanceTo(target);
    controls.update();
    // What the pilot scrolled is how far away it shall be.
    this.reach *= camera.position.distanceTo(target) / Math.max(1e-3, before);
  }

  /** Before whatever stands between the camera and the vehicle. @param {THREE.Vector3} target @param {(from: THREE.Vector3, to: THREE.Vector3) => number} free */
  comeIn(target, free) {
    if (this.view === "top") return;
    const away = this.camera.position.clone().sub(target).setLength(this.reach);
    const most = Math.max(0.8 * this.size, free(target, away.clone().add(target)) - 0.15);
    this.camera.position.copy(target).add(away.setLength(Math.min(this.reach, most)));
  }

  /** Heading of a craft, from its attitude in N. @param {THREE.Group} craft */
  heading(craft) {
    const ahead = new THREE.Vector3(1, 0, 0).applyQuaternion(craft.quaternion);
    return Math.atan2(ahead.y, ahead.x);
  }

  /** Turn the camera about the vehicle as far as its heading turned, softly. @param {number} heading @param {THREE.Vector3} target @param {number} dt */
  swing(heading, target, dt) {
    const off = Math.atan2(Math.sin(heading - this.bearing), Math.cos(heading - this.bearing));
    const part = off * (1 - Math.exp(-2.5 * dt));
    this.bearing += part;
    this.camera.position.sub(target).applyAxisAngle(new THREE.Vector3(0, 1, 0), -part).add(target);
  }

  /** @param {THREE.Group} craft */
  board(craft) {
    const { camera } = this;
    const bow = new THREE.Vector3(0.5 * this.size + 0.06, 0, -0.02).applyQuaternion(craft.quaternion).add(craft.position);
    const ahead = new THREE.Vector3(Math.cos(this.tilt), 0, -Math.sin(this.tilt)).applyQuaternion(craft.quaternion).add(bow);
    const up = new THREE.Vector3(Math.sin(this.tilt) * -1, 0, -Math.cos(this.tilt)).applyQuaternion(craft.quaternion);
    camera.position.copy(shown(bow.toArray()));
    camera.up.copy(shown(up.toArray()));
    camera.lookAt(shown(ahead.toArray()));
    this.last.copy(camera.position);
  }
}
