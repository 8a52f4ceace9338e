// The sea's surface: the components that the physics sums, summed again by the graphics card at the same time.
import * as THREE from "three";
import { medium, SHARED_GLSL } from "./water.js";
/** @typedef {import("../types").Water} Water */

/** Components beyond these are left out: a card of the least kind sums 140 x 140 points of so many sixty times a second. */
const MOST = 256;
const EXTENT_M = 160;

/** A patch of sea that follows the camera. */
export class Surface {
  /** @param {Water} water @param {boolean} fine */
  constructor(water, fine) {
    const count = Math.min(water.waves.length, MOST);
    this.waves = water.waves.slice(0, count);
    this.level = water.surface_level;
    const data = new Float32Array(8 * Math.max(1, count));
    this.waves.forEach(([amplitude, kx, ky, omega, phase], i) => {
      data.set([kx, ky, omega, phase], 4 * i);
      data.set([amplitude, 0, 0, 0], 4 * (i + Math.max(1, count)));
    });
    const table = new THREE.DataTexture(data, Math.max(1, count), 2, THREE.RGBAFormat, THREE.FloatType);
    table.needsUpdate = true;
    this.table = table;
    const cells = count === 0 ? 2 : fine ? 160 : 48;
    this.uniforms = { ...medium, waves: { value: table }, t: { value: 0 }, shift: { value: new THREE.Vector2() }, size: { value: EXTENT_M }, opacity: { value: 1 } };
    const material = new THREE.ShaderMaterial({
      uniforms: this.uniforms,
      transparent: true,
      side: THREE.DoubleSide,
      depthWrite: false,
      defines: { WAVES: count },
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
    });
    this.mesh = new THREE.Mesh(grid(cells), material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 5;
  }

  /** @param {THREE.Vector3} eye in the renderer's axes @param {number} t s */
  update(eye, t) {
    this.uniforms.t.value = t;
    this.uniforms.shift.value.set(Math.round(eye.x), Math.round(eye.z));
    this.uniforms.size.value = EXTENT_M * Math.max(1, Math.abs(eye.y) / 25);
    this.uniforms.opacity.value = eye.y > 25 ? 0.55 : 1;
  }

  /** Elevation (up, m), as the physics has it. @param {number} north @param {number} east @param {number} t */
  elevation(north, east, t) {
    let sum = this.level;
    for (const [amplitude, kx, ky, omega, phase] of this.waves) sum += amplitude * Math.cos(kx * north + ky * east - omega * t + phase);
    return sum;
  }

  dispose() {
    this.mesh.geometry.dispose();
    /** @type {THREE.Material} */ (this.mesh.material).dispose();
    this.table.dispose();
  }
}

/** Points from -1 to 1, closer together in the middle. @param {number} cells */
function grid(cells) {
  const geometry = new THREE.PlaneGeometry(2, 2, cells, cells);
  const points = geometry.getAttribute("position");
  const spread = (/** @type {number} */ x) => x * (0.15 + 0.85 * x * x) * (cells > 2 ? 1 : 6);
  for (let i = 0; i < points.count; i += 1) points.setXYZ(i, spread(points.getX(i)), spread(points.getY(i)), 0);
  geometry.deleteAttribute("normal");
  geometry.deleteAttribute("uv");
  return geometry;
}

const VERTEX = `
  uniform sampler2D waves; uniform float t, size, waterSurface; uniform vec2 shift;
  varying vec3 vAt; varying vec2 vSlope;
  void main() {
    vec2 at = position.xy * size + shift;
    float north = -at.y, east = at.x, height = 0.0;
    vec2 slope = vec2(0.0);
    for (int i = 0; i < WAVES; i += 1) {
      vec4 wave = texelFetch(waves, ivec2(i, 0), 0);
      float amplitude = texelFetch(waves, ivec2(i, 1), 0).x;
      float angle = mod(wave.x * north + wave.y * east - wave.z * t + wave.w, 6.283185307);
      height += amplitude * cos(angle);
      slope -= amplitude * sin(angle) * vec2(wave.y, -wave.x);
    }
    vSlope = slope;
    vAt = vec3(at.x, waterSurface + height, at.y);
    gl_Position = projectionMatrix * viewMatrix * vec4(vAt, 1.0);
  }`;

const FRAGMENT = `
  ${SHARED_GLSL}
  uniform float opacity;
  varying vec3 vAt; varying vec2 vSlope;
  void main() {
    vec3 ray = vAt - cameraPosition;
    float reach = length(ray);
    vec3 way = ray / reach;
    vec2 p = vAt.xz;
    vec2 ripple = 0.035 * vec2(sin(p.x * 2.3 + p.y * 1.1 + waterTime * 1.6) + sin(p.x * 5.1 - p.y * 3.7 - waterTime * 2.3),
                               cos(p.y * 2.7 - p.x * 1.3 + waterTime * 1.4) + sin(p.y * 4.3 + p.x * 4.9 + waterTime * 2.1)) * exp(-reach * 0.03);
    vec3 up = normalize(vec3(-vSlope.x - ripple.x, 1.0, -vSlope.y - ripple.y));
    if (way.y < 0.0) {
      float fresnel = 0.02 + 0.98 * pow(1.0 - max(0.0, dot(-way, up)), 5.0);
      float glint = pow(max(0.0, dot(reflect(way, up), normalize(vec3(0.4, 0.7, 0.3)))), 160.0);
      gl_FragColor = vec4(mix(waterLevel * 1.1, sky(reflect(way, up)), fresnel) + glint, opacity * mix(0.42, 0.96, fresnel));
    } else {
      // Snell: within 48.6 degrees of the vertical one looks out, beyond it sees the water mirrored.
      float across = dot(way, up);
      float window = smoothstep(0.62, 0.72, across);
      vec3 seen = mix(veil(vec3(way.x, -0.25 * way.y, way.z)) * 1.12, sky(vec3(way.x, 0.6, way.z)), window);
      vec3 left = exp(-waterAttenuation * reach);
      gl_FragColor = vec4(seen * left + veil(way) * (1.0 - left), 1.0);
    }
    float edge = smoothstep(0.75, 1.0, reach / 400.0);
    gl_FragColor.a *= 1.0 - edge;
  }`;
