// Parts that vehicles are made of: ducts with propellers, fins, torpedo hulls, open frames, pontoons, instruments. Axes of B: x ahead, y right, z down.
import * as THREE from "three";
/** @typedef {import("./materials.js").Painter} Paints @typedef {import("../types").Sensor} Sensor @typedef {import("../types").Actuator} Actuator @typedef {import("../types").Vec3} Vec3 */

export const COLOURS = { float: "#1f66d1", frame: "#20262c", hull: "#f2c21b", dark: "#14181c", tube: "#e9eef2", glass: "#a9d8ea", metal: "#aab4bb", lamp: "#fff3c4", blade: "#39434b", ring: "#2a3138", orange: "#f07d1c", white: "#f2f5f7" };

/** Turn a part that points along x so that it points along `axis`. @param {THREE.Object3D} part @param {ArrayLike<number>} axis */
export function along(part, axis) {
  part.quaternion.setFromUnitVectors(new THREE.Vector3(1, 0, 0), new THREE.Vector3(axis[0], axis[1], axis[2]).normalize());
  return part;
}

/** @param {THREE.Object3D} group @param {THREE.BufferGeometry} geometry @param {THREE.Material} material @param {Vec3} [place] */
export function put(group, geometry, material, place = [0, 0, 0]) {
  const mesh = new THREE.Mesh(geometry, material);
  mesh.position.set(...place);
  group.add(mesh);
  return mesh;
}

/** A body of revolution about x. @param {[x: number, radius: number][]} outline @param {number} around */
export function turned(outline, around) {
  const points = outline.map(([x, radius]) => new THREE.Vector2(radius, x));
  return new THREE.LatheGeometry(points, around).rotateZ(-Math.PI / 2);
}

/** A box with rounded edges. @param {Vec3} size @param {number} round @param {number} [steps] */
export function softBox([x, y, z], round, steps = 2) {
  const r = Math.min(round, x / 2.01, y / 2.01, z / 2.01);
  const shape = new THREE.Shape();
  const [w, h] = [x / 2 - r, y / 2 - r];
  shape.moveTo(-w, -h - r).lineTo(w, -h - r).absarc(w, -h, r, -Math.PI / 2, 0, false).lineTo(w + r, h).absarc(w, h, r, 0, Math.PI / 2, false)
    .lineTo(-w, h + r).absarc(-w, h, r, Math.PI / 2, Math.PI, false).lineTo(-w - r, -h).absarc(-w, -h, r, Math.PI, 1.5 * Math.PI, false);
  const depth = Math.max(1e-4, z - 2 * r);
  const bevel = Math.min(r, 0.4 * Math.min(x, y));
  const geometry = new THREE.ExtrudeGeometry(shape, { depth, bevelEnabled: true, bevelThickness: r, bevelSize: bevel, bevelOffset: -bevel, bevelSegments: steps, curveSegments: 2 + 2 * steps });
  return geometry.translate(0, 0, -depth / 2);
}

/**
 * A thruster: duct, hub, and a propeller that turns. It points along x.
 * @param {Paints} paints @param {number} radius @param {boolean} duct @param {string} [handedness]
 * @returns {{group: THREE.Group, rotor: THREE.Group}}
 */
export function thruster(paints, radius, duct, handedness = "right") {
  const group = new THREE.Group();
  const around = paints.fine ? 32 : 14;
  if (duct) {
    const [inner, outer, half] = [0.94 * radius, 1.12 * radius, 0.36 * radius];
    put(group, turned([[half, inner], [half * 1.15, (inner + outer) / 2], [half, outer], [-half, 1.04 * radius], [-half, inner], [half, inner]], around), paints.plain(COLOURS.ring, { rough: 0.5, both: true }));
    const strut = new THREE.BoxGeometry(0.1 * radius, 1.96 * radius, 0.1 * radius).translate(-0.3 * radius, 0, 0);
    put(group, strut, paints.plain(COLOURS.ring));
    put(group, strut.clone().rotateX(Math.PI / 2), paints.plain(COLOURS.ring));
  }
  put(group, turned([[-0.75 * radius, 0.001], [-0.72 * radius, 0.2 * radius], [-0.1 * radius, 0.26 * radius], [0, 0.26 * radius]], around), paints.plain(COLOURS.dark, { rough: 0.4 }));
  const rotor = new THREE.Group();
  put(rotor, turned([[0, 0.26 * radius], [0.2 * radius, 0.22 * radius], [0.36 * radius, 0.001]], around), paints.plain(COLOURS.metal, { rough: 0.3, metal: 0.4 }));
  for (let k = 0; k < 3; k += 1) rotor.add(blade(paints, radius, (2 * Math.PI * k) / 3, handedness === "left" ? -1 : 1));
  group.add(rotor);
  return { group, rotor };
}

