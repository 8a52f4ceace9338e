// Seabed and structures, out of the shapes that the physics collides with.
import * as THREE from "three";
import { loadLooks } from "./looks.js";
import { turn } from "./stage.js";
/** @typedef {import("../types").Shape} Shape @typedef {import("../types").Solid} Solid @typedef {import("../types").World["meshes"]} Meshes @typedef {import("./materials.js").Paints} Paints */

/** Of meshes: those that are being loaded, and those that are loaded after them. @typedef {{coarse: Promise<void>[], fine: (() => Promise<void>)[]}} Loads */

const FLAT_M = 1200;

/** Triangles of the server: u32 vertices, u32 triangles, f32 positions, u32 indices. @param {ArrayBuffer} data */
export function triangles(data) {
  const [vertices, count] = new Uint32Array(data, 0, 2);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(data, 8, 3 * vertices), 3));
  geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(data, 8 + 12 * vertices, 3 * count), 1));
  geometry.computeVertexNormals();
  return geometry;
}

/** Geometry of a shape in its own frame; cylinders and capsules lie along x. Null for meshes, which come later. @param {Shape} shape @param {boolean} fine */
export function geometryOf(shape, fine) {
  const radius = shape.radius ?? 0.1;
  const length = shape.length ?? 0.1;
  const around = fine ? 40 : 16;
  switch (shape.kind) {
    case "box": return new THREE.BoxGeometry(...(shape.size ?? [0.1, 0.1, 0.1]));
    case "sphere": return new THREE.SphereGeometry(radius, around, around / 2);
    case "cylinder": return new THREE.CylinderGeometry(radius, radius, length, around).rotateZ(Math.PI / 2);
    case "capsule": return new THREE.CapsuleGeometry(radius, length, around / 4, around).rotateZ(Math.PI / 2);
    default: return null;
  }
}

/** Texture coordinates by place, one unit a repeat, seen along the axis that the surface faces. @param {THREE.BufferGeometry} geometry @param {number} size */
function wrap(geometry, size) {
  const points = geometry.getAttribute("position");
  const normals = geometry.getAttribute("normal");
  const uv = new Float32Array(2 * points.count);
  for (let i = 0; i < points.count; i += 1) {
    const p = [points.getX(i), points.getY(i), points.getZ(i)];
    const n = [Math.abs(normals.getX(i)), Math.abs(normals.getY(i)), Math.abs(normals.getZ(i))];
    const axis = n.indexOf(Math.max(...n));
    uv[2 * i] = p[axis === 0 ? 1 : 0] / size;
    uv[2 * i + 1] = p[axis === 2 ? 1 : 2] / size;
  }
  geometry.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
}

/**
 * What never moves, in N. Large meshes are shown by their coarse forms first; then one after another comes, with a picture between.
 * @param {Solid[]} solids @param {Meshes} meshes @param {Paints} paints @param {import("./craft.js").Store} store
 */
export function makeSolids(solids, meshes, paints, store) {
  const group = new THREE.Group();
  /** @type {Loads} */
  const loads = { coarse: [], fine: [] };
  for (const solid of solids) {
    if (solid.looks) {
      loadLooks(solid.looks, store).then((looks) => group.add(looks), (/** @type {Error} */ error) => {
        store.failed(`looks of ${solid.name}: ${error.message}`);
        /** @type {Loads} */
        const late = { coarse: [], fine: [] };
        addShapes(group, solid, meshes, paints, store, late);
        void refine(late);
      });
    } else {
      addShapes(group, solid, meshes, paints, store, loads);
    }
  }
  void refine(loads);
  return group;
}

/** Load what is fine once all that is coarse is there. @param {Loads} loads */
async function refine({ coarse, fine }) {
  await Promise.all(coarse);
  for (const load of fine) {
    await load();
    await new Promise((resolve) => setTimeout(resolve, 0));
  }
}

/**
 * @param {THREE.Group} group @param {Solid} solid @param {Meshes} meshes @param {Paints} paints @param {import("./craft.js").Store} store
 * @param {Loads} loads gets what is under way, and what is to come
 */
function addShapes(group, solid, meshes, paints, store, loads) {
  for (const shape of solid.shapes) {
    const look = paints.of(shape.material ?? "default");
    const place = (/** @type {THREE.BufferGeometry} */ geometry) => {
      const mesh = new THREE.Mesh(geometry, look.material);
      mesh.name = solid.name;
      mesh.position.set(...(shape.p ?? [0, 0, 0]));
      mesh.quaternion.copy(turn(shape.q ?? [1, 0, 0, 0]));
      group.add(mesh);
      return mesh;
    };
    const load = (/** @type {string} */ hash) => store.mesh(hash).then((data) => {
      const geometry = triangles(data);
      wrap(geometry, look.size);
      return place(geometry);
    });
    const failed = (/** @type {Error} */ error) => store.failed(`${solid.name}: ${error.message}`);
    const hash = shape.mesh ?? "";
    const rough = meshes[hash]?.coarse;
    if (shape.kind === "plane") {
      place(ground(look.size));
    } else if (shape.kind === "mesh" && rough) {
      /** @type {THREE.Mesh | null} */
      let shown = null;
      loads.coarse.push(load(rough).then((mesh) => { shown = mesh; }, failed));
      loads.fine.push(() => load(hash).then(() => {
        shown?.removeFromParent();
        shown?.geometry.dispose();
      }, failed));
    } else if (shape.kind === "mesh") {
      loads.coarse.push(load(hash).then(() => undefined, failed));
    } else {
      const geometry = geometryOf(shape, paints.fine);
      if (!geometry) continue;
      wrap(geometry, look.size);
      place(geometry);
    }
  }
}

/** A plane through z = 0, seen from above (smaller z). @param {number} size of one repeat */
function ground(size) {
  const geometry = new THREE.PlaneGeometry(FLAT_M, FLAT_M, 1, 1).rotateX(Math.PI);
  const points = geometry.getAttribute("position");
  const uv = geometry.getAttribute("uv");
  for (let i = 0; i < points.count; i += 1) uv.setXY(i, points.getX(i) / size, points.getY(i) / size);
  return geometry;
}
