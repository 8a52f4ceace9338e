// Paints of things: colours by material, and textures that are made here, so that motion shows over a plain bottom.
import * as THREE from "three";
import { wet } from "./water.js";

/** @typedef {{colour: string, rough: number, metal?: number, pattern?: "sand" | "tiles" | "rock" | "concrete" | "brushed", size?: number}} Look */

/** By the names of the materials that scenarios use, in the colours that cameras see (`scenario.solids.palette`); sizes are of one repeat, m. @type {Record<string, Look>} */
const LOOKS = {
  default: { colour: "#c2a878", rough: 1, pattern: "sand", size: 5 },
  sediment: { colour: "#c2a878", rough: 1, pattern: "sand", size: 5 },
  sand: { colour: "#cdb487", rough: 1, pattern: "sand", size: 5 },
  mud: { colour: "#7d715d", rough: 1, pattern: "sand", size: 7 },
  silt: { colour: "#8d8069", rough: 1, pattern: "sand", size: 7 },
  clay: { colour: "#8a7a66", rough: 1, pattern: "sand", size: 7 },
  gravel: { colour: "#8f8a80", rough: 1, pattern: "rock", size: 3 },
  rock: { colour: "#77736c", rough: 1, pattern: "rock", size: 6 },
  concrete: { colour: "#a9a79f", rough: 0.95, pattern: "concrete", size: 3 },
  tiles: { colour: "#bfe3ea", rough: 0.7, pattern: "tiles", size: 2 },
  steel: { colour: "#8b949b", rough: 0.45, metal: 0.55, pattern: "brushed", size: 1 },
  paint: { colour: "#f0b323", rough: 0.5 },
  rubber: { colour: "#23272b", rough: 0.9 },
  zinc: { colour: "#ccd2d4", rough: 0.6, metal: 0.15 },
  rust: { colour: "#9a4a24", rough: 0.95, pattern: "rock", size: 1 },
  wood: { colour: "#8a6642", rough: 0.9, pattern: "brushed", size: 1 },
  plastic: { colour: "#e1b350", rough: 0.5 },
};

/** What paints the parts of a body. @typedef {Pick<Paints, "fine" | "plain">} Painter */

/** Makes materials in one quality, each of them once. */
export class Paints {
  /** @param {boolean} fine */
  constructor(fine) {
    this.fine = fine;
    /** @type {Map<string, THREE.Material>} */
    this.made = new Map();
    /** @type {Map<string, THREE.Texture>} */
    this.textures = new Map();
  }

  /**
   * A plain paint.
   * @param {string | THREE.Color} colour
   * @param {{rough?: number, metal?: number, opacity?: number, glow?: string, map?: THREE.Texture, caustics?: boolean, flat?: boolean, both?: boolean}} [how]
   */
  plain(colour, how = {}) {
    const { rough = 0.6, metal = 0, opacity = 1, glow, map, caustics = this.fine, flat = false, both = false } = how;
    const key = JSON.stringify([new THREE.Color(colour).getHexString(), rough, metal, opacity, glow, map?.uuid, caustics, flat, both]);
    const found = this.made.get(key);
    if (found) return found;
    const shared = {
      color: colour, map: map ?? null, transparent: opacity < 1, opacity, depthWrite: opacity >= 1, flatShading: flat,
      side: both ? THREE.DoubleSide : THREE.FrontSide, ...(glow ? { emissive: new THREE.Color(glow) } : {}),
    };
    const material = this.fine ? new THREE.MeshStandardMaterial({ ...shared, roughness: rough, metalness: metal }) : new THREE.MeshLambertMaterial(shared);
    this.made.set(key, wet(material, { caustics: caustics && this.fine && opacity >= 1 }));
    return material;
  }

  /** The paint of a scenario's material, and the size of one repeat of its pattern. @param {string} name */
  of(name) {
    const look = LOOKS[name] ?? LOOKS[Object.keys(LOOKS).find((key) => name.includes(key)) ?? "concrete"];
    const map = look.pattern ? this.texture(look.pattern) : undefined;
    return { material: this.plain(look.colour, { rough: look.rough, metal: look.metal, map }), size: look.size ?? 1 };
  }

