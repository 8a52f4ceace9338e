// What floats in water: specks that go with the current, so that one sees a vehicle move where there is no bottom and no wall.
import * as THREE from "three";
import { medium, SHARED_GLSL } from "./water.js";

const [COUNT, SIDE_M] = [1100, 8];

/** Specks in a cube about the camera; whoever leaves it on one side comes in on the other. */
export class Motes {
  constructor() {
    let seed = 777;
    const places = new Float32Array(3 * COUNT).map(() => {
      seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
      return (seed / 4294967296) * SIDE_M;
    });
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
    this.drift = new THREE.Vector3();
    this.uniforms = { ...medium, drift: { value: this.drift }, tall: { value: 1 } };
    const material = new THREE.ShaderMaterial({ uniforms: this.uniforms, transparent: true, depthWrite: false, vertexShader: VERTEX, fragmentShader: FRAGMENT });
    this.points = new THREE.Points(geometry, material);
    this.points.frustumCulled = false;
    this.points.renderOrder = 3;
  }

  /** @param {import("../types").Vec3} current N, m/s @param {number} dt s of simulation @param {number} height of the picture, px */
  update([north, east, down], dt, height) {
    this.drift.set((this.drift.x + east * dt) % SIDE_M, (this.drift.y - down * dt) % SIDE_M, (this.drift.z - north * dt) % SIDE_M);
    this.uniforms.tall.value = height;
  }

  dispose() {
    this.points.geometry.dispose();
    /** @type {THREE.Material} */ (this.points.material).dispose();
    this.points.removeFromParent();
  }
}

const VERTEX = `
  uniform vec3 drift; uniform float tall, waterSurface;
  varying float vBright;
  void main() {
    vec3 at = cameraPosition + mod(position + drift - cameraPosition, ${SIDE_M.toFixed(1)}) - ${(SIDE_M / 2).toFixed(1)};
    vec4 seen = viewMatrix * vec4(at, 1.0);
    float away = length(seen.xyz);
    // Soft at the edge of the cube, where they come and go; none before the lens, none in the air.
    vBright = smoothstep(${(SIDE_M / 2).toFixed(1)}, ${(SIDE_M / 4).toFixed(2)}, away) * smoothstep(0.25, 0.6, away) * step(at.y, waterSurface - 0.1);
    gl_Position = projectionMatrix * seen;
    gl_PointSize = clamp(0.007 * tall / max(away, 0.1), 1.0, 5.0);
  }`;

const FRAGMENT = `
  ${SHARED_GLSL}
  varying float vBright;
  void main() {
    float round = smoothstep(0.5, 0.15, length(gl_PointCoord - 0.5));
    gl_FragColor = vec4(mix(waterUp, vec3(1.0), 0.45), 0.6 * vBright * round);
  }`;
