// The world in three dimensions: built from what the server tells once, moved by frames.
import * as THREE from "three";
import { isNowhere, ownColour } from "../core/frames.js";
import { SOUND } from "../core/modems.js";
import { Aim } from "./aim.js";
import { Acoustics, Beams } from "./beams.js";
import { Craft } from "./craft.js";
import { currentAt, Flow, Touches } from "./flow.js";
import { Labels } from "./labels.js";
import { Paints } from "./materials.js";
import { Motes } from "./motes.js";
import { makeSolids } from "./solids.js";
import { Surface } from "./surface.js";
import { Trail } from "./trails.js";
import { Views } from "./views.js";
import { look, medium } from "./water.js";
/** @typedef {import("../types").World} World @typedef {import("../types").Beacon} Beacon @typedef {import("../core/frames.js").Timeline} Timeline @typedef {import("../core/link.js").Link} Link */

/** @typedef {import("./layers.js").Layer} Layer */

/** Everything of one revision of the world. */
export class WorldScene {
  /**
   * @param {World} world @param {import("./stage.js").Stage} stage @param {Views} views @param {Link} link
   * @param {import("./craft.js").Store} store
   */
  constructor(world, stage, views, link, store) {
    this.world = world;
    this.stage = stage;
    this.views = views;
    this.link = link;
    this.group = new THREE.Group();
    stage.root.add(this.group);
    this.paints = new Paints(stage.fine);
    this.solids = makeSolids([...(world.seabed ? [world.seabed] : []), ...world.structures], world.meshes, this.paints, store);
    this.group.add(this.solids);
    const bodies = [...world.vehicles, ...world.objects];
    /** @type {Map<string, THREE.Group>} */
    const known = new Map();
    this.crafts = bodies.map((body) => new Craft(body, this.paints, store, known));
    this.first = bodies.map((_, i) => world.vehicles.slice(0, i).reduce((sum, vehicle) => sum + (vehicle.actuators?.length ?? 0), 0));
    this.trails = bodies.map((body, i) => new Trail(i, ownColour(body)));
    for (const craft of this.crafts) this.group.add(craft.group);
    for (const trail of this.trails) this.group.add(trail.line);
    this.surface = new Surface(world.water, stage.fine);
    stage.scene.add(this.surface.mesh);
    this.motes = new Motes();
    stage.scene.add(this.motes.points);
    this.flow = new Flow();
    this.acoustics = new Acoustics(world.beacons, world.water.sound_speed);
    this.touches = new Touches();
    this.aim = new Aim();
    this.labels = new Labels(bodies, world.beacons.map((beacon) => beacon.name));
    this.group.add(this.flow.group, this.acoustics.group, this.aim.group);
    /** @type {Beams[]} */
    this.beams = [];
    /** @type {(() => void)[]} */
    this.endings = [];
    this.chosen = -1;
    this.clear = false;
    this.breaks = -1;
    this.t = 0;
    this.floor = floorOf(world);
    stage.root.updateMatrixWorld(true);
    this.ray = new THREE.Raycaster();
    /** How far one sees between two places of the renderer; large meshes hide nothing, they would take too long. @param {THREE.Vector3} from @param {THREE.Vector3} to */
    this.free = (from, to) => {
      const way = to.clone().sub(from);
      this.ray.set(from, way.clone().normalize());
      this.ray.far = way.length();
      const walls = this.solids.children.filter((solid) => solid instanceof THREE.Mesh && solid.geometry.getAttribute("position").count < 2000);
      return this.ray.intersectObjects(walls, false)[0]?.distance ?? way.length() + 1;
    };
  }

  /** Follow another body; its sensors' beams are drawn. @param {number} index @param {Set<Layer>} layers */
  choose(index, layers) {
    for (const end of this.endings) end();
    this.endings = [];
    for (const beam of this.beams) beam.dispose();
    this.beams = [];
    this.chosen = index;
    const craft = this.crafts[index];
    if (!craft) return;
    craft.group.add(this.touches.group);
    for (const sensor of craft.body.sensors ?? []) {
      if (layers.has("contacts") && sensor.message === "Contact") this.endings.push(this.link.subscribe(sensor.path, 10, (sample) => this.touches.take(sample)));
      if (layers.has("acoustics")) this.listen(sensor.path);
      if (!layers.has("beams")) continue;
      const beams = new Beams(sensor);
      if (!beams.listens) continue;
      craft.group.add(beams.group);
      this.beams.push(beams);
      this.endings.push(this.link.subscribe(sensor.path, 15, (sample) => beams.take(sample)));
    }
  }

