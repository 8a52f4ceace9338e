// The map: north up, with a scale; a click tells a place. It is all there is where the browser has no WebGL.
import { byId, h, symbol } from "./dom.js";
import { euler, isNowhere, ownColour } from "./frames.js";
import { SOUND } from "./modems.js";
/** @typedef {import("../types").World} World @typedef {import("../types").Shape} Shape @typedef {import("./frames.js").Timeline} Timeline */

const COLOURS = ["#5fe3f5", "#ffc24d", "#8cf09a", "#e0a6ff", "#ff9d7d", "#a3c1ff"];
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const MOVED_PX = 5;

/** A canvas over the picture. */
export class Chart {
  /** @param {(north: number, east: number) => void} onPlace */
  constructor(onPlace) {
    this.onPlace = onPlace;
    this.place = byId("map");
    this.canvas = h("canvas", { "aria-label": "Map, north up. A click tells the autopilot where to go.", role: "img" });
    this.larger = h("button", { class: "larger icon", title: "Enlarge the map (M)", "aria-label": "Enlarge the map", onclick: () => this.enlarge() }, symbol("large"));
    this.place.classList.add("glass");
    const zoom = (/** @type {number} */ by) => { this.scale *= by; };
    this.place.append(this.canvas, h("div", { class: "corner" },
      h("button", { title: "Closer", "aria-label": "Map closer", onclick: () => zoom(1.5) }, "+"),
      h("button", { title: "Farther", "aria-label": "Map farther", onclick: () => zoom(1 / 1.5) }, "−"), this.larger));
    /** Pixels a metre. */
    this.scale = 8;
    this.centre = [0, 0];
    this.free = false;
    /** @type {World | null} */
    this.world = null;
    /** @type {number[] | null} */
    this.goal = null;
    /** Where a training leads to. @type {number[] | null} */
    this.aim = null;
    /** Places of a mission, and what is said beside them; those above the bottom look different. @type {{place: number[], above: boolean, text: string}[]} */
    this.route = [];
    /** @type {number[][]} */
    this.trails = [];
    /** @type {string[]} */
    this.colours = [];
    this.breaks = -1;
    /** Sound of messages on its way: from where (N), since when (s), and how far (m). @type {{from: number[], born: number, far: number}[]} */
    this.pulses = [];
    this.listen();
  }

  enlarge() {
    this.place.classList.toggle("large");
    this.free = false;
  }

