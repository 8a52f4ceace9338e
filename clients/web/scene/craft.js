// A vehicle as one sees it: made from the shapes, actuators and sensors that its file names, or from its glTF where it has one.
import * as THREE from "three";
import { isNowhere } from "../core/frames.js";
import { compact, MOVES } from "./compact.js";
import { loadLooks } from "./looks.js";
import { GhostPaints } from "./materials.js";
import { along, COLOURS, instrument, makeFin, openFrame, pontoon, put, softBox, thruster, torpedo } from "./parts.js";
import { geometryOf, triangles } from "./solids.js";
import { turn } from "./stage.js";
/** @typedef {import("../types").Body} Body @typedef {import("../types").Shape} Shape @typedef {import("../types").Actuator} Actuator @typedef {import("../types").Lamp} Lamp @typedef {import("./materials.js").Painter} Paints */

const SPIN_RADPS = 38;

/** Fetches what the server holds by hash. @typedef {{mesh: (hash: string) => Promise<ArrayBuffer>, looks: (hash: string) => Promise<ArrayBuffer>, failed: (why: string) => void}} Store */

/** One vehicle or free object; `group` is in N. */
export class Craft {
  /** @param {Body} body @param {import("./materials.js").Paints} paints @param {Store} store @param {Map<string, THREE.Group>} known looks of those that were made already */
  constructor(body, paints, store, known) {
    this.body = body;
    this.group = new THREE.Group();
    this.group.name = body.name;
    /** Turning parts, with their place among the body's actuators. @type {{rotor: THREE.Object3D, index: number, hand: number}[]} */
    this.rotors = [];
    /** @type {{turning: THREE.Object3D, hinge: THREE.Vector3, index: number}[]} */
    this.fins = [];
    this.size = extent(body);
    const paint = body.ghost ? new GhostPaints(paints, body.colour ?? [0.5, 0.5, 0.5]) : paints;
    this.looks = new THREE.Group();
    this.group.add(this.looks);
    if (body.looks) {
      loadLooks(body.looks, store).then((looks) => {
        if (body.ghost) looks.traverse((part) => { if (part instanceof THREE.Mesh) part.material = paint.plain(""); });
        this.looks.add(looks);
      }, (/** @type {Error} */ error) => {
        store.failed(`looks of ${body.name}: ${error.message}`);
        this.make(paint, store, known);
      });
    } else {
      this.make(paint, store, known);
    }
    this.lamps = (body.lamps?.length ? body.lamps.map(spot) : [usual(this.size.x)]).map(({ lamp, full }) => {
      lamp.visible = false;
      this.group.add(lamp, lamp.target);
      return { lamp, full };
    });
  }

  /** Like another one of its kind where there is one. @param {Paints} paints @param {Store} store @param {Map<string, THREE.Group>} known */
  make(paints, store, known) {
    const { body } = this;
    const fittings = (body.actuators ?? []).map(({ port: _, ...rest }) => rest);
    const kind = JSON.stringify([body.model === "object", body.ghost && body.colour, body.shapes, fittings, (body.sensors ?? []).map((sensor) => [sensor.message, sensor.p, sensor.q])]);
    const later = body.shapes.some((shape) => shape.kind === "mesh");
    let whole = known.get(kind);
    if (!whole) {
      this.build(paints, store);
      if (later) {
        this.findMoving();
        return;
      }
      whole = compact(this.looks);
      known.set(kind, whole);
    }
    this.looks.removeFromParent();
    this.looks = whole.clone();
    this.group.add(this.looks);
    this.findMoving();
  }

  /** What turns, among the parts. */
  findMoving() {
    this.looks.traverse((part) => {
      const moves = part.userData[MOVES];
      if (moves?.kind === "rotor") this.rotors.push({ rotor: part, index: moves.index, hand: moves.hand });
      if (moves?.kind === "fin") this.fins.push({ turning: part, hinge: new THREE.Vector3(...moves.hinge), index: moves.index });
    });
  }

