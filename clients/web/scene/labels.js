// Names of bodies and beacons, as elements over the picture.
import * as THREE from "three";
import { byId, h } from "../core/dom.js";
import { ownColour } from "../core/frames.js";
import { shown } from "./stage.js";

const MOST = 40;
/** Room of a name, px. */
const [LETTER, EDGES, TALL] = [6.6, 18, 20];

/** What is external says so, in its own colour. @param {import("../types").Body} body */
function label(body) {
  if (!body.external) return h("div", { class: "label" }, body.name);
  const element = h("div", { class: "label external" }, body.name, h("i", {}, body.ghost ? "ghost" : "external"));
  element.style.borderColor = ownColour(body) ?? "";
  return element;
}

/** One element a name, moved where the thing is seen. */
export class Labels {
  /** @param {import("../types").Body[]} bodies @param {string[]} beacons */
  constructor(bodies, beacons) {
    const place = byId("labels");
    place.replaceChildren();
    this.bodies = bodies.slice(0, MOST).map((body) => place.appendChild(label(body)));
    this.beacons = beacons.slice(0, MOST).map((name) => place.appendChild(h("div", { class: "label beacon" }, name)));
    this.at = new THREE.Vector3();
    /** Where names stand already: left, right, bottom; px. @type {[number, number, number][]} */
    this.taken = [];
  }

  /** @param {import("./scene.js").WorldScene} scene @param {THREE.PerspectiveCamera} camera @param {Set<string>} layers */
  update(scene, camera, layers) {
    const canvas = scene.stage.canvas;
    const size = { width: canvas.clientWidth, height: canvas.clientHeight };
    camera.updateMatrixWorld();
    this.taken.length = 0;
    // The chosen one's stands where it belongs; others make room.
    const order = this.bodies.map((_, k) => k).sort((a, b) => Number(b === scene.chosen) - Number(a === scene.chosen));
    for (const k of order) {
      const label = this.bodies[k];
      const craft = scene.crafts[k];
      const own = k === scene.chosen;
      label.classList.toggle("chosen", own);
      const p = craft.group.position;
      const show = craft.group.visible && layers.has("labels") && !(own && scene.views.view !== "top" && scene.crafts.length === 1) && !(own && scene.views.view === "board");
      this.place(label, [p.x, p.y, p.z - 0.6 * craft.size.z - 0.12], camera, size, show);
    }
    this.beacons.forEach((label, k) => {
      const p = scene.acoustics.markers[k].position;
      this.place(label, [p.x, p.y, p.z - 0.5], camera, size, layers.has("labels") && layers.has("acoustics"));
    });
  }

  /** @param {HTMLElement} label @param {number[]} p @param {THREE.PerspectiveCamera} camera @param {{width: number, height: number}} size @param {boolean} show */
  place(label, p, camera, size, show) {
    const at = shown(p, 0, this.at).project(camera);
    const seen = show && at.z < 1 && Math.abs(at.x) < 1.1 && Math.abs(at.y) < 1.1;
    label.style.display = seen ? "" : "none";
    if (!seen) return;
    const x = ((at.x + 1) / 2) * size.width;
    const half = (LETTER * (label.textContent?.length ?? 0) + EDGES) / 2;
    const bottom = this.free(x - half, x + half, ((1 - at.y) / 2) * size.height);
    label.style.transform = `translate(${x}px, ${bottom}px) translate(-50%, -100%)`;
  }

  /** The lowest place, from `bottom` up, where a name covers no other one. @param {number} left @param {number} right @param {number} bottom px */
  free(left, right, bottom) {
    const beside = this.taken.filter(([l, r]) => l < right && left < r).sort((a, b) => b[2] - a[2]);
    for (const [, , there] of beside) if (Math.abs(there - bottom) < TALL) bottom = there - TALL;
    this.taken.push([left, right, bottom]);
    return bottom;
  }

  dispose() {
    byId("labels").replaceChildren();
  }
}
