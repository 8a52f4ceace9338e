// From sticks to actuators, for vehicles that no autopilot steers: the damped pseudo-inverse of the thrusters' geometry, and fins by their moments.
/** @typedef {import("../types").Vec3} Vec3 @typedef {import("../types").Actuator} Actuator @typedef {import("../types").Port} Port */
/** What a pilot asks for, each -1 to 1: surge, sway, heave (down), roll, pitch, yaw. @typedef {[number, number, number, number, number, number]} Sticks */

/** Length that makes moments comparable with forces, m. */
const ARM_M = 0.25;
const DAMPING = 1e-3;
/** Part of a pure stick that thrusters must give for it to count as possible. */
const POSSIBLE = 0.5;

/** @param {ArrayLike<number>} a @param {ArrayLike<number>} b @returns {Vec3} */
function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** Solve a symmetric positive definite system in place, by elimination. @param {number[][]} matrix @param {number[]} right */
function solve(matrix, right) {
  const a = matrix.map((row, i) => [...row, right[i]]);
  const n = a.length;
  for (let i = 0; i < n; i += 1) {
    for (let j = i + 1; j < n; j += 1) {
      const factor = a[j][i] / a[i][i];
      for (let k = i; k <= n; k += 1) a[j][k] -= factor * a[i][k];
    }
  }
  const x = new Array(n).fill(0);
  for (let i = n - 1; i >= 0; i -= 1) {
    let sum = a[i][n];
    for (let j = i + 1; j < n; j += 1) sum -= a[i][j] * x[j];
    x[i] = sum / a[i][i];
  }
  return x;
}

/**
 * For each stick the pattern of commands that gives it, its largest part 1; zeros where thrusters cannot give it.
 * @param {{r_B: Vec3, axis_B: Vec3}[]} propulsors
 * @returns {number[][]} six rows
 */
export function patterns(propulsors) {
  const columns = propulsors.map(({ r_B: r, axis_B: axis }) => [...axis, ...cross(r, axis).map((moment) => moment / ARM_M)]);
  const gram = Array.from({ length: 6 }, (_, i) => Array.from({ length: 6 }, (_row, j) => columns.reduce((sum, c) => sum + c[i] * c[j], i === j ? DAMPING : 0)));
  return Array.from({ length: 6 }, (_, stick) => {
    const wanted = new Array(6).fill(0);
    wanted[stick] = 1;
    const multipliers = solve(gram, wanted);
    const u = columns.map((c) => c.reduce((sum, value, k) => sum + value * multipliers[k], 0));
    const given = columns.reduce((sum, c, k) => sum + c[stick] * u[k], 0);
    const largest = Math.max(...u.map(Math.abs), 1e-9);
    return given < POSSIBLE ? u.map(() => 0) : u.map((value) => value / largest);
  });
}

/** Commands of all thrusters for some sticks, within -1..1. @param {number[][]} rows @param {Sticks} sticks */
export function mixed(rows, sticks) {
  const u = rows[0].map((_, k) => rows.reduce((sum, row, stick) => sum + row[k] * sticks[stick], 0));
  const most = Math.max(1, ...u.map(Math.abs));
  return u.map((value) => value / most);
}

/**
 * Angle of a fin, -1 to 1 of its range, that turns a vehicle which makes way ahead as the sticks say.
 * @param {Actuator} fin @param {Sticks} sticks
 */
export function deflection(fin, sticks) {
  const force = cross(fin.axis ?? [0, 1, 0], fin.chord ?? [1, 0, 0]);
  const [roll, pitch, yaw] = cross(fin.p, force);
  const size = Math.hypot(pitch, yaw) || 1;
  // A vehicle that makes way goes down by its bow.
  const wanted = [sticks[3], sticks[4] - sticks[2], sticks[5]];
  const rolling = Math.abs(roll) > 0.02 ? 0.5 * Math.sign(roll) * wanted[0] : 0;
  return Math.max(-1, Math.min(1, (pitch * wanted[1] + yaw * wanted[2]) / size + rolling));
}

/**
 * Everything that a vehicle without autopilot is told.
 * @param {string} vehicle @param {Port[]} ports @param {Actuator[]} actuators @param {Sticks} sticks
 * @returns {[port: string, value: Record<string, unknown>][]}
 */
export function commands(vehicle, ports, actuators, sticks) {
  /** @type {[string, Record<string, unknown>][]} */
  const list = [];
  const mine = ports.filter((port) => port.direction === "actuator" && port.path.startsWith(`${vehicle}/`));
  const thrusters = mine.find((port) => port.propulsors?.length && port.fields[0].shape.length);
  if (thrusters) list.push([thrusters.path, { [thrusters.fields[0].name]: mixed(patterns(thrusters.propulsors ?? []), sticks) }]);
  for (const port of mine) {
    const field = port.fields[0];
    if (!field) continue;
    const high = typeof field.maximum === "number" ? field.maximum : 0;
    const low = typeof field.minimum === "number" ? field.minimum : -high;
    if (actuators.some((actuator) => actuator.kind === "propeller" && actuator.port === port.path)) list.push([port.path, { [field.name]: sticks[0] >= 0 ? sticks[0] * high : -sticks[0] * low }]);
    const fins = actuators.filter((actuator) => actuator.kind === "fin" && actuator.port === port.path);
    if (!fins.length) continue;
    const angles = fins.sort((a, b) => (a.index ?? 0) - (b.index ?? 0)).map((fin) => {
      const part = deflection(fin, sticks);
      return part >= 0 ? part * (fin.high ?? 0) : -part * (fin.low ?? 0);
    });
    list.push([port.path, { [field.name]: field.shape.length ? angles : angles[0] }]);
  }
  return list;
}