  /** @param {Paints} paints @param {Store} store */
  build(paints, store) {
    const { body } = this;
    const actuators = body.actuators ?? [];
    const thrusters = actuators.some((actuator) => actuator.kind === "thruster");
    const steered = actuators.some((actuator) => actuator.kind === "fin" || actuator.kind === "propeller");
    for (const shape of body.shapes) {
      if (thrusters && /thruster/.test(shape.name ?? "")) continue;
      const part = this.shapePart(shape, paints, store, steered);
      if (!part) continue;
      part.position.set(...(shape.p ?? [0, 0, 0]));
      part.quaternion.copy(turn(shape.q ?? [1, 0, 0, 0]));
      this.looks.add(part);
    }
    actuators.forEach((actuator, index) => this.addActuator(actuator, index, paints));
    for (const sensor of body.sensors ?? []) {
      const part = instrument(paints, sensor, 0.5 * this.size.z);
      if (!part) continue;
      part.position.set(...sensor.p);
      part.quaternion.copy(turn(sensor.q));
      this.looks.add(part);
    }
  }

  /** @param {Shape} shape @param {Paints} paints @param {Store} store @param {boolean} steered @returns {THREE.Object3D | null} */
  shapePart(shape, paints, store, steered) {
    const name = shape.name ?? "";
    const free = this.body.model === "object";
    const size = shape.size ?? [0.1, 0.1, 0.1];
    if (!free && shape.kind === "box" && /frame/.test(name)) return openFrame(paints, size);
    if (!free && shape.kind === "box" && /pontoon|float_hull/.test(name)) return pontoon(paints, size);
    if (!free && shape.kind === "capsule") {
      return torpedo(paints, shape.radius ?? 0.1, (shape.length ?? 1) + 2 * (shape.radius ?? 0.1), COLOURS.hull, steered);
    }
    const group = new THREE.Group();
    const colour = free ? new THREE.Color(...(shape.colour ?? [0.6, 0.6, 0.6])) : new THREE.Color(partColour(name));
    const paint = paints.plain(colour, { rough: 0.55 });
    if (shape.kind === "mesh") {
      store.mesh(shape.mesh ?? "").then((data) => put(group, triangles(data), paint), (/** @type {Error} */ error) => store.failed(error.message));
    } else if (shape.kind === "box") {
      put(group, softBox(size, (/hull/.test(name) ? 0.3 : 0.12) * Math.min(...size), paints.fine ? 4 : 2), paint);
      if (/deck/.test(name)) put(group, new THREE.CylinderGeometry(0.015, 0.02, 0.7, 10).rotateX(Math.PI / 2), paints.plain(COLOURS.metal), [0.1 * size[0], 0, -0.5 * size[2] - 0.35]);
    } else {
      const geometry = geometryOf(shape, paints.fine);
      if (geometry) put(group, geometry, paint);
    }
    return group;
  }

  /** @param {Actuator} actuator @param {number} index @param {Paints} paints */
  addActuator(actuator, index, paints) {
    const small = Math.min(this.size.y, this.size.z);
    if (actuator.kind === "thruster" || actuator.kind === "propeller") {
      const ducted = actuator.kind === "thruster";
      const radius = 0.5 * (actuator.diameter || (ducted ? Math.min(0.1, 0.35 * small) : 0.8 * small));
      const { group, rotor } = thruster(paints, radius, ducted, actuator.handedness);
      group.position.set(...actuator.p);
      along(group, actuator.axis ?? [1, 0, 0]);
      this.looks.add(group);
      rotor.userData[MOVES] = { kind: "rotor", index, hand: actuator.handedness === "left" ? -1 : 1 };
    } else if (actuator.kind === "fin") {
      const { group, turning, hinge } = makeFin(paints, actuator, 0.5 * small);
      this.looks.add(group);
      turning.userData[MOVES] = { kind: "fin", index, hinge: hinge.toArray() };
    }
  }

