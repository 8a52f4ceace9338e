// Binary frames: states of all bodies, pictures, and where things are between two frames.
/** @typedef {import("../types").Frame} Frame @typedef {import("../types").Picture} Picture */

/** Words for a jump: a place or attitude that no body reaches within a frame of real time. */
const JUMP_M = 1;
const JUMP_COS = Math.cos((30 * Math.PI) / 360);

/** A body as high above the water is nowhere now: one that follows poses, and has none. */
const NOWHERE_M = 1e6;

/** @param {ArrayLike<number>} poses @param {number} i of a pose */
export function isNowhere(poses, i) {
  return poses[i + 2] <= -NOWHERE_M;
}

/** Linear colour of a body's own as CSS has it; null where it has none. @param {import("../types").Body | undefined} body */
export function ownColour(body) {
  const channel = (/** @type {number} */ c) => Math.round(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055));
  return body?.colour ? `#${body.colour.map((c) => channel(c).toString(16).padStart(2, "0")).join("")}` : null;
}

/**
 * States: `u8 kind=1, u8 flags, u16 count, u32 revision, i64 t_ns, count x {f32 x y z qw qx qy qz}, u16 n, n x i8`, little endian.
 * @param {ArrayBuffer} data @param {number} arrived wall time, s
 * @returns {Frame}
 */
export function states(data, arrived) {
  const view = new DataView(data);
  const count = view.getUint16(2, true);
  const end = 16 + 28 * count;
  const actuators = view.getUint16(end, true);
  return {
    t: Number(view.getBigInt64(8, true)) / 1e9,
    flags: view.getUint8(1),
    revision: view.getUint32(4, true),
    count,
    poses: new Float32Array(data, 16, 7 * count),
    achieved: new Int8Array(data, end + 2, actuators),
    arrived,
  };
}

/**
 * A picture or sonar row: `u8 kind=2, u8 codec, u16 port, u16 w, u16 h, i64 t_ns`, then bytes.
 * @param {ArrayBuffer} data
 * @returns {Picture}
 */
export function picture(data) {
  const view = new DataView(data);
  return {
    codec: view.getUint8(1),
    port: view.getUint16(2, true),
    width: view.getUint16(4, true),
    height: view.getUint16(6, true),
    t: Number(view.getBigInt64(8, true)) / 1e9,
    data: new Uint8Array(data, 16),
  };
}

/** The last frames, and the state in between: one and a half periods ago, never beyond the last. */
export class Timeline {
  constructor() {
    /** @type {Frame[]} */
    this.frames = [];
    /** Mean wall time between frames, s. */
    this.period = 1 / 30;
    /** Simulation time shown, s. */
    this.t = 0;
    this.poses = new Float32Array(0);
    /** @type {Int8Array} */
    this.achieved = new Int8Array(0);
    /** How often time went back or the list of bodies changed: who keeps a history clears it then. */
    this.breaks = 0;
  }

  /** @param {Frame} frame */
  add(frame) {
    const last = this.frames.at(-1);
    if (last) {
      const gap = frame.arrived - last.arrived;
      if (gap < 0.3) this.period += 0.1 * (gap - this.period);
      if (frame.t < last.t || frame.revision !== last.revision || frame.count !== last.count) this.clear();
    }
    this.frames.push(frame);
    if (this.frames.length > 12) this.frames.shift();
  }

  clear() {
    this.frames.length = 0;
    this.breaks += 1;
  }

  /** @returns {Frame | undefined} */
  get newest() {
    return this.frames.at(-1);
  }

  /** Work out what to show. @param {number} now wall time, s @returns {boolean} whether there is anything */
  at(now) {
    const frames = this.frames;
    const newest = frames.at(-1);
    if (!newest) return false;
    const wanted = now - 1.5 * this.period;
    let after = frames.length - 1;
    while (after > 0 && frames[after - 1].arrived >= wanted) after -= 1;
    const b = frames[after];
    const a = frames[Math.max(0, after - 1)];
    const span = b.arrived - a.arrived;
    const part = span > 0 ? Math.min(1, Math.max(0, (wanted - a.arrived) / span)) : 1;
    // Without news for a while (a paused world sends two frames a second), the last state is the state.
    this.mix(a, b, span > 0.4 ? 1 : part);
    this.achieved = newest.achieved;
    return true;
  }

  /** Show what was at a time of simulation. @param {Frame} a before it @param {Frame} b behind it @param {number} t s */
  between(a, b, t) {
    this.mix(a, b, b.t > a.t ? Math.min(1, Math.max(0, (t - a.t) / (b.t - a.t))) : 1);
    this.achieved = a.achieved;
  }

  /** @param {Frame} a @param {Frame} b @param {number} part of the way from a to b */
  mix(a, b, part) {
    this.t = a.t + (b.t - a.t) * part;
    if (this.poses.length !== b.poses.length) this.poses = new Float32Array(b.poses.length);
    for (let k = 0; k < b.count; k += 1) between(this.poses, a.poses, b.poses, 7 * k, part);
  }
}

/** @param {Float32Array} out @param {Float32Array} a @param {Float32Array} b @param {number} i @param {number} part */
function between(out, a, b, i, part) {
  const dx = b[i] - a[i];
  const dy = b[i + 1] - a[i + 1];
  const dz = b[i + 2] - a[i + 2];
  const dot = a[i + 3] * b[i + 3] + a[i + 4] * b[i + 4] + a[i + 5] * b[i + 5] + a[i + 6] * b[i + 6];
  if (!(dx * dx + dy * dy + dz * dz <= JUMP_M * JUMP_M && Math.abs(dot) >= JUMP_COS)) {
    for (let j = 0; j < 7; j += 1) out[i + j] = b[i + j];
    return;
  }
  for (let j = 0; j < 3; j += 1) out[i + j] = a[i + j] + (b[i + j] - a[i + j]) * part;
  // Within 30 degrees the chord is within 0.2 degrees of the arc.
  const sign = dot < 0 ? -1 : 1;
  let norm = 0;
  for (let j = 3; j < 7; j += 1) {
    const value = a[i + j] * sign * (1 - part) + b[i + j] * part;
    out[i + j] = value;
    norm += value * value;
  }
  norm = Math.sqrt(norm) || 1;
  for (let j = 3; j < 7; j += 1) out[i + j] /= norm;
}

/** Roll, pitch and heading of an attitude. @param {ArrayLike<number>} q w x y z @param {number} [i] where it begins */
export function euler(q, i = 0) {
  const [w, x, y, z] = [q[i], q[i + 1], q[i + 2], q[i + 3]];
  const roll = Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y));
  const pitch = Math.asin(Math.max(-1, Math.min(1, 2 * (w * y - z * x))));
  const yaw = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
  return { roll, pitch, yaw };
}

/** A vector of B in N. @param {ArrayLike<number>} q w x y z @param {number} i where it begins @param {ArrayLike<number>} v */
export function turned(q, i, v) {
  const [w, x, y, z] = [q[i], q[i + 1], q[i + 2], q[i + 3]];
  const tx = 2 * (y * v[2] - z * v[1]);
  const ty = 2 * (z * v[0] - x * v[2]);
  const tz = 2 * (x * v[1] - y * v[0]);
  return [v[0] + w * tx + y * tz - z * ty, v[1] + w * ty + z * tx - x * tz, v[2] + w * tz + x * ty - y * tx];
}
