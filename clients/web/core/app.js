// What all parts of the page share: connection, world, what is chosen; and who wants to hear when it changes.
import { Timeline } from "./frames.js";
/** @typedef {import("../types").World} World @typedef {import("../types").Description} Description @typedef {import("../types").Status} Status @typedef {import("../types").Told} Told @typedef {import("../types").Service} Service @typedef {import("../types").Port} Port */
/** @typedef {"world" | "described" | "chosen" | "status" | "told" | "link" | "theme" | "layers" | "panels" | "pilot" | "training" | "view"} Change */

/** Shared state of a page. */
export class App {
  /** @param {import("./address.js").Address} address */
  constructor(address) {
    this.address = address;
    this.timeline = new Timeline();
    /** @type {import("./link.js").Link} */
    this.link = /** @type {any} */ (null);
    /** @type {World | null} */
    this.world = null;
    /** @type {Description | null} */
    this.description = null;
    /** @type {Status} */
    this.status = {};
    /** Events, the newest first. @type {Told[]} */
    this.told = [];
    this.connected = false;
    /** Which body is followed, among vehicles and objects. */
    this.chosen = 0;
    /** @type {Set<import("../scene/layers.js").Layer>} */
    this.layers = new Set();
    /** @type {Map<Change, Set<() => void>>} */
    this.listeners = new Map();
  }

  /** @param {Change} change @param {() => void} listener @returns {() => void} ends it */
  on(change, listener) {
    const there = this.listeners.get(change) ?? new Set();
    this.listeners.set(change, there.add(listener));
    return () => there.delete(listener);
  }

  /** @param {Change} change */
  emit(change) {
    for (const listener of [...(this.listeners.get(change) ?? [])]) listener();
  }

  /** Something has happened. @param {Told} told */
  tell(told) {
    this.told.unshift(told);
    this.told.length = Math.min(this.told.length, 500);
    this.emit("told");
  }

  /** Vehicles and free objects, in the order of the frames. */
  get bodies() {
    return this.world ? [...this.world.vehicles, ...this.world.objects] : [];
  }

  /** Name of the chosen vehicle; empty for an object or none. */
  get vehicle() {
    return this.world?.vehicles[this.chosen]?.name ?? "";
  }

  /** @param {number} index */
  choose(index) {
    if (index === this.chosen || index < 0 || index >= this.bodies.length) return;
    this.chosen = index;
    this.address.set("vehicle", index === 0 ? null : this.bodies[index].name);
    this.emit("chosen");
  }

  /** @param {string} path */
  port(path) {
    return this.description?.ports.find((port) => port.path === path);
  }

  /** @param {string} path */
  service(path) {
    return this.description?.services.find((service) => service.path === path);
  }

  /** Ports and services of the chosen vehicle begin with this. */
  get prefix() {
    return `${this.vehicle}/`;
  }

  /** Value of a colour of the theme. @param {string} name */
  colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  }
}