  /** Place it, and turn what turns. @param {Float32Array} poses @param {number} i of its pose @param {Int8Array} achieved @param {number} first of its actuators @param {number} dt s */
  update(poses, i, achieved, first, dt) {
    this.group.visible = !isNowhere(poses, i);
    this.group.position.set(poses[i], poses[i + 1], poses[i + 2]);
    this.group.quaternion.set(poses[i + 4], poses[i + 5], poses[i + 6], poses[i + 3]);
    for (const { rotor, index, hand } of this.rotors) {
      const part = (achieved[first + index] ?? 0) / 127;
      // Thrust goes with the square of the speed.
      rotor.rotation.x += hand * Math.sign(part) * Math.sqrt(Math.abs(part)) * SPIN_RADPS * dt;
    }
    for (const { turning, hinge, index } of this.fins) {
      const actuator = (this.body.actuators ?? [])[index];
      const [low, high] = [actuator.low ?? -0.3, actuator.high ?? 0.3];
      const angle = (low + high) / 2 + ((high - low) / 2) * ((achieved[first + index] ?? 0) / 127);
      turning.quaternion.setFromAxisAngle(hinge, angle);
    }
  }

  /** @param {boolean} on */
  light(on) {
    for (const { lamp, full } of this.lamps) {
      lamp.visible = on;
      lamp.intensity = on ? full : 0;
    }
  }
}

/** How bright the picture is for a lamp of as many candela. */
const PICTURE_PER_CANDELA = 0.05;

/** A lamp as the vehicle's file has it. @param {Lamp} given */
function spot({ p, q, cone, lumens }) {
  const half = Math.min(0.5 * cone, 0.49 * Math.PI);
  const candela = lumens / (2 * Math.PI * (1 - Math.cos(half)));
  const lamp = new THREE.SpotLight("#fff1d0", 0, 30, half, 0.6, 1.2);
  lamp.position.set(...p);
  lamp.target.position.set(5, 0, 0).applyQuaternion(turn(q)).add(lamp.position);
  return { lamp, full: PICTURE_PER_CANDELA * candela };
}

/** A lamp for a vehicle whose file has none: ahead, a little down. @param {number} length of the vehicle */
function usual(length) {
  const lamp = new THREE.SpotLight("#fff1d0", 0, 30, 0.55, 0.6, 1.2);
  lamp.position.set(0.45 * length, 0, 0);
  lamp.target.position.set(5, 0, 0.5);
  return { lamp, full: 30 };
}

/** @param {string} name of a part */
function partColour(name) {
  if (/foam|float|top/.test(name)) return COLOURS.float;
  if (/tube/.test(name)) return COLOURS.tube;
  if (/side|plate|keel|frame|wing|tail/.test(name)) return COLOURS.frame;
  if (/deck/.test(name)) return COLOURS.white;
  return COLOURS.hull;
}

/** Whole size of a body's shapes along the axes of B; a guess for meshes. @param {Body} body */
function extent(body) {
  const low = new THREE.Vector3(Infinity, Infinity, Infinity);
  const high = new THREE.Vector3(-Infinity, -Infinity, -Infinity);
  const long = new THREE.Vector3();
  for (const shape of body.shapes) {
    const radius = shape.radius ?? 0.25;
    if (shape.kind === "box") long.set(...(shape.size ?? [0.1, 0.1, 0.1]));
    else if (shape.kind === "cylinder") long.set(shape.length ?? 1, 2 * radius, 2 * radius);
    else if (shape.kind === "capsule") long.set((shape.length ?? 1) + 2 * radius, 2 * radius, 2 * radius);
    else long.set(2 * radius, 2 * radius, 2 * radius);
    const p = new THREE.Vector3(...(shape.p ?? [0, 0, 0]));
    low.min(p.clone().addScaledVector(long, -0.5));
    high.max(p.clone().addScaledVector(long, 0.5));
  }
  return Number.isFinite(low.x) ? high.sub(low) : new THREE.Vector3(0.5, 0.4, 0.3);
}
