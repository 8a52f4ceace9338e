// Few drawings for many parts: what does not move within a vehicle becomes one geometry for each paint.
import * as THREE from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";

/** Parts that move say so by this key of their `userData`, and hold together all that is below them. */
export const MOVES = "moves";

/**
 * A group that looks the same, with one mesh for each paint of what stands still, and of each moving part.
 * @param {THREE.Object3D} group
 * @returns {THREE.Group}
 */
export function compact(group) {
  group.updateMatrixWorld(true);
  const out = new THREE.Group();
  const inverse = group.matrixWorld.clone().invert();
  /** @type {Map<THREE.Material, THREE.BufferGeometry[]>} */
  const still = new Map();
  gather(group, inverse, still, out);
  for (const mesh of meshes(still)) out.add(mesh);
  return out;
}

/** @param {THREE.Object3D} node @param {THREE.Matrix4} inverse @param {Map<THREE.Material, THREE.BufferGeometry[]>} still @param {THREE.Group} out */
function gather(node, inverse, still, out) {
  for (const child of node.children) {
    if (child.userData[MOVES]) {
      const holder = new THREE.Group();
      new THREE.Matrix4().multiplyMatrices(inverse, node.matrixWorld).decompose(holder.position, holder.quaternion, holder.scale);
      const part = compact(child);
      part.userData = child.userData;
      part.position.copy(child.position);
      part.quaternion.copy(child.quaternion);
      holder.add(part);
      out.add(holder);
      continue;
    }
    if (child instanceof THREE.Mesh) {
      const list = still.get(child.material) ?? [];
      list.push(plain(child.geometry, new THREE.Matrix4().multiplyMatrices(inverse, child.matrixWorld)));
      still.set(child.material, list);
    }
    gather(child, inverse, still, out);
  }
}

/** @param {THREE.BufferGeometry} geometry @param {THREE.Matrix4} matrix */
function plain(geometry, matrix) {
  const copy = geometry.index ? geometry.toNonIndexed() : geometry.clone();
  for (const name of Object.keys(copy.attributes)) if (name !== "position" && name !== "normal") copy.deleteAttribute(name);
  copy.clearGroups();
  geometry.dispose();
  return copy.applyMatrix4(matrix);
}

/** @param {Map<THREE.Material, THREE.BufferGeometry[]>} parts */
function meshes(parts) {
  return [...parts].map(([material, list]) => {
    const mesh = new THREE.Mesh(mergeGeometries(list), material);
    for (const geometry of list) geometry.dispose();
    return mesh;
  });
}