/** @param {Paints} paints @param {number} radius @param {number} angle @param {number} hand */
function blade(paints, radius, angle, hand) {
  const shape = new THREE.Shape();
  shape.moveTo(-0.1 * radius, 0.2 * radius).quadraticCurveTo(-0.34 * radius, 0.6 * radius, -0.16 * radius, 0.9 * radius)
    .lineTo(0.2 * radius, 0.9 * radius).quadraticCurveTo(0.34 * radius, 0.5 * radius, 0.1 * radius, 0.2 * radius);
  const geometry = new THREE.ShapeGeometry(shape, 4).rotateY(Math.PI / 2 - hand * 0.6);
  const mesh = new THREE.Mesh(geometry, paints.plain(COLOURS.blade, { rough: 0.35, both: true }));
  mesh.rotation.x = angle;
  return mesh;
}

/**
 * A fin that turns about its hinge. On the hull's axis it stands out to both sides.
 * @param {Paints} paints @param {Actuator} fin @param {number} hull its radius there
 */
export function makeFin(paints, fin, hull) {
  const hinge = new THREE.Vector3(...(fin.axis ?? [0, 1, 0])).normalize();
  const ahead = new THREE.Vector3(...(fin.chord ?? [1, 0, 0]));
  ahead.addScaledVector(hinge, -ahead.dot(hinge)).normalize();
  const place = new THREE.Vector3(...fin.p);
  const aside = place.dot(hinge);
  const central = Math.abs(aside) < 0.5 * hull;
  const reach = Math.min(Math.max(fin.span ?? 1.4 * hull, 0.6 * hull), 4 * hull);
  const chord = 0.6 * Math.min(reach, 1.8 * hull) + 0.02;
  const group = new THREE.Group();
  group.position.copy(place);
  const turning = new THREE.Group();
  group.add(turning);
  for (const side of central ? [1, -1] : [Math.sign(aside) || 1]) {
    const root = central ? 0.75 * hull : -0.1 * reach;
    const tip = central ? Math.max(0.5 * reach, 0.75 * hull + 0.4 * reach) : 0.9 * reach;
    const shape = new THREE.Shape();
    shape.moveTo(0.45 * chord, root).lineTo(-0.55 * chord, root).lineTo(-0.5 * chord, tip).lineTo(0.05 * chord, tip);
    const thick = 0.09 * chord;
    const geometry = new THREE.ExtrudeGeometry(shape, { depth: thick, bevelEnabled: true, bevelThickness: 0.3 * thick, bevelSize: 0.3 * thick, bevelSegments: 1 }).translate(0, 0, -thick / 2);
    const outwards = hinge.clone().multiplyScalar(side);
    geometry.applyMatrix4(new THREE.Matrix4().makeBasis(ahead, outwards, new THREE.Vector3().crossVectors(ahead, outwards)));
    put(turning, geometry, paints.plain(COLOURS.dark, { rough: 0.5, both: true }));
  }
  return { group, turning, hinge };
}

/** A torpedo: round nose, straight body, tail that tapers. @param {Paints} paints @param {number} radius @param {number} length whole @param {string} colour @param {boolean} tapered */
export function torpedo(paints, radius, length, colour, tapered) {
  const group = new THREE.Group();
  const around = paints.fine ? 48 : 20;
  const [bow, stern] = [length / 2, -length / 2];
  const nose = /** @type {[number, number][]} */ ([]);
  for (let k = 0; k <= 10; k += 1) {
    const a = (k / 10) * (Math.PI / 2);
    nose.push([bow - 1.3 * radius + 1.3 * radius * Math.cos(a), Math.max(1e-3, radius * Math.sin(a))]);
  }
  put(group, turned(nose, around), paints.plain(COLOURS.dark, { rough: 0.35 }));
  const tail = tapered ? stern + Math.min(3.2 * radius, 0.3 * length) : stern + 0.3 * radius;
  const belly = bow - 1.3 * radius;
  put(group, turned([[belly, radius], [tail, radius]], around), paints.plain(colour, { rough: 0.4 }));
  for (const part of [0.18, 0.82]) {
    const x = belly + (tail - belly) * part;
    put(group, turned([[x + 0.08 * radius, radius * 1.012], [x - 0.08 * radius, radius * 1.012]], around), paints.plain(COLOURS.dark, { rough: 0.5, both: true }));
  }
  const end = tapered ? 0.25 * radius : 0.9 * radius;
  put(group, turned([[tail, radius], [tail - 0.4 * (tail - stern), 0.86 * radius], [stern, end], [stern, 1e-3]], around), paints.plain(tapered ? colour : COLOURS.dark, { rough: 0.4 }));
  if (tapered) put(group, softBox([0.5 * radius, 0.12 * radius, 0.9 * radius], 0.04 * radius, 1), paints.plain(COLOURS.dark), [0.12 * length, 0, -1.3 * radius]);
  return group;
}

