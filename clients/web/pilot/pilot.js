// Steering: who has the lease, what the sticks say, and where it is sent twenty times a second.
import { toast } from "../core/dom.js";
import { kept } from "../core/kept.js";
import { ignore } from "../core/link.js";
import { commands } from "./allocation.js";
import { AXES, Keyboard, Pad } from "./sticks.js";
/** @typedef {import("../core/app.js").App} App @typedef {import("./allocation.js").Sticks} Sticks */

const PERIOD_MS = 50;
const KEEP_MS = 500;
const GRACE_MS = 1200;
/** How long neutral sticks are still sent to a vehicle without autopilot. */
const SETTLE = 10;
/** Of the camera on board, rad and rad/s. */
const MOST_TILT = 0.9;
const TILT_RADPS = 0.6;
export const DIRECT = "direct";

/** The pilot of one page. */
export class Pilot {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.sticks = /** @type {Sticks} */ ([0, 0, 0, 0, 0, 0]);
    this.gain = Number(kept.always.get("uwserver.gain") ?? 0.8) || 0.8;
    this.tilt = 0;
    /** What the vehicle's mount was told last. */
    this.turned = 0;
    /** Last of the autopilot's state. @type {Record<string, unknown>} */
    this.state = {};
    this.asked = false;
    /** Until when a status may still be one from before the lease was taken, ms. */
    this.grace = 0;
    this.quiet = SETTLE;
    this.held = "";
    this.keyboard = new Keyboard((code) => this.key(code));
    this.pad = new Pad((action) => this.act(action), () => app.emit("pilot"));
    /** @type {() => void} */
    this.unfollow = ignore;
    app.on("chosen", () => this.follow());
    app.on("described", () => this.follow());
    app.on("status", () => this.notice());
    setInterval(() => this.tick(), PERIOD_MS);
    setInterval(() => this.keep(), KEEP_MS);
    addEventListener("pagehide", () => this.owns && this.app.link.notify("call", { service: "web/lease/give", args: {} }));
  }

  /** Who steers the chosen vehicle: `{page, owner}`, or null. */
  get owner() {
    return this.app.status.lease?.[this.app.vehicle] ?? null;
  }

  get owns() {
    return this.app.connected && this.held !== "" && this.held === this.app.vehicle;
  }

  get hasAutopilot() {
    return this.app.port(`${this.app.prefix}autopilot/pilot`) !== undefined;
  }

  get armed() {
    return this.state.armed === true;
  }

  /** The autopilot's mode, or "direct" where sticks go to the actuators. */
  get mode() {
    return this.hasAutopilot && this.armed ? String(this.state.mode ?? "") : DIRECT;
  }

  /** @returns {string[]} */
  get modes() {
    const argument = this.app.service(`${this.app.prefix}autopilot/set_mode`)?.arguments.find(({ name }) => name === "mode");
    return [DIRECT, ...(argument?.choices ?? [])];
  }

  /** Listen to the chosen vehicle's autopilot. */
  follow() {
    this.unfollow();
    this.unfollow = ignore;
    this.state = {};
    if (this.held && this.held !== this.app.vehicle) this.give();
    const path = `${this.app.prefix}autopilot/state`;
    if (this.app.port(path)) {
      this.unfollow = this.app.link.subscribe(path, 10, (sample) => {
        const before = `${this.state.mode} ${this.state.armed} ${this.state.failsafe}`;
        this.state = sample.value;
        if (before !== `${this.state.mode} ${this.state.armed} ${this.state.failsafe}`) this.app.emit("pilot");
      });
    }
    this.app.emit("pilot");
  }

  /** What the server says of leases. */
  notice() {
    const owner = this.app.status.lease?.[this.held];
    if (this.held && performance.now() > this.grace && (!owner || owner.page !== this.app.link.session)) {
      toast(owner ? `${owner.owner} steers ${this.held} now` : `you steer ${this.held} no more`, "bad");
      this.drop();
    }
    this.app.emit("pilot");
  }

  drop() {
    this.held = "";
    this.keyboard.release();
    this.sticks.fill(0);
    this.app.emit("pilot");
  }

  /** Why nobody can steer the chosen vehicle from here; empty where one can. */
  get barred() {
    const { app } = this;
    if (app.status.playback) return "A recording plays: nothing in it can be steered.";
    if (app.world?.read_only) return "This page may only watch.";
    if (app.vehicle && app.description && !app.description.ports.some((port) => port.direction === "actuator" && port.path.startsWith(app.prefix))) return `${app.vehicle} has no actuators: it is moved from elsewhere.`;
    return "";
  }

  /** Take the lease of the chosen vehicle. @param {boolean} [force] */
  async take(force = false) {
    const vehicle = this.app.vehicle;
    if (!vehicle || this.asked || this.owns) return this.owns;
    if (this.barred) {
      toast(this.barred, "bad");
      return false;
    }
    this.asked = true;
    try {
      await this.app.link.call("web/lease/take", { vehicle, force });
      this.held = vehicle;
      this.quiet = SETTLE;
      toast(`You steer ${vehicle}`, "good");
    } catch (error) {
      toast(/** @type {Error} */ (error).message, "bad");
    }
    this.asked = false;
    this.grace = performance.now() + GRACE_MS;
    this.app.emit("pilot");
    return this.owns;
  }

  give() {
    const vehicle = this.held;
    this.drop();
    if (vehicle) this.app.link.call("web/lease/give", { vehicle }).catch(ignore);
  }

  /** Everything stops, whoever steers. */
  async stop() {
    const vehicle = this.app.vehicle;
    this.drop();
    try {
      await this.app.link.call("web/stop", vehicle ? { vehicle } : {});
      toast("All stop", "good");
    } catch (error) {
      toast(/** @type {Error} */ (error).message, "bad");
    }
  }

  /** Another mode: arms the autopilot, or disarms it for "direct". @param {string} mode */
  async setMode(mode) {
    const { link, prefix } = this.app;
    if (!this.owns && !(await this.take())) return;
    try {
      if (mode === DIRECT) {
        await link.call(`${prefix}autopilot/disarm`);
      } else {
        await link.call(`${prefix}autopilot/set_mode`, { mode });
        if (!this.armed) await link.call(`${prefix}autopilot/arm`);
      }
    } catch (error) {
      toast(/** @type {Error} */ (error).message, "bad");
    }
  }

  /** Send it to a place. @param {number[]} place N */
  async goto(place) {
    const { link, prefix } = this.app;
    if (!this.owns && !(await this.take())) return;
    try {
      if (!this.armed) {
        await link.call(`${prefix}autopilot/set_mode`, { mode: "guided" });
        await link.call(`${prefix}autopilot/arm`);
      }
      toast(`Going to ${place.map((part) => part.toFixed(1)).join(", ")} m`);
      await link.call(`${prefix}autopilot/goto`, { position_ned_m: place });
      toast("Arrived", "good");
    } catch (error) {
      toast(/** @type {Error} */ (error).message, "bad");
    }
  }

  /** A key that is no stick. @param {string} code */
  key(code) {
    if (code === "Space") void this.stop();
    else if (code === "Enter" && !(document.activeElement instanceof HTMLButtonElement) && document.activeElement?.tagName !== "SUMMARY") void this.take();
    else if (code === "ArrowUp" && document.activeElement?.id === "scene") this.tiltBy(0.1);
    else if (code === "ArrowDown" && document.activeElement?.id === "scene") this.tiltBy(-0.1);
    else return false;
    return true;
  }

  /** Return the actuator of the chosen vehicle that takes a command with this field. @param {string} name */
  fitting(name) {
    return this.app.description?.ports.find((port) => port.direction === "actuator" && port.path.startsWith(this.app.prefix) && port.fields.some((field) => field.name === name));
  }

  /** Tilt the camera on board; of a vehicle that is steered from here the mount, too. @param {number} angle rad, up */
  tiltBy(angle) {
    this.tilt = this.tiltable(this.tilt + angle);
    this.turnMount();
  }

  /** What the chosen vehicle's camera can do of a tilt. @param {number} tilt rad */
  tiltable(tilt) {
    const { minimum, maximum } = this.mount?.fields[0] ?? {};
    return Math.max(minimum ?? -MOST_TILT, Math.min(maximum ?? MOST_TILT, tilt));
  }

  /** The port that tilts the camera of the chosen vehicle, where it has one. */
  get mount() {
    return this.fitting("tilt");
  }

  /** The vehicle's own camera looks where the page does. */
  turnMount() {
    const { mount } = this;
    if (!mount || !this.owns || this.app.status.paused) return;
    this.tilt = this.tiltable(this.tilt);
    this.app.link.notify("command", { port: mount.path, value: { tilt: this.tilt } });
    this.turned = this.tilt;
  }

  /** Lamps of the vehicle that is steered from here, on or off. @param {boolean} on */
  shine(on) {
    const lamps = this.fitting("levels");
    if (lamps && this.owns) this.app.link.notify("command", { port: lamps.path, value: { levels: Array(lamps.fields[0].shape[0]).fill(on ? 1 : 0) } });
  }

  /** A button of the gamepad. @param {string} action */
  act(action) {
    if (action === "stop") void this.stop();
    else if (action === "take") void this.take();
    else if (action === "give") this.give();
    else if (this.modes.includes(action)) void this.setMode(action);
  }

  tick() {
    const keys = this.keyboard.read(PERIOD_MS / 1000);
    const pad = this.pad.read();
    const up = Number(this.pad.held.has("tilt_up")) - Number(this.pad.held.has("tilt_down"));
    if (up) this.tiltBy((up * TILT_RADPS * PERIOD_MS) / 1000);
    AXES.forEach((_, k) => { this.sticks[k] = this.gain * Math.max(-1, Math.min(1, keys[k] + pad[k])); });
    const moves = this.sticks.some((value) => value !== 0);
    if (moves && !this.owns && this.app.vehicle && !this.owner && !this.barred) void this.take();
    if (!this.owns || this.app.status.paused) return;
    this.quiet = moves ? 0 : this.quiet + 1;
    if (this.armed) {
      this.app.link.notify("command", { port: `${this.app.prefix}autopilot/pilot`, value: { u: this.sticks } });
    } else if (this.quiet < SETTLE && this.app.description) {
      const body = this.app.world?.vehicles[this.app.chosen];
      for (const [port, value] of commands(this.app.vehicle, this.app.description.ports, body?.actuators ?? [], this.sticks)) this.app.link.notify("command", { port, value });
    }
  }

  keep() {
    if (!this.owns) return;
    this.app.link.notify("call", { service: "web/lease/keep", args: {} });
    // Again and again, as an all stop or a reset brings it back to rest.
    if (this.tilt || this.turned) this.turnMount();
  }
}
