// What sensors send out: cones of DVL and altimeter, sectors of sonars, to where they last hit something; pings that grow as fast as sound.
import * as THREE from "three";
import { turn } from "./stage.js";
import { wet } from "./water.js";
/** @typedef {import("../types").Sensor} Sensor @typedef {import("../types").Sample} Sample @typedef {import("../types").Beacon} Beacon */

/** Colours of beams by the standard message of their port. @type {Record<string, string>} */
const COLOUR = { Dvl: "#ffb14d", CurrentProfile: "#c9a2ff", Range: "#7dffb0", SonarPing: "#67d8ff", SonarImage: "#67d8ff", SideScan: "#67d8ff", SonarProfile: "#67d8ff", Bathymetry: "#67d8ff", LaserScan: "#ff7f9f", BeaconFix: "#ffe27a", BeaconRange: "#ffe27a" };

/** @param {string} colour @param {number} opacity */
function light(colour, opacity) {
  return wet(new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity, side: THREE.DoubleSide, depthWrite: false, blending: THREE.AdditiveBlending }));
}

/** Beams of one sensor, in B. */
export class Beams {
  /** @param {Sensor} sensor */
  constructor(sensor) {
    this.sensor = sensor;
    this.group = new THREE.Group();
    this.group.position.set(...sensor.p);
    this.group.quaternion.copy(turn(sensor.q));
    const colour = COLOUR[sensor.message ?? ""] ?? "#9fdcff";
    /** @type {THREE.Mesh[]} */
    this.cones = [];
    for (const beam of sensor.beams ?? []) {
      const half = Math.max(0.006, Math.tan(0.5 * (beam.width ?? 0)));
      // One metre long, from the origin along x; scaled to its reach.
      const geometry = new THREE.ConeGeometry(half, 1, 20, 1, true).translate(0, -0.5, 0).rotateZ(Math.PI / 2);
      const cone = new THREE.Mesh(geometry, light(colour, 0.1));
      cone.quaternion.setFromUnitVectors(new THREE.Vector3(1, 0, 0), new THREE.Vector3(...beam.direction).normalize());
      cone.scale.setScalar(Math.min(beam.far || 3, 3));
      this.cones.push(cone);
      this.group.add(cone);
    }
    /** @type {THREE.Mesh | null} */
    this.head = null;
    if (sensor.fan) {
      const { far, horizontal, sector } = sensor.fan;
      const whole = sector[1] - sector[0] || 2 * Math.PI;
      const ground = new THREE.Mesh(new THREE.CircleGeometry(far, 48, sector[0], Math.min(whole, 2 * Math.PI)), light(colour, 0.025));
      this.head = new THREE.Mesh(new THREE.CircleGeometry(far, 8, -0.5 * Math.max(horizontal, 0.03), Math.max(horizontal, 0.03)), light(colour, 0.3));
      this.group.add(ground, this.head);
    }
  }

  /** Whether its samples move something. */
  get listens() {
    return this.head !== null || this.cones.length > 0;
  }

  /** @param {Sample} sample */
  take(sample) {
    const { value } = sample;
    if (this.head && typeof value.head_angle === "number") {
      this.head.rotation.z = value.head_angle;
      if (this.sensor.fan && typeof value.range === "number") this.head.scale.setScalar(value.range / this.sensor.fan.far);
    }
    const ranges = Array.isArray(value.beam_ranges) ? value.beam_ranges : Array.isArray(value.ranges) ? value.ranges : [value.range];
    const locks = Array.isArray(value.beam_locks) ? value.beam_locks : [];
    this.cones.forEach((cone, k) => {
      const range = ranges[k];
      const hit = sample.valid && typeof range === "number" && range > 0 && locks[k] !== false;
      cone.scale.setScalar(hit ? range : Math.min((this.sensor.beams ?? [])[k].far || 3, 3));
      /** @type {THREE.MeshBasicMaterial} */ (cone.material).opacity = hit ? 0.08 : 0.03;
    });
  }

  dispose() {
    this.group.removeFromParent();
    this.group.traverse((part) => {
      if (part instanceof THREE.Mesh) {
        part.geometry.dispose();
        part.material.dispose();
      }
    });
  }
}

const RING = new THREE.RingGeometry(0.985, 1, 72).rotateX(0);

/** Acoustic beacons in N, and rings that show how far a ping has come. */
export class Acoustics {
  /** @param {Beacon[]} beacons @param {number} soundSpeed m/s */
  constructor(beacons, soundSpeed) {
    this.group = new THREE.Group();
    this.speed = soundSpeed;
    this.beacons = beacons;
    /** @type {{mesh: THREE.Mesh, told: number, born: number, far: number}[]} */
    this.rings = [];
    this.markers = beacons.map((beacon) => {
      const marker = new THREE.Group();
      const body = new THREE.Mesh(new THREE.CylinderGeometry(0.09, 0.09, 0.4, 14).rotateX(Math.PI / 2), wet(new THREE.MeshLambertMaterial({ color: "#f07d1c" })));
      const head = new THREE.Mesh(new THREE.SphereGeometry(0.1, 14, 10), wet(new THREE.MeshLambertMaterial({ color: "#14181c" })));
      head.position.z = -0.25;
      if (!beacon.body) marker.add(body, head);
      marker.position.set(...beacon.p);
      this.group.add(marker);
      return marker;
    });
  }

  /**
   * A ping leaves a place.
   * @param {THREE.Vector3} place N @param {number} now simulation time, s @param {number} born when it leaves, s @param {number} far m @param {string} [colour]
   */
  ping(place, now, born, far, colour = "#ffe27a") {
    const mesh = new THREE.Mesh(RING, light(colour, 0.5));
    mesh.position.copy(place);
    mesh.scale.setScalar(1e-3);
    this.group.add(mesh);
    mesh.visible = false;
    this.rings.push({ mesh, told: now, born, far });
    if (this.rings.length > 24) this.drop(0);
  }

  /** @param {number} t simulation time, s */
  update(t) {
    for (let k = this.rings.length - 1; k >= 0; k -= 1) {
      const { mesh, told, born, far } = this.rings[k];
      const radius = this.speed * (t - born);
      if (radius > far || t < told) {
        this.drop(k);
        continue;
      }
      mesh.visible = radius >= 0;
      mesh.scale.setScalar(Math.max(0.01, radius));
      /** @type {THREE.MeshBasicMaterial} */ (mesh.material).opacity = 0.5 * (1 - radius / far);
    }
  }

  /** @param {number} k */
  drop(k) {
    const [{ mesh }] = this.rings.splice(k, 1);
    mesh.removeFromParent();
    /** @type {THREE.Material} */ (mesh.material).dispose();
  }
}