/**
 * An open frame ROV in a box: side plates with windows, floats on top, a tube with a dome, a battery tube, skids, lamps.
 * @param {Paints} paints @param {Vec3} size
 */
export function openFrame(paints, [x, y, z]) {
  const group = new THREE.Group();
  const thick = Math.max(0.008, 0.03 * y);
  const plate = new THREE.Shape();
  const [l, t] = [x / 2, z / 2];
  plate.moveTo(-l, -t * 0.5).lineTo(-l * 0.9, -t).lineTo(l * 0.9, -t).lineTo(l, -t * 0.5).lineTo(l, t * 0.75).lineTo(l * 0.88, t).lineTo(-l * 0.88, t).lineTo(-l, t * 0.75);
  for (const [from, to] of [[-0.82, -0.3], [-0.2, 0.2], [0.3, 0.82]]) {
    const hole = new THREE.Path();
    hole.moveTo(from * l, -0.1 * t).lineTo(to * l, -0.1 * t).lineTo(to * l, 0.72 * t).lineTo(from * l, 0.72 * t);
    plate.holes.push(hole);
  }
  const sheet = sidePlate(plate, thick);
  const dark = paints.plain(COLOURS.frame, { rough: 0.6, both: true });
  for (const s of [-1, 1]) put(group, sheet, dark, [0, s * (y / 2 - thick / 2), 0]);
  put(group, softBox([0.92 * x, y - 2 * thick, 0.05 * z], 0.01 * z, 1), dark, [0, 0, 0.56 * t]);
  for (const end of [-0.86, 0.86]) put(group, softBox([0.05 * x, y - 2 * thick, 0.1 * z], 0.01 * z, 1), dark, [end * l, 0, -0.3 * t]);
  const blue = paints.plain(COLOURS.float, { rough: 0.55 });
  for (const s of [-1, 1]) put(group, softBox([0.44 * x * 2, 0.36 * y, 0.27 * z], 0.06 * z, 3), blue, [0, s * 0.27 * y, -0.8 * t]);
  put(group, softBox([0.4 * x, 0.16 * y, 0.2 * z], 0.05 * z, 2), blue, [-0.1 * x, 0, -0.86 * t]);
  const around = paints.fine ? 36 : 16;
  const tube = 0.24 * Math.min(y, 1.2 * z);
  put(group, turned([[-0.36 * x, 1e-3], [-0.36 * x, tube], [0.3 * x, tube], [0.3 * x, 1e-3]], around), paints.plain(COLOURS.tube, { rough: 0.25 }), [0, 0, -0.08 * t]);
  for (const end of [-0.36, 0.3]) put(group, turned([[end * x + 0.02 * x, 1.1 * tube], [end * x - 0.02 * x, 1.1 * tube]], around), paints.plain(COLOURS.dark, { both: true, rough: 0.4 }), [0, 0, -0.08 * t]);
  const dome = new THREE.SphereGeometry(0.98 * tube, around, around / 2, 0, Math.PI * 2, 0, Math.PI / 2).rotateZ(-Math.PI / 2);
  put(group, new THREE.SphereGeometry(0.42 * tube, 14, 10), paints.plain(COLOURS.dark, { rough: 0.2 }), [0.36 * x, 0, -0.08 * t]);
  put(group, dome, paints.plain(COLOURS.glass, { rough: 0.05, opacity: 0.35 }), [0.31 * x, 0, -0.08 * t]);
  put(group, turned([[-0.3 * x, 1e-3], [-0.3 * x, 0.7 * tube], [0.3 * x, 0.7 * tube], [0.3 * x, 1e-3]], around), paints.plain(COLOURS.metal, { rough: 0.35, metal: 0.3 }), [0, 0, 0.42 * t]);
  for (const s of [-1, 1]) {
    const lamp = turned([[-0.05 * x, 1e-3], [-0.05 * x, 0.07 * z], [0.04 * x, 0.08 * z]], around / 2);
    put(group, lamp, paints.plain(COLOURS.dark), [0.46 * x, s * 0.33 * y, 0.05 * t]);
    put(group, new THREE.CircleGeometry(0.075 * z, 16).rotateY(Math.PI / 2), paints.plain(COLOURS.lamp, { glow: "#ffe9a8" }), [0.502 * x, s * 0.33 * y, 0.05 * t]);
  }
  return group;
}

