// Pings of a side-scan sonar, the newest one on top; port to the left, starboard to the right, the vehicle's track in the middle.
import { h } from "../core/dom.js";
import { gradient } from "./sonar.js";
/** @typedef {import("../types").Picture} Picture */

const [WIDTH, HEIGHT, SCALE_PX, ROW_PX] = [480, 340, 20, 2];
const HALF = WIDTH / 2;
/** Bytes before the counts: slant range at the end of the rows, m. */
const HEAD = 4;

/** Draws pings of one sonar. */
export class Waterfall {
  constructor() {
    this.canvas = h("canvas", { width: WIDTH, height: HEIGHT, role: "img", "aria-label": "Echoes of the side-scan sonar: the newest on top, port to the left" });
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    this.row = this.pen.createImageData(WIDTH, ROW_PX);
    // Copper, as side-scan sonars are shown by custom: shadows of things matter more than colours.
    this.table = gradient([[6, 4, 3], [92, 48, 18], [196, 118, 44], [250, 206, 122], [255, 250, 232]]);
    this.range = 0;
    this.pen.fillStyle = "#060403";
    this.pen.fillRect(0, 0, WIDTH, HEIGHT);
  }

  /** @param {Picture} picture */
  draw(picture) {
    const { width: bins, data } = picture;
    const range = new DataView(data.buffer, data.byteOffset).getFloat32(0, true);
    if (!(range > 0) || data.length < HEAD + 2 * bins) return;
    const { pen } = this;
    if (Math.abs(range - this.range) > 1e-6 * range) {
      // Echoes of another range would stand at wrong places.
      pen.fillStyle = "#060403";
      pen.fillRect(0, 0, WIDTH, HEIGHT);
      this.range = range;
    }
    pen.drawImage(this.canvas, 0, SCALE_PX, WIDTH, HEIGHT - SCALE_PX - ROW_PX, 0, SCALE_PX + ROW_PX, WIDTH, HEIGHT - SCALE_PX - ROW_PX);
    for (let x = 0; x < HALF; x += 1) {
      const [from, to] = [Math.floor((x * bins) / HALF), Math.max(Math.floor((x * bins) / HALF) + 1, Math.floor(((x + 1) * bins) / HALF))];
      this.put(HALF - 1 - x, data.subarray(HEAD + from, HEAD + to));
      this.put(HALF + x, data.subarray(HEAD + bins + from, HEAD + bins + to));
    }
    pen.putImageData(this.row, 0, SCALE_PX);
    this.scale();
  }

  /** The mean of the counts that one pixel covers. @param {number} x @param {Uint8Array} counts */
  put(x, counts) {
    let sum = 0;
    for (const count of counts) sum += count;
    const value = Math.round(sum / Math.max(1, counts.length));
    for (let y = 0; y < ROW_PX; y += 1) this.row.data.set(this.table.subarray(4 * value, 4 * value + 4), 4 * (y * WIDTH + x));
  }

  /** Slant ranges over the pings. */
  scale() {
    const { pen } = this;
    pen.fillStyle = "#10181f";
    pen.fillRect(0, 0, WIDTH, SCALE_PX);
    pen.fillStyle = "rgb(225 242 250 / 90%)";
    pen.font = "11px system-ui";
    pen.textAlign = "center";
    for (const part of [-0.5, -0.25, 0.25, 0.5]) {
      const x = HALF + HALF * part;
      pen.fillRect(x, SCALE_PX - 4, 1, 4);
      pen.fillText(`${Number((Math.abs(part) * this.range).toPrecision(3))} m`, x, 12);
    }
    pen.textAlign = "left";
    pen.fillText("port", 4, 12);
    pen.textAlign = "right";
    pen.fillText("starboard", WIDTH - 4, 12);
    pen.fillRect(HALF, 0, 1, SCALE_PX);
  }
}