  /** @param {NonNullable<Look["pattern"]>} pattern */
  texture(pattern) {
    const found = this.textures.get(pattern);
    if (found) return found;
    const size = 256;
    const texture = new THREE.DataTexture(texels(pattern, size), size, size, THREE.RGBAFormat);
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    texture.magFilter = THREE.LinearFilter;
    texture.minFilter = THREE.LinearMipmapLinearFilter;
    texture.generateMipmaps = true;
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.anisotropy = this.fine ? 8 : 1;
    texture.needsUpdate = true;
    this.textures.set(pattern, texture);
    return texture;
  }

  dispose() {
    for (const material of this.made.values()) material.dispose();
    for (const texture of this.textures.values()) texture.dispose();
  }
}

/** Paints of a ghost: one, translucent, for all its parts. */
export class GhostPaints {
  /** @param {Paints} paints @param {import("../types").Vec3} colour linear */
  constructor(paints, colour) {
    this.fine = paints.fine;
    this.material = paints.plain(new THREE.Color(...colour), { rough: 0.9, opacity: 0.42, glow: `#${new THREE.Color(...colour).multiplyScalar(0.25).getHexString()}`, caustics: false });
  }

  plain() {
    return this.material;
  }
}

/** Grey levels of a pattern that repeats. @param {NonNullable<Look["pattern"]>} pattern @param {number} size */
function texels(pattern, size) {
  const noise = valueNoise(size);
  const out = new Uint8Array(4 * size * size);
  for (let y = 0; y < size; y += 1) {
    for (let x = 0; x < size; x += 1) {
      const v = shade(pattern, x / size, y / size, noise);
      out.fill(Math.max(0, Math.min(255, Math.round(255 * v))), 4 * (y * size + x), 4 * (y * size + x) + 3);
      out[4 * (y * size + x) + 3] = 255;
    }
  }
  return out;
}

/** @param {string} pattern @param {number} u @param {number} v @param {(u: number, v: number, cells: number) => number} noise */
function shade(pattern, u, v, noise) {
  const turn = 2 * Math.PI;
  const rough = 0.5 * noise(u, v, 8) + 0.3 * noise(u, v, 32) + 0.2 * noise(u, v, 128);
  if (pattern === "tiles") {
    const tile = (/** @type {number} */ w) => (w * 8) % 1;
    const grout = Math.min(tile(u), 1 - tile(u), tile(v), 1 - tile(v)) < 0.035;
    return grout ? 0.55 : 0.9 + 0.08 * (noise(Math.floor(u * 8) / 8, Math.floor(v * 8) / 8, 8) - 0.5) + 0.03 * (rough - 0.5);
  }
  if (pattern === "rock") return 0.45 + 0.55 * Math.abs(2 * noise(u, v, 6) - 1) * (0.6 + 0.4 * rough);
  if (pattern === "concrete") return 0.78 + 0.22 * rough;
  if (pattern === "brushed") return 0.86 + 0.14 * noise(u, 0.3, 128);
  const ripple = Math.sin(turn * (10 * u + 1.1 * noise(u, v, 4) + 0.5 * noise(u, v, 9)));
  return 0.72 + 0.09 * ripple + 0.26 * (rough - 0.4) + (noise(u, v, 128) > 0.86 ? -0.12 : 0);
}

/** Value noise that repeats with the unit square. @param {number} size */
function valueNoise(size) {
  let seed = 12345;
  const table = new Float32Array(size * size).map(() => {
    seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
    return seed / 4294967296;
  });
  return (/** @type {number} */ u, /** @type {number} */ v, /** @type {number} */ cells) => {
    const x = u * cells;
    const y = v * cells;
    const [i, j] = [Math.floor(x), Math.floor(y)];
    const ease = (/** @type {number} */ w) => w * w * (3 - 2 * w);
    const [a, b] = [ease(x - i), ease(y - j)];
    const at = (/** @type {number} */ p, /** @type {number} */ q) => table[((((q % cells) + cells) % cells) * size + (((p % cells) + cells) % cells) + 37 * cells) % table.length];
    return (at(i, j) * (1 - a) + at(i + 1, j) * a) * (1 - b) + (at(i, j + 1) * (1 - a) + at(i + 1, j + 1) * a) * b;
  };
}
