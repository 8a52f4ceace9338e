// Echoes of a scanning sonar as it turns: ahead is up, the newest ping bright at its edge.
import { h } from "../core/dom.js";
/** @typedef {import("../types").Port} Port @typedef {import("../core/app.js").App} App */

const SIZE = 320;
/** Sectors into which the picture is cut, finer than the steps of any head. */
const SECTORS = 800;

/** Colours of echoes from nothing to the strongest: black, deep blue, teal, amber, white. @returns {Uint8ClampedArray} */
export function palette() {
  return gradient([[3, 9, 13], [8, 40, 84], [12, 120, 140], [240, 180, 65], [255, 255, 240]]);
}

/** A colour for each count. @param {number[][]} stops evenly apart @returns {Uint8ClampedArray} */
export function gradient(stops) {
  const table = new Uint8ClampedArray(256 * 4);
  for (let k = 0; k < 256; k += 1) {
    const at = (k / 255) * (stops.length - 1);
    const i = Math.min(stops.length - 2, Math.floor(at));
    for (let c = 0; c < 3; c += 1) table[4 * k + c] = stops[i][c] + (stops[i + 1][c] - stops[i][c]) * (at - i);
    table[4 * k + 3] = 255;
  }
  return table;
}

/** Counts of a ping, 0 to 255, whatever form they come in. @param {unknown} bins @returns {number[] | Uint8Array} */
export function counts(bins) {
  if (Array.isArray(bins)) {
    const top = bins.reduce((most, bin) => Math.max(most, typeof bin === "number" ? bin : 0), 0);
    return top > 255 || (top > 0 && top <= 1) ? bins.map((bin) => (255 * bin) / top) : bins;
  }
  if (bins !== null && typeof bins === "object" && "base64" in bins) return Uint8Array.from(atob(String(bins.base64)), (letter) => letter.charCodeAt(0));
  return [];
}

/** Draws pings into a disc. */
export class SonarDisc {
  constructor() {
    this.canvas = h("canvas", { width: SIZE, height: SIZE, role: "img", "aria-label": "Echoes of the scanning sonar, ahead is up" });
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    this.image = this.pen.createImageData(SIZE, SIZE);
    this.table = palette();
    this.range = 0;
    this.head = 0;
    this.width = (2 * Math.PI) / 200;
    /** Pixels of each sector, with their distance 0..1. @type {[pixel: number, part: number][][]} */
    this.sectors = Array.from({ length: SECTORS }, () => []);
    for (let y = 0; y < SIZE; y += 1) {
      for (let x = 0; x < SIZE; x += 1) {
        const [dx, dy] = [x - SIZE / 2 + 0.5, SIZE / 2 - y - 0.5];
        const part = Math.hypot(dx, dy) / (SIZE / 2 - 2);
        if (part < 1) this.sectors[sector(Math.atan2(dx, dy))].push([y * SIZE + x, part]);
      }
    }
    this.clear();
  }

  clear() {
    for (let k = 0; k < SIZE * SIZE; k += 1) this.image.data.set(this.table.subarray(0, 4), 4 * k);
  }

  /** @param {number} angle rad, to starboard @param {number} range m @param {ArrayLike<number>} bins 0..255 */
  ping(angle, range, bins) {
    if (Math.abs(range - this.range) > 1e-6) this.clear();
    const turned = Math.abs(Math.atan2(Math.sin(angle - this.head), Math.cos(angle - this.head)));
    if (turned > 1e-4 && turned < 0.3) this.width = Math.max(turned, (2 * Math.PI) / SECTORS);
    this.range = range;
    this.head = angle;
    const wide = Math.max(1, Math.round((this.width / (2 * Math.PI)) * SECTORS));
    for (let k = 0; k < wide; k += 1) {
      const at = sector(angle + ((k - (wide - 1) / 2) / SECTORS) * 2 * Math.PI);
      for (const [pixel, part] of this.sectors[at]) {
        const value = Math.max(0, Math.min(255, Math.round(bins[Math.floor(part * bins.length)] ?? 0)));
        this.image.data.set(this.table.subarray(4 * value, 4 * value + 4), 4 * pixel);
      }
    }
  }

  draw() {
    const { pen } = this;
    const [c, r] = [SIZE / 2, SIZE / 2 - 2];
    pen.putImageData(this.image, 0, 0);
    pen.strokeStyle = "rgb(190 225 240 / 30%)";
    pen.fillStyle = "rgb(225 242 250 / 90%)";
    pen.font = "11px system-ui";
    for (let k = 1; k <= 4; k += 1) {
      pen.beginPath();
      pen.arc(c, c, (r * k) / 4, 0, 7);
      pen.stroke();
      pen.fillText(`${Number(((this.range * k) / 4).toPrecision(3))} m`, c + 3, c - (r * k) / 4 + 12);
    }
    pen.strokeStyle = "#f0b441";
    pen.beginPath();
    pen.moveTo(c, c);
    pen.lineTo(c + r * Math.sin(this.head), c - r * Math.cos(this.head));
    pen.stroke();
  }
}

/** @param {number} angle */
function sector(angle) {
  const part = angle / (2 * Math.PI);
  return Math.min(SECTORS - 1, Math.floor((part - Math.floor(part)) * SECTORS));
}

/** @param {Port} port @param {App} app @param {HTMLElement} place @returns {() => void} */
export function sonarPanel(port, app, place) {
  const disc = new SonarDisc();
  place.classList.add("sonar");
  place.append(disc.canvas);
  let dirty = true;
  const stop = app.link.subscribe(port.path, 60, ({ value }) => {
    const bins = counts(value.bins);
    if (typeof value.head_angle !== "number" || typeof value.range !== "number" || !bins.length) return;
    disc.ping(value.head_angle, value.range, bins);
    dirty = true;
  });
  const timer = setInterval(() => {
    if (dirty && !document.hidden) disc.draw();
    dirty = false;
  }, 100);
  return () => {
    stop();
    clearInterval(timer);
  };
}
