// What a file of glTF looks like, in place of what the shapes would give; its loader comes only when it is needed.
import * as THREE from "three";
import { turn } from "./stage.js";
import { wet } from "./water.js";
/** @typedef {import("../types").Looks} Looks @typedef {import("./craft.js").Store} Store */

/** @param {Looks} looks @param {Store} store @returns {Promise<THREE.Group>} in B of a vehicle, in N for what stands still */
export async function loadLooks(looks, store) {
  const [{ GLTFLoader }, data] = await Promise.all([import("three/addons/loaders/GLTFLoader.js"), store.looks(looks.sha256)]);
  const model = (await new GLTFLoader().parseAsync(data, "")).scene;
  // Ahead is the file's x.
  model.quaternion.setFromRotationMatrix(new THREE.Matrix4().makeRotationX(looks.up === "z" ? Math.PI : -Math.PI / 2));
  model.scale.setScalar(looks.scale ?? 1);
  model.traverse((part) => {
    if (part instanceof THREE.Mesh && part.material instanceof THREE.Material) wet(part.material);
  });
  const holder = new THREE.Group();
  holder.position.set(...(looks.p ?? [0, 0, 0]));
  holder.quaternion.copy(turn(looks.q ?? [1, 0, 0, 0]));
  holder.add(model);
  return holder;
}
