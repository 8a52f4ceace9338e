// A picture of an imaging sonar: rows of ranges and columns of beams, drawn as the fan that it is; ahead is up.
import { h } from "../core/dom.js";
import { palette } from "./sonar.js";
/** @typedef {import("../types").Picture} Picture */

const [WIDTH, HEIGHT, EDGE] = [480, 300, 4];
/** Of the labels: their distance from the edge, and how tall their figures are. */
const [GAP, TALL] = [3, 9];
/** Bytes before the picture: azimuths of the first and the last beam (rad), ranges where the first row begins and the last one ends (m). */
export const HEAD = 16;

/** Draws pictures of one sonar. */
export class SonarFan {
  constructor() {
    this.canvas = h("canvas", { width: WIDTH, height: HEIGHT, role: "img", "aria-label": "Echoes of the imaging sonar, ahead is up" });
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    this.image = this.pen.createImageData(WIDTH, HEIGHT);
    this.table = palette();
    this.form = "";
    /** Place in the picture of each pixel, -1 for none. */
    this.places = new Int32Array(WIDTH * HEIGHT);
    this.scale = 1;
  }

  /** @param {Picture} picture */
  draw(picture) {
    const view = new DataView(picture.data.buffer, picture.data.byteOffset);
    const [first, last, near, far] = [0, 4, 8, 12].map((at) => view.getFloat32(at, true));
    if (!(last > first && far > near)) return;
    this.lay(first, last, near, far, picture.width, picture.height);
    const counts = picture.data.subarray(HEAD);
    const { data } = this.image;
    for (let k = 0; k < this.places.length; k += 1) {
      const place = this.places[k];
      const value = place < 0 ? 0 : (counts[place] ?? 0);
      data.set(this.table.subarray(4 * value, 4 * value + 4), 4 * k);
    }
    this.pen.putImageData(this.image, 0, 0);
    this.rings(first, last, far);
  }

  /** Find the places of all pixels, where the form of the picture is another one. @param {number} first @param {number} last @param {number} near @param {number} far @param {number} beams @param {number} rows */
  lay(first, last, near, far, beams, rows) {
    const form = [first, last, near, far, beams, rows].join();
    if (form === this.form) return;
    this.form = form;
    const widest = Math.min(Math.max(-first, last), Math.PI / 2);
    this.scale = Math.min(HEIGHT - 2 * EDGE, (WIDTH / 2 - EDGE) / Math.max(Math.sin(widest), 1e-3)) / far;
    const step = (last - first) / Math.max(beams - 1, 1);
    for (let y = 0; y < HEIGHT; y += 1) {
      for (let x = 0; x < WIDTH; x += 1) {
        const [dx, dy] = [x + 0.5 - WIDTH / 2, HEIGHT - EDGE - y - 0.5];
        const row = Math.floor(((Math.hypot(dx, dy) / this.scale - near) / (far - near)) * rows);
        const beam = Math.round((Math.atan2(dx, dy) - first) / step);
        this.places[y * WIDTH + x] = row >= 0 && row < rows && beam >= 0 && beam < beams ? row * beams + beam : -1;
      }
    }
  }

  /** Rings, and their ranges beside the edge to the right, where no echo is. @param {number} first @param {number} last @param {number} far */
  rings(first, last, far) {
    const { pen } = this;
    const [x, y] = [WIDTH / 2, HEIGHT - EDGE];
    pen.strokeStyle = "rgb(190 225 240 / 30%)";
    pen.fillStyle = "rgb(225 242 250 / 90%)";
    pen.font = "11px system-ui";
    for (let k = 1; k <= 4; k += 1) {
      const r = (far * this.scale * k) / 4;
      pen.beginPath();
      pen.arc(x, y, r, first - Math.PI / 2, last - Math.PI / 2);
      pen.stroke();
      const text = `${Number(((far * k) / 4).toPrecision(3))} m`;
      const left = Math.min(x + r * Math.sin(last) + GAP, WIDTH - pen.measureText(text).width - 2);
      // The edge runs from here down to the left; that of a fan wider than a half circle is not in the picture.
      const edge = last < Math.PI / 2 ? y - (left - x) / Math.tan(last) : y;
      pen.fillText(text, left, Math.min(edge + GAP + TALL, HEIGHT - 3));
    }
  }
}
