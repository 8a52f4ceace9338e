// The picture: renderer, lights, camera, and the one group that turns N (north, east, down) into the renderer's axes (x east, y up, z south).
import * as THREE from "three";
import { makeDome, flood } from "./water.js";

/** Whether the browser draws in software: then it starts in low quality. @param {WebGLRenderingContext | WebGL2RenderingContext} gl */
export function drawsInSoftware(gl) {
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  return /swiftshader|llvmpipe|softpipe|software|microsoft basic/i.test(name);
}

let flooded = false;

/** Renderer, camera and root of a page. */
export class Stage {
  /**
   * @param {HTMLCanvasElement} canvas @param {"low" | "high" | "auto"} quality
   * @throws {Error} there is no WebGL 2
   */
  constructor(canvas, quality) {
    if (!flooded) flood();
    flooded = true;
    this.canvas = canvas;
    // The only context: another one to try would take as long again.
    const gl = /** @type {WebGL2RenderingContext | null} */ (canvas.getContext("webgl2", { antialias: quality !== "low", powerPreference: "high-performance" }));
    if (!gl) throw new Error("this browser or its graphics driver has no WebGL 2");
    this.software = drawsInSoftware(gl);
    this.fine = quality === "high" || (quality === "auto" && !this.software);
    this.renderer = new THREE.WebGLRenderer({ canvas, context: gl });
    this.scene = new THREE.Scene();
    this.scene.fog = new THREE.Fog(0x000000, 1, 2);
    this.camera = new THREE.PerspectiveCamera(55, 1, 0.05, 3000);
    this.camera.position.set(3, 2, 4);
    /** All that is told in N hangs here. */
    this.root = new THREE.Group();
    this.root.matrixAutoUpdate = false;
    this.root.matrix.set(0, 1, 0, 0, 0, 0, -1, 0, -1, 0, 0, 0, 0, 0, 0, 1);
    this.root.matrixWorldNeedsUpdate = true;
    this.scene.add(this.root, makeDome());
    this.scene.add(new THREE.HemisphereLight("#dff3ff", "#3a4a52", 1.35));
    const sun = new THREE.DirectionalLight("#fff6e0", 2.1);
    sun.position.set(0.45, 1, 0.35);
    this.scene.add(sun);
    const fill = new THREE.DirectionalLight("#9fd0ff", 0.5);
    fill.position.set(-0.6, 0.2, -0.7);
    this.scene.add(fill);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.fine ? Math.min(2, devicePixelRatio) : Math.min(1, devicePixelRatio));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  render() {
    this.renderer.render(this.scene, this.camera);
  }
}

/** A place of N in the renderer's axes. @param {ArrayLike<number>} p @param {number} [i] @param {THREE.Vector3} [into] */
export function shown(p, i = 0, into = new THREE.Vector3()) {
  return into.set(p[i + 1], -p[i + 2], -p[i]);
}

/** Quaternion w x y z as three has it. @param {ArrayLike<number>} q @param {number} [i] */
export function turn(q, i = 0) {
  return new THREE.Quaternion(q[i + 1], q[i + 2], q[i + 3], q[i]);
}
