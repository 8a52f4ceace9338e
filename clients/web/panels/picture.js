// Pictures of cameras and rows of imaging sonars, as binary frames; each that was drawn is acknowledged, so a slow page gets fewer.
import { h } from "../core/dom.js";
import { SonarFan } from "./fan.js";
import { SonarDisc } from "./sonar.js";
import { Waterfall } from "./waterfall.js";
/** @typedef {import("../types").Port} Port @typedef {import("../types").Picture} Picture @typedef {import("../core/app.js").App} App */

const [RAW, JPEG, DEPTH, SONAR, FAN, SIDES] = [0, 1, 2, 3, 4, 5];

/** Who draws pictures of which port; `main.js` brings the frames. @type {Map<string, Set<(picture: Picture) => Promise<void> | void>>} */
const drawers = new Map();

/** @param {App} app */
function wish(app) {
  app.link.view({ pictures: [...drawers.keys()] });
}

/** Draw a picture where it is shown. @param {App} app @param {Picture} picture */
export async function showPicture(app, picture) {
  const port = app.link.pictures.get(picture.port);
  const there = port === undefined ? undefined : drawers.get(port);
  if (there) await Promise.all([...there].map((draw) => draw(picture)));
  app.link.seen([picture.port]);
}

/** Whether a port gives pictures. @param {Port} port */
export function hasPicture(port) {
  return port.direction === "sensor" && port.fields.some((field) => field.type === "buffer");
}

/** @param {Port} port @param {App} app @param {HTMLElement} place @returns {() => void} */
export function picturePanel(port, app, place) {
  const canvas = h("canvas", { width: 320, height: 240, role: "img", "aria-label": `Picture of ${port.path}` });
  place.classList.add("picture");
  const waits = h("p", { class: "doc" }, "Waits for a picture …");
  place.append(canvas, waits);
  /** @type {SonarDisc | null} */
  let disc = null;
  /** @type {SonarFan | null} */
  let fan = null;
  /** @type {Waterfall | null} */
  let fall = null;
  const draw = async (/** @type {Picture} */ picture) => {
    waits.hidden = true;
    if (picture.codec === SONAR) {
      if (!disc) {
        disc = new SonarDisc();
        canvas.replaceWith(disc.canvas);
      }
      const view = new DataView(picture.data.buffer, picture.data.byteOffset);
      disc.ping(view.getFloat32(0, true), view.getFloat32(4, true), picture.data.subarray(8));
      disc.draw();
      return;
    }
    if (picture.codec === FAN) {
      if (!fan) {
        fan = new SonarFan();
        canvas.replaceWith(fan.canvas);
      }
      fan.draw(picture);
      return;
    }
    if (picture.codec === SIDES) {
      if (!fall) {
        fall = new Waterfall();
        canvas.replaceWith(fall.canvas);
      }
      fall.draw(picture);
      return;
    }
    if (canvas.width !== picture.width || canvas.height !== picture.height) Object.assign(canvas, { width: picture.width, height: picture.height });
    const pen = canvas.getContext("2d");
    if (!pen) return;
    if (picture.codec === JPEG) {
      const bitmap = await createImageBitmap(new Blob([/** @type {BlobPart} */ (picture.data)], { type: "image/jpeg" }));
      pen.drawImage(bitmap, 0, 0);
      bitmap.close();
    } else {
      pen.putImageData(rgba(picture, pen), 0, 0);
    }
  };
  const there = drawers.get(port.path) ?? new Set();
  drawers.set(port.path, there.add(draw));
  wish(app);
  return () => {
    there.delete(draw);
    if (!there.size) drawers.delete(port.path);
    wish(app);
  };
}

/** @param {Picture} picture @param {CanvasRenderingContext2D} pen */
function rgba(picture, pen) {
  const { width, height, data } = picture;
  const image = pen.createImageData(width, height);
  const count = width * height;
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const channels = picture.codec === RAW ? Math.max(1, Math.round(data.length / count)) : 1;
  for (let k = 0; k < count; k += 1) {
    for (let c = 0; c < 3; c += 1) {
      image.data[4 * k + c] = picture.codec === DEPTH ? 255 - Math.min(255, view.getUint16(2 * k, true) / 60) : data[k * channels + Math.min(c, channels - 1)];
    }
    image.data[4 * k + 3] = 255;
  }
  return image;
}