  /** Draw the pings of a sensor that interrogates beacons: out from the vehicle, and back from the beacon that answers. @param {string} path */
  listen(path) {
    const mine = this.world.beacons.filter((beacon) => beacon.sensor === path);
    if (!mine.length) return;
    this.endings.push(this.link.subscribe(path, 10, (sample) => {
      const craft = this.crafts[this.chosen];
      const beacon = mine.find((candidate) => candidate.name === sample.value.beacon);
      if (!craft || !beacon) return;
      const from = craft.group.position;
      const place = this.placeOf(beacon);
      const far = from.distanceTo(place) * 1.05;
      this.acoustics.ping(from, this.t, this.t, far);
      this.acoustics.ping(place, this.t, this.t + far / this.acoustics.speed + (beacon.delay ?? 0), far);
    }));
  }

  /** The sound of a message leaves a place. @param {number[]} from N @param {number} far m */
  pulse(from, far) {
    this.acoustics.ping(new THREE.Vector3(...from), this.t, this.t, far, SOUND);
  }

  /** @param {Beacon} beacon */
  placeOf(beacon) {
    const place = new THREE.Vector3(...beacon.p);
    const carrier = this.crafts.find((craft) => craft.body.name === beacon.body);
    return carrier ? place.applyQuaternion(carrier.group.quaternion).add(carrier.group.position) : place;
  }

  /** @param {Timeline} timeline @param {number} dt s of wall time @param {Set<Layer>} layers */
  update(timeline, dt, layers) {
    const { poses, achieved, t } = timeline;
    const passed = Math.max(0, Math.min(0.5, t - this.t));
    this.t = t;
    if (timeline.breaks !== this.breaks) {
      this.breaks = timeline.breaks;
      for (const trail of this.trails) trail.clear();
    }
    const bodies = Math.min(this.crafts.length, poses.length / 7);
    for (let k = 0; k < bodies; k += 1) {
      this.crafts[k].update(poses, 7 * k, achieved, this.first[k], passed > 0 ? dt : 0);
      this.crafts[k].light(layers.has("lamps") && k === this.chosen);
      this.trails[k].line.visible = layers.has("trails");
      if (Number.isFinite(poses[7 * k]) && !isNowhere(poses, 7 * k)) this.trails[k].add(poses, 7 * k);
    }
    const { camera } = this.stage;
    const craft = this.crafts[this.chosen];
    if (craft && bodies > this.chosen && craft.group.visible) {
      const level = this.world.water.surface_level;
      const room = { ceiling: level - 0.25, floor: Number.isFinite(this.floor) ? -this.floor + 0.2 : -Infinity };
      if (poses[7 * this.chosen + 2] < 0.3) room.ceiling = Infinity;
      this.views.update(craft.group, poses, 7 * this.chosen, dt, room, this.free);
    }
    // On board one sees what a camera would.
    for (const beams of this.beams) beams.group.visible = this.views.view !== "board";
    medium.waterTime.value = t % 10000;
    look(this.world.water, { depth: -camera.position.y, outside: this.views.view !== "board", clear: this.clear || this.views.view === "top" });
    this.surface.mesh.visible = layers.has("surface") && !(this.views.view === "top" && camera.position.y > 0);
    this.surface.update(camera.position, t);
    this.flow.group.visible = layers.has("current") && craft !== undefined;
    if (this.flow.group.visible) this.flow.update(this.world.water, craft.group.position.toArray(), Math.max(1.2, 2.2 * craft.size.x), passed, this.floor);
    this.motes.points.visible = layers.has("motes") && this.views.view !== "top";
    this.motes.update(currentAt(this.world.water, -camera.position.y), passed, this.stage.canvas.height);
    this.acoustics.group.visible = layers.has("acoustics");
    this.world.beacons.forEach((beacon, k) => this.acoustics.markers[k].position.copy(this.placeOf(beacon)));
    this.acoustics.update(t);
    this.labels.update(this, camera, layers);
  }

  dispose() {
    for (const end of this.endings) end();
    this.group.traverse((part) => {
      if (part instanceof THREE.Mesh || part instanceof THREE.Line) part.geometry.dispose();
    });
    this.group.removeFromParent();
    this.surface.mesh.removeFromParent();
    this.surface.dispose();
    this.motes.dispose();
    this.paints.dispose();
    this.labels.dispose();
  }
}

/** Depth of the bottom where it is flat, its deepest place where it is not; infinite for open water. @param {World} world */
export function floorOf(world) {
  const depths = (world.seabed?.shapes ?? []).map((shape) => {
    if (shape.kind === "plane") return (shape.p ?? [0, 0, 0])[2];
    const mesh = world.meshes[shape.mesh ?? ""];
    return mesh ? mesh.high[2] + (shape.p ?? [0, 0, 0])[2] : -Infinity;
  });
  return depths.length ? Math.max(...depths) : Infinity;
}
