// Missions: way-points in N, as the autopilot takes them, and as QGroundControl keeps them in a .plan file.
/** A place to go to: m, down or above the bottom as `height` says. @typedef {{north: number, east: number, height: "depth" | "altitude", metres: number, hold: number}} Waypoint */
/** @typedef {{waypoints: Waypoint[], speed: number | null}} Mission */
/** @typedef {{latitude: number, longitude: number}} Origin rad */

export const LARGEST_FILE = 1 << 20;
const MOST = 700;
const FARTHEST_M = 100_000;
const [WAYPOINT, CHANGE_SPEED] = [16, 178];
/** Frames of MAVLink: altitude above home, which is the surface here; above the sea, and above home, by all their numbers; above the ground. */
const [RELATIVE, TERRAIN] = [3, 10];
const [BY_DEPTH, BY_ALTITUDE] = [[0, 5, RELATIVE, 6], [TERRAIN, 11]];
/** Of QGroundControl: how an altitude is meant, in a plan and in an item. */
const [MIXED, MODE_RELATIVE, MODE_TERRAIN] = [0, 1, 4];
const DEG = 180 / Math.PI;

/** Radii of curvature of WGS84, m: along the meridian and across it. @param {number} latitude rad */
function radii(latitude) {
  const [a, e2] = [6378137, 6.69437999014e-3];
  const w = 1 - e2 * Math.sin(latitude) ** 2;
  return [(a * (1 - e2)) / w ** 1.5, a / Math.sqrt(w)];
}

/** Items for `set_mission`. @param {Mission} mission */
export function items({ waypoints, speed }) {
  return [
    ...(speed === null ? [] : [{ kind: "speed", speed_mps: speed }]),
    ...waypoints.map(({ north, east, height, metres, hold }) => ({
      kind: "waypoint", ...(height === "altitude" ? { position_ne_m: [north, east], altitude_m: metres } : { position_ned_m: [north, east, metres] }), ...(hold > 0 ? { hold_s: hold } : {}),
    })),
  ];
}

/** The same back; what is no way-point or speed is left out and counted. @param {any[]} list @returns {Mission & {left: number}} */
export function mission(list) {
  const waypoints = list.filter(({ kind }) => kind === "waypoint").map((item) => {
    const [north, east, depth = item.depth_m] = item.position_ned_m ?? item.position_ne_m;
    const height = /** @type {Waypoint["height"]} */ (item.altitude_m === undefined ? "depth" : "altitude");
    return { north, east, height, metres: item.altitude_m ?? depth, hold: item.hold_s ?? 0 };
  });
  const speeds = list.filter(({ kind }) => kind === "speed");
  return { waypoints, speed: speeds[0]?.speed_mps ?? null, left: list.length - waypoints.length - Math.min(1, speeds.length) };
}

/** A .plan file. @param {Mission} mission @param {Origin} origin @returns {string} */
export function written({ waypoints, speed }, origin) {
  const [along, across] = radii(origin.latitude);
  const [lat0, lon0] = [origin.latitude * DEG, origin.longitude * DEG];
  const simple = (/** @type {number} */ id, /** @type {number} */ command, /** @type {(number | null)[]} */ params, /** @type {object} */ more = {}) => ({ autoContinue: true, command, doJumpId: id, frame: 2, params, type: "SimpleItem", ...more });
  const speeds = speed === null ? [] : [simple(1, CHANGE_SPEED, [1, speed, -1, 0, 0, 0, 0])];
  const places = waypoints.map(({ north, east, height, metres, hold }, k) => {
    const [lat, lon] = [lat0 + (north / along) * DEG, lon0 + (east / (across * Math.cos(origin.latitude))) * DEG];
    const above = height === "altitude";
    const up = above ? metres : -metres;
    return simple(k + 1 + speeds.length, WAYPOINT, [hold, 0, 0, null, lat, lon, up], { frame: above ? TERRAIN : RELATIVE, AMSLAltAboveTerrain: null, Altitude: up, AltitudeMode: above ? MODE_TERRAIN : MODE_RELATIVE });
  });
  const above = waypoints.filter(({ height }) => height === "altitude").length;
  const meant = above === 0 ? MODE_RELATIVE : above === waypoints.length ? MODE_TERRAIN : MIXED;
  return JSON.stringify({
    fileType: "Plan", version: 1, groundStation: "QGroundControl",
    geoFence: { circles: [], polygons: [], version: 2 }, rallyPoints: { points: [], version: 2 },
    mission: { version: 2, firmwareType: 3, vehicleType: 12, cruiseSpeed: speed ?? 1, hoverSpeed: speed ?? 1, globalPlanAltitudeMode: meant, plannedHomePosition: [lat0, lon0, 0], items: [...speeds, ...places] },
  }, null, 2);
}

/**
 * Read a .plan file.
 * @param {string} text @param {Origin} origin
 * @returns {Mission & {left: number}} `left`: how many items are neither way-points nor speeds
 * @throws {Error} what is wrong, and where
 */
export function parsed(text, origin) {
  if (text.length > LARGEST_FILE) throw new Error("a plan has at most 1 MiB");
  let plan;
  try {
    plan = JSON.parse(text);
  } catch {
    throw new Error("this is no plan: it is no JSON");
  }
  const list = plan?.mission?.items;
  if (plan?.fileType !== "Plan" || !Array.isArray(list)) throw new Error("this is no plan of QGroundControl");
  if (list.length > MOST) throw new Error(`a mission has at most ${MOST} items, this one has ${list.length}`);
  const [along, across] = radii(origin.latitude);
  /** @type {Waypoint[]} */
  const waypoints = [];
  let [speed, left] = [/** @type {number | null} */ (null), 0];
  list.forEach((item, k) => {
    const params = Array.isArray(item?.params) ? item.params : [];
    if (item?.command === CHANGE_SPEED && Number.isFinite(params[1]) && params[1] > 0 && speed === null) {
      speed = params[1];
    } else if (item?.command === WAYPOINT) {
      const above = BY_ALTITUDE.includes(item.frame);
      if (!above && !BY_DEPTH.includes(item.frame)) throw new Error(`item ${k}: its altitude must be relative to home, to the sea or to the ground (frame ${RELATIVE}, 0 or ${TERRAIN}), not of frame ${item.frame}`);
      const [lat, lon, up] = [params[4], params[5], params[6]];
      if (![lat, lon, up].every((part) => typeof part === "number" && Number.isFinite(part))) throw new Error(`item ${k}: latitude, longitude and altitude must be numbers`);
      if (above && !(up > 0)) throw new Error(`item ${k}: ${up} m is no altitude above the ground`);
      const turn = lon / DEG - origin.longitude;
      const north = (lat / DEG - origin.latitude) * along;
      const east = Math.atan2(Math.sin(turn), Math.cos(turn)) * across * Math.cos(origin.latitude);
      if (Math.hypot(north, east) > FARTHEST_M) throw new Error(`item ${k}: it is ${Math.round(Math.hypot(north, east) / 1000)} km from this world's origin`);
      waypoints.push({ north, east, height: above ? "altitude" : "depth", metres: above ? up : Math.max(0, -up), hold: Number.isFinite(params[0]) ? Math.max(0, params[0]) : 0 });
    } else {
      left += 1;
    }
  });
  return { waypoints, speed, left };
}
