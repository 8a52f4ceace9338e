// What modems tell: an entry among the events for each message, and who sent it, so that its sound can be drawn.
/** @typedef {import("../types").Sample} Sample @typedef {import("../types").Port} Port */

/** Colour of the sound of a message. */
export const SOUND = "#8dff9a";
const SOUND_MESSAGE = "AcousticPacket";
const MESSAGES = [SOUND_MESSAGE, "OpticalPacket"];
const RATE_HZ = 20;
const SHOWN_BYTES = 24;

/** Return whether a port reports packets of a modem. @param {Port} port */
export function hears(port) {
  return port.direction === "sensor" && MESSAGES.includes(port.message ?? "");
}

/** Bytes of a field as they come in JSON. @param {unknown} data */
function bytes(data) {
  const text = /** @type {{base64?: string} | null} */ (data)?.base64 ?? "";
  return Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
}

/** What was sent, for a person: text where it is one, else hexadecimal. @param {unknown} data */
export function content(data) {
  const all = bytes(data);
  if (!all.length) return "no bytes";
  const part = all.slice(0, SHOWN_BYTES);
  const more = all.length > part.length ? " …" : "";
  const isText = part.every((code) => code >= 32 && code < 127);
  const said = isText ? `“${String.fromCharCode(...part)}”` : [...part].map((code) => code.toString(16).padStart(2, "0")).join(" ");
  return `${all.length} ${all.length === 1 ? "byte" : "bytes"}: ${said}${more}`;
}

/** One message in words. @param {Sample} sample */
export function words({ port, value }) {
  const modem = port.replace(/\/received$/, "");
  const range = typeof value.range === "number" ? `, ${value.range.toFixed(1)} m away` : "";
  if (value.event === "delivered") return `${modem}: ${value.destination} has answered${range}`;
  if (value.event === "failed") return `${modem}: no answer of ${value.destination}`;
  return `${modem}: from ${value.source} to ${value.destination}, ${content(value.data)}`;
}

/**
 * Where the sound of a message came from, and how far; null where nobody is known to have the address. Of several the nearest is taken.
 * @param {import("./app.js").App} app @param {Sample} sample @returns {{from: number[], far: number} | null}
 */
export function wayOf(app, { port, value }) {
  if (value.event === "failed" || app.port(port)?.message !== SOUND_MESSAGE) return null;
  const address = value.event === "delivered" ? value.destination : value.source;
  const own = port.split("/")[0];
  const place = (/** @type {number} */ k) => [...app.timeline.poses.subarray(7 * k, 7 * k + 3)];
  const to = place(app.bodies.findIndex((body) => body.name === own));
  const ways = app.bodies.flatMap((body, k) => {
    const has = body.name !== own && body.sensors?.some((sensor) => sensor.message === SOUND_MESSAGE && sensor.address === address);
    const from = place(k);
    const far = Math.hypot(...from.map((x, axis) => x - to[axis]));
    return has && from.length === 3 && Number.isFinite(far) ? [{ from, far }] : [];
  });
  return ways.sort((a, b) => a.far - b.far)[0] ?? null;
}

/**
 * Has each message of each modem told among the events, and its sound drawn.
 * @param {import("./app.js").App} app @param {(from: number[], far: number) => void} sound draws it, from N, m; it has come already, and is shown on its way once more
 */
export function tellMessages(app, sound) {
  /** @type {Map<string, () => void>} */
  const heard = new Map();
  app.on("described", () => {
    const there = new Set(app.description?.ports.filter(hears).map((port) => port.path));
    for (const [path, end] of heard) {
      if (there.has(path)) continue;
      end();
      heard.delete(path);
    }
    for (const path of there) {
      if (heard.has(path)) continue;
      heard.set(path, app.link.subscribe(path, RATE_HZ, (sample) => {
        if (!sample.valid) return;
        app.tell({ event: sample.value.event === "failed" ? "no_answer" : "message", t_ns: sample.t_ns, text: words(sample) });
        const way = wayOf(app, sample);
        if (way) sound(way.from, 1.05 * way.far);
      }));
    }
  });
}