/** A plate in the plane of x and z. @param {THREE.Shape} outline @param {number} thick */
function sidePlate(outline, thick) {
  const geometry = new THREE.ExtrudeGeometry(outline, { depth: thick, bevelEnabled: false });
  // Its second axis becomes z (down), its depth -y.
  return geometry.rotateX(Math.PI / 2).translate(0, thick / 2, 0);
}

/** A float of a surface vessel, its bow ahead. @param {Paints} paints @param {Vec3} size */
export function pontoon(paints, [x, y, z]) {
  const outline = new THREE.Shape();
  outline.moveTo(-x / 2, -y / 2).lineTo(0.3 * x, -y / 2).quadraticCurveTo(0.46 * x, -0.4 * y, x / 2, 0).quadraticCurveTo(0.46 * x, 0.4 * y, 0.3 * x, y / 2).lineTo(-x / 2, y / 2);
  const round = 0.12 * Math.min(y, z);
  const geometry = new THREE.ExtrudeGeometry(outline, { depth: z - 2 * round, bevelEnabled: true, bevelThickness: round, bevelSize: round, bevelOffset: -round, bevelSegments: 2 }).translate(0, 0, -z / 2 + round);
  const group = new THREE.Group();
  put(group, geometry, paints.plain(COLOURS.orange, { rough: 0.5 }));
  put(group, new THREE.BoxGeometry(0.7 * x, 0.5 * y, 0.04 * z), paints.plain(COLOURS.dark), [-0.08 * x, 0, -0.51 * z]);
  return group;
}

/** Shapes of instruments outside the hull, by the standard message of their port. @type {Record<string, "transducer" | "janus" | "echosounder" | "antenna">} */
const HOUSINGS = { SonarPing: "transducer", BeaconFix: "transducer", BeaconRange: "transducer", Dvl: "janus", CurrentProfile: "janus", Range: "echosounder", LaserScan: "echosounder", NavSatFix: "antenna" };

/** Return what an instrument looks like, x along its own x; null for what lies inside. @param {Paints} paints @param {Sensor} sensor @param {number} scale about half the vehicle's height */
export function instrument(paints, sensor, scale) {
  const around = paints.fine ? 20 : 10;
  const r = Math.min(0.05, Math.max(0.015, 0.22 * scale));
  const group = new THREE.Group();
  const housing = HOUSINGS[sensor.message ?? ""];
  if (housing === "transducer") {
    put(group, new THREE.CylinderGeometry(0.7 * r, 0.7 * r, 1.6 * r, around).rotateX(Math.PI / 2), paints.plain(COLOURS.dark, { rough: 0.4 }));
    put(group, new THREE.SphereGeometry(0.7 * r, around, around / 2), paints.plain(COLOURS.orange, { rough: 0.4 }), [0, 0, -0.8 * r]);
  } else if (housing === "janus") {
    put(group, new THREE.CylinderGeometry(r, r, 0.9 * r, around).rotateX(Math.PI / 2), paints.plain(COLOURS.metal, { rough: 0.4, metal: 0.3 }));
    for (let k = 0; k < 4; k += 1) put(group, new THREE.SphereGeometry(0.3 * r, 10, 8), paints.plain(COLOURS.orange), [0.5 * r * Math.cos(k * Math.PI / 2 + 0.785), 0.5 * r * Math.sin(k * Math.PI / 2 + 0.785), 0.42 * r]);
  } else if (housing === "echosounder") {
    put(group, new THREE.CylinderGeometry(0.55 * r, 0.55 * r, 1.1 * r, around).rotateZ(Math.PI / 2), paints.plain(COLOURS.metal, { rough: 0.4 }));
  } else if (housing === "antenna") {
    put(group, new THREE.SphereGeometry(0.6 * r, around, around / 2), paints.plain(COLOURS.white, { rough: 0.4 }));
  } else {
    return null;
  }
  return group;
}
