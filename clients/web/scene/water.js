// Light in water: Beer-Lambert for each colour in place of three's fog of one colour, the veil behind all things, and what lies above the surface.
import * as THREE from "three";
/** @typedef {import("../types").Water} Water */

/** Shared by all materials under water. Colours are as they are shown (sRGB), as three puts fog after its conversion. */
export const medium = {
  /** Of light along the way, 1/m. */
  waterAttenuation: { value: new THREE.Vector3(0.3, 0.08, 0.06) },
  /** Of daylight downwards, 1/m. */
  waterFading: { value: new THREE.Vector3(0.05, 0.02, 0.015) },
  waterLevel: { value: new THREE.Vector3(0.04, 0.3, 0.4) },
  waterUp: { value: new THREE.Vector3(0.3, 0.62, 0.7) },
  waterDown: { value: new THREE.Vector3(0.01, 0.09, 0.15) },
  waterTime: { value: 0 },
  waterSurface: { value: 0 },
};

const COMMON = `
  uniform vec3 waterAttenuation, waterFading, waterLevel, waterUp, waterDown;
  uniform float waterTime, waterSurface;
  vec3 veil(vec3 way) {
    return way.y > 0.0 ? mix(waterLevel, waterUp, smoothstep(0.0, 1.0, way.y)) : mix(waterLevel, waterDown, smoothstep(0.0, 0.9, -way.y));
  }
  vec3 sky(vec3 way) {
    return mix(vec3(0.80, 0.88, 0.93), vec3(0.36, 0.60, 0.84), smoothstep(-0.05, 0.7, way.y));
  }
`;

/** Turn three's fog into water. Once, before the first material is compiled. */
export function flood() {
  THREE.ShaderChunk.fog_pars_vertex = "#ifdef USE_FOG\n varying vec3 vFogRay;\n#endif";
  THREE.ShaderChunk.fog_vertex = "#ifdef USE_FOG\n vFogRay = mvPosition.xyz * mat3(viewMatrix);\n#endif";
  THREE.ShaderChunk.fog_pars_fragment = `#ifdef USE_FOG
    varying vec3 vFogRay;
    ${COMMON}
    float caustic(vec2 p) {
      float bright = 0.0;
      for (int i = 0; i < 3; i += 1) {
        float k = float(i);
        p += vec2(sin(p.y * 1.7 + waterTime * (0.7 + 0.2 * k)), cos(p.x * 1.5 - waterTime * (0.6 + 0.15 * k))) * 0.55;
        bright += 1.0 / (0.35 + 6.0 * abs(sin(p.x * 1.3 + k) * sin(p.y * 1.3 - k)));
        p *= 1.4;
      }
      return bright * 0.12;
    }
  #endif`;
  THREE.ShaderChunk.fog_fragment = `#ifdef USE_FOG
    float reach = max(length(vFogRay), 1e-4);
    vec3 way = vFogRay / reach;
    float eye = cameraPosition.y - waterSurface, there = eye + vFogRay.y;
    #ifdef CAUSTICS
      if (there < 0.0 && there > -12.0) gl_FragColor.rgb *= 1.0 + (caustic((cameraPosition + vFogRay).xz * 1.1) - 0.12) * exp(0.28 * there);
    #endif
    gl_FragColor.rgb *= clamp(exp(waterFading * (min(there, 0.0) - min(eye, 0.0))), 0.25, 1.6);
    float wet = eye < 0.0 && there < 0.0 ? 1.0 : (eye >= 0.0 && there >= 0.0 ? 0.0 : max(-eye, -there) / max(abs(vFogRay.y), 1e-4));
    vec3 left = exp(-waterAttenuation * reach * wet);
    gl_FragColor.rgb = gl_FragColor.rgb * left + veil(way) * (1.0 - left);
  #endif`;
}

/**
 * A material that stands in the water.
 * @template {THREE.Material} M
 * @param {M} material @param {{caustics?: boolean}} [how]
 * @returns {M}
 */
export function wet(material, { caustics = false } = {}) {
  if (caustics) material.defines = { ...material.defines, CAUSTICS: "" };
  const before = material.onBeforeCompile.bind(material);
  material.onBeforeCompile = (shader, renderer) => {
    before(shader, renderer);
    Object.assign(shader.uniforms, medium);
  };
  return material;
}

/** What is seen where there is nothing: veil under water, sky above. */
export function makeDome() {
  const material = new THREE.ShaderMaterial({
    uniforms: medium,
    side: THREE.BackSide,
    depthWrite: false,
    depthTest: false,
    fog: false,
    vertexShader: "varying vec3 vWay; void main() { vWay = position; gl_Position = projectionMatrix * vec4(mat3(modelViewMatrix) * position, 1.0); }",
    fragmentShader: `${COMMON}
      varying vec3 vWay;
      void main() {
        vec3 way = normalize(vWay);
        bool above = cameraPosition.y > waterSurface;
        gl_FragColor = vec4(above && way.y > -0.003 ? sky(way) : veil(way), 1.0);
      }`,
  });
  const dome = new THREE.Mesh(new THREE.SphereGeometry(10, 24, 16), material);
  dome.frustumCulled = false;
  dome.renderOrder = -10;
  return dome;
}

export const SHARED_GLSL = COMMON;

/** From linear light to what a screen is told (sRGB's curve is about that power). */
const VEIL_GAMMA = 1 / 2.2;

/** How far light must reach for views from outside: they thin the water where a diver would see nothing. */
const OUTSIDE_GREEN = 0.05;

/**
 * Set the water's colours: what the scenario says, thinner for views from outside.
 * @param {Water} water @param {{depth: number, outside: boolean, clear: boolean}} eye
 */
export function look(water, { depth, outside, clear }) {
  const [r, g, b] = water.attenuation;
  const thin = clear ? 0.02 : outside ? Math.min(1, OUTSIDE_GREEN / Math.max(g, 1e-3)) : 1;
  medium.waterAttenuation.value.set(r * thin, g * thin, b * thin);
  const fading = clear ? 0 : 0.25 * thin;
  medium.waterFading.value.set(Math.min(r, 0.4) * fading, Math.min(g, 0.3) * fading, Math.min(b, 0.3) * fading);
  medium.waterSurface.value = water.surface_level;
  const veil = new THREE.Vector3(...water.colour);
  veil.divideScalar(Math.max(veil.x, veil.y, veil.z, 1e-3));
  // The colour is of light; on the screen less light is shown brighter, or green water would be as neon.
  for (const axis of /** @type {const} */ (["x", "y", "z"])) veil[axis] = veil[axis] ** VEIL_GAMMA;
  const light = 0.16 + 0.42 * Math.exp(-0.035 * Math.max(0, depth));
  medium.waterLevel.value.copy(veil).multiplyScalar(light);
  medium.waterUp.value.copy(veil).lerp(new THREE.Vector3(0.75, 1, 1), 0.28).multiplyScalar(Math.min(1, light * 1.7));
  medium.waterDown.value.copy(veil).multiplyScalar(light * 0.28);
}