  listen() {
    /** @type {{x: number, y: number, moved: boolean} | null} */
    let held = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      held = { x: event.offsetX, y: event.offsetY, moved: false };
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!held) return;
      const [dx, dy] = [event.offsetX - held.x, event.offsetY - held.y];
      if (!held.moved && Math.hypot(dx, dy) < MOVED_PX) return;
      held = { x: event.offsetX, y: event.offsetY, moved: true };
      this.free = true;
      this.centre = [this.centre[0] + dy / this.scale, this.centre[1] - dx / this.scale];
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (held && !held.moved) {
        const [north, east] = this.placeAt(event.offsetX, event.offsetY);
        this.onPlace(north, east);
      }
      held = null;
    });
    this.canvas.addEventListener("dblclick", () => { this.free = false; });
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.scale = Math.max(0.02, Math.min(400, this.scale * Math.exp(-0.0015 * event.deltaY)));
    }, { passive: false });
  }

  /** @param {number} x @param {number} y px @returns {[number, number]} north, east */
  placeAt(x, y) {
    return [this.centre[0] - (y - this.canvas.clientHeight / 2) / this.scale, this.centre[1] + (x - this.canvas.clientWidth / 2) / this.scale];
  }

  /** @param {World} world */
  show(world) {
    this.world = world;
    const bodies = [...world.vehicles, ...world.objects];
    this.trails = bodies.map(() => []);
    this.colours = bodies.map((body, k) => ownColour(body) ?? COLOURS[k % COLOURS.length]);
    this.free = false;
  }

  /** Sound leaves a place. @param {number[]} from N @param {number} born simulation time, s @param {number} far m */
  pulse(from, born, far) {
    this.pulses = [...this.pulses.slice(-23), { from, born, far }];
  }

  /** @param {Timeline} timeline @param {number} chosen */
  draw(timeline, chosen) {
    const { world, canvas } = this;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!world || !width) return;
    const ratio = devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    if (!pen) return;
    const { poses } = timeline;
    if (!this.free && poses.length > 7 * chosen && chosen >= 0 && Number.isFinite(poses[7 * chosen]) && !isNowhere(poses, 7 * chosen)) this.centre = [poses[7 * chosen], poses[7 * chosen + 1]];
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = "#0a2533";
    pen.fillRect(0, 0, width, height);
    pen.translate(width / 2, height / 2);
    this.grid(pen, width, height);
    for (const structure of world.structures) for (const shape of structure.shapes) this.footprint(pen, shape, "rgb(176 190 200 / 55%)");
    for (const beacon of world.beacons) if (!beacon.body) this.dot(pen, beacon.p, "#ffe27a", 3);
    this.history(timeline);
    this.trails.forEach((trail, k) => this.line(pen, trail, this.colours[k]));
    this.plan(pen);
    if (this.goal) this.cross(pen, this.goal);
    if (this.aim) this.ring(pen, this.aim);
    this.sounds(pen, timeline.t, world.water.sound_speed);
    for (let k = 0; 7 * k + 6 < poses.length; k += 1) this.craft(pen, poses, k, k === chosen);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.scaleBar(pen, height);
    north(pen);
  }

  /** @param {Timeline} timeline */
  history(timeline) {
    if (timeline.breaks !== this.breaks) {
      this.breaks = timeline.breaks;
      for (const trail of this.trails) trail.length = 0;
    }
    const { poses } = timeline;
    this.trails.forEach((trail, k) => {
      const [x, y] = [poses[7 * k], poses[7 * k + 1]];
      const n = trail.length;
      if (!Number.isFinite(x + y) || isNowhere(poses, 7 * k) || (n >= 2 && Math.hypot(x - trail[n - 2], y - trail[n - 1]) < Math.max(0.05, 1 / this.scale))) return;
      trail.push(x, y);
      if (n > 1200) trail.splice(0, 2);
    });
  }

  /** @param {number} n @param {number} e @returns {[number, number]} */
  at(n, e) {
    return [(e - this.centre[1]) * this.scale, -(n - this.centre[0]) * this.scale];
  }

  /** A step of the grid that is about so many pixels. @param {number} pixels */
  stepFor(pixels) {
    return STEPS.find((step) => step * this.scale >= pixels) ?? STEPS[STEPS.length - 1];
  }

  /** @param {CanvasRenderingContext2D} pen @param {number} width @param {number} height */
  grid(pen, width, height) {
    const step = this.stepFor(28);
    pen.strokeStyle = "rgb(150 200 220 / 13%)";
    pen.lineWidth = 1;
    pen.beginPath();
    const [e0, e1] = [this.centre[1] - width / 2 / this.scale, this.centre[1] + width / 2 / this.scale];
    const [n0, n1] = [this.centre[0] - height / 2 / this.scale, this.centre[0] + height / 2 / this.scale];
    for (let e = Math.ceil(e0 / step) * step; e < e1; e += step) pen.moveTo(this.at(0, e)[0], -height / 2), pen.lineTo(this.at(0, e)[0], height / 2);
    for (let n = Math.ceil(n0 / step) * step; n < n1; n += step) pen.moveTo(-width / 2, this.at(n, 0)[1]), pen.lineTo(width / 2, this.at(n, 0)[1]);
    pen.stroke();
  }

  /** What a shape covers, seen from above. @param {CanvasRenderingContext2D} pen @param {Shape} shape @param {string} colour */
  footprint(pen, shape, colour) {
    const p = shape.p ?? [0, 0, 0];
    const q = shape.q ?? [1, 0, 0, 0];
    const radius = shape.radius ?? 0;
    const long = (shape.length ?? 0) / 2 + (shape.kind === "capsule" ? radius : 0);
    const mesh = this.world?.meshes[shape.mesh ?? ""];
    const half = shape.kind === "box" && shape.size ? shape.size.map((edge) => edge / 2) : shape.kind === "mesh" && mesh ? mesh.high.map((high, k) => (high - mesh.low[k]) / 2) : [Math.max(long, radius), radius, radius];
    const corners = [-1, 1].flatMap((a) => [-1, 1].flatMap((b) => [-1, 1].map((c) => rotate(q, [a * half[0], b * half[1], c * half[2]])))).map((v) => this.at(p[0] + v[0], p[1] + v[1]));
    pen.fillStyle = colour;
    pen.beginPath();
    hull(corners).forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.fill();
  }

  /** @param {CanvasRenderingContext2D} pen @param {number[]} places @param {string} colour */
  line(pen, places, colour) {
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.globalAlpha = 0.8;
    pen.beginPath();
    for (let k = 0; k + 1 < places.length; k += 2) {
      const [x, y] = this.at(places[k], places[k + 1]);
      if (k) pen.lineTo(x, y);
      else pen.moveTo(x, y);
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  /** @param {CanvasRenderingContext2D} pen @param {ArrayLike<number>} p @param {string} colour @param {number} radius px */
  dot(pen, p, colour, radius) {
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(...this.at(p[0], p[1]), radius, 0, 7);
    pen.fill();
  }

  /** The mission: way-points above the bottom are squares, those at a depth dots. @param {CanvasRenderingContext2D} pen */
  plan(pen) {
    this.line(pen, this.route.flatMap(({ place }) => place), "#ffffff");
    pen.font = "600 10px system-ui, sans-serif";
    /** @type {[number, number] | null} */
    let last = null;
    for (const { place, above, text } of this.route) {
      const [x, y] = this.at(place[0], place[1]);
      pen.fillStyle = "#ffffff";
      if (above) pen.fillRect(x - 3.5, y - 3.5, 7, 7);
      else this.dot(pen, place, "#ffffff", 3);
      // Texts over each other say nothing.
      if (last && Math.abs(x - last[0]) < 40 && Math.abs(y - last[1]) < 12) continue;
      pen.fillText(text, x + 6, y - 5);
      last = [x, y];
    }
  }

  /** @param {CanvasRenderingContext2D} pen @param {number} t s @param {number} speed of sound, m/s */
  sounds(pen, t, speed) {
    this.pulses = this.pulses.filter(({ born, far }) => t >= born && speed * (t - born) <= far);
    pen.strokeStyle = SOUND;
    pen.lineWidth = 2;
    for (const { from, born, far } of this.pulses) {
      pen.globalAlpha = 1 - 0.6 * speed * (t - born) / far;
      pen.beginPath();
      pen.arc(...this.at(from[0], from[1]), speed * (t - born) * this.scale, 0, 7);
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  /** @param {CanvasRenderingContext2D} pen @param {number[]} p */
  cross(pen, p) {
    const [x, y] = this.at(p[0], p[1]);
    pen.strokeStyle = "#f0b441";
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x - 6, y), pen.lineTo(x + 6, y), pen.moveTo(x, y - 6), pen.lineTo(x, y + 6);
    pen.stroke();
  }

  /** @param {CanvasRenderingContext2D} pen @param {number[]} p */
  ring(pen, p) {
    pen.strokeStyle = "#f0b441";
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(...this.at(p[0], p[1]), 7, 0, 7);
    pen.stroke();
  }

  /** @param {CanvasRenderingContext2D} pen @param {Float32Array} poses @param {number} k @param {boolean} own */
  craft(pen, poses, k, own) {
    const heading = euler(poses, 7 * k + 3).yaw;
    const [x, y] = this.at(poses[7 * k], poses[7 * k + 1]);
    if (!Number.isFinite(x + y + heading) || isNowhere(poses, 7 * k)) return;
    const size = own ? 8 : 6;
    pen.save();
    pen.translate(x, y);
    pen.rotate(heading);
    pen.fillStyle = this.colours[k] ?? COLOURS[k % COLOURS.length];
    pen.strokeStyle = own ? "#ffffff" : "#04121a";
    pen.lineWidth = own ? 1.6 : 1;
    pen.beginPath();
    pen.moveTo(0, -size), pen.lineTo(0.7 * size, size), pen.lineTo(0, 0.55 * size), pen.lineTo(-0.7 * size, size);
    pen.closePath();
    pen.fill();
    pen.stroke();
    pen.restore();
  }

  /** @param {CanvasRenderingContext2D} pen @param {number} height */
  scaleBar(pen, height) {
    const step = this.stepFor(42);
    const long = step * this.scale;
    pen.strokeStyle = "#e8f6fb";
    pen.fillStyle = "#e8f6fb";
    pen.lineWidth = 1.6;
    pen.beginPath();
    pen.moveTo(10, height - 14), pen.lineTo(10, height - 9), pen.lineTo(10 + long, height - 9), pen.lineTo(10 + long, height - 14);
    pen.stroke();
    pen.font = "600 11px system-ui, sans-serif";
    pen.fillText(step >= 1000 ? `${step / 1000} km` : `${step} m`, 14, height - 14);
  }
}

/** @param {CanvasRenderingContext2D} pen */
function north(pen) {
  pen.fillStyle = "#e8f6fb";
  pen.beginPath();
  pen.moveTo(16, 8), pen.lineTo(21, 22), pen.lineTo(16, 18), pen.lineTo(11, 22);
  pen.fill();
  pen.font = "700 10px system-ui, sans-serif";
  pen.fillText("N", 12.5, 33);
}

/** @param {ArrayLike<number>} q w x y z @param {number[]} v */
function rotate(q, v) {
  const t = [2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]), 2 * (q[1] * v[1] - q[2] * v[0])];
  return [v[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1], v[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2], v[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0]];
}

/** Convex hull, by Andrew's monotone chain. @param {[number, number][]} points */
export function hull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (/** @type {[number, number][]} */ list) => {
    /** @type {[number, number][]} */
    const chain = [];
    for (const p of list) {
      while (chain.length > 1) {
        const [a, b] = chain.slice(-2);
        if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
        chain.pop();
      }
      chain.push(p);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}
