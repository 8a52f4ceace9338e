// A pilot's training: how the try goes, where it leads to, the best one so far; and the last try, kept frame by frame to be watched again.
import { figure, toast } from "../core/dom.js";
import { Timeline } from "../core/frames.js";
import { kept } from "../core/kept.js";
import { ignore } from "../core/link.js";
import { spoken } from "./words.js";
/** @typedef {import("../core/app.js").App} App @typedef {import("../types").Frame} Frame */
/** How a try went. @typedef {{score: number, time: number, state: string}} Result */

const PERIOD_S = 0.05;
/** Frames that are kept of a try; of a longer one the last ones. */
const MOST = 20_000;
const KEPT = "uwserver.training.";

/** @param {unknown} found names with commas, as the port tells them @returns {string[]} */
export function names(found) {
  return typeof found === "string" && found ? found.split(", ") : [];
}

/** A try that is watched again: what `Timeline` is to the present. */
export class Rerun {
  /** @param {Frame[]} frames at least one */
  constructor(frames) {
    this.frames = frames;
    this.from = frames[0].t;
    this.to = frames[frames.length - 1].t;
    this.timeline = new Timeline();
    this.playing = true;
    this.t = this.from;
    this.last = NaN;
  }

  /** Go to a time. @param {number} t s of simulation */
  seek(t) {
    this.t = Math.max(this.from, Math.min(this.to, t));
    this.timeline.breaks += 1;
  }

  /** Work out what to show. @param {number} now wall time, s */
  at(now) {
    if (this.playing && now > this.last) this.t = Math.min(this.to, this.t + Math.min(0.25, now - this.last));
    this.last = now;
    if (this.t >= this.to) this.playing = false;
    let [low, high] = [0, this.frames.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.frames[middle].t <= this.t) low = middle;
      else high = middle - 1;
    }
    this.timeline.between(this.frames[low], this.frames[Math.min(low + 1, this.frames.length - 1)], this.t);
  }
}

/** Follows the training of the chosen vehicle. */
export class Training {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** Path of its port; empty where there is none. */
    this.path = "";
    /** Last sample. @type {Record<string, any>} */
    this.state = {};
    /** Of the try that goes on. @type {Frame[]} */
    this.frames = [];
    /** The try that ended last. @type {(Result & {frames: Frame[]}) | null} */
    this.ended = null;
    /** @type {Rerun | null} */
    this.rerun = null;
    this.breaks = -1;
    this.unfollow = ignore;
    app.on("chosen", () => this.follow());
    app.on("described", () => this.follow());
  }

  follow() {
    const path = this.app.description?.ports.find((port) => port.message === "Training" && port.direction === "sensor" && port.path.startsWith(this.app.prefix))?.path ?? "";
    if (path === this.path && path) return;
    this.unfollow();
    this.unfollow = ignore;
    Object.assign(this, { path, state: {}, frames: [], ended: null, rerun: null });
    if (path) this.unfollow = this.app.link.subscribe(path, 5, (sample) => this.hear(sample.value));
    this.app.emit("training");
  }

  /** Where to go now, in N. @returns {number[] | null} */
  get goal() {
    const { goal_p_NB: goal, state } = this.state;
    return (state === "ready" || state === "running") && Array.isArray(goal) && goal.every(Number.isFinite) ? goal : null;
  }

  /** The best try of this browser. @returns {Result | null} */
  get best() {
    try {
      const found = JSON.parse(kept.always.get(this.key) ?? "null");
      return typeof found?.score === "number" && typeof found?.time === "number" ? found : null;
    } catch {
      return null;
    }
  }

  get key() {
    return `${KEPT}${this.app.world?.scenario ?? ""}.${this.path}`;
  }

  /** Mark what the camera shows: the judge knows whether it is a finding. */
  mark() {
    if (this.state.state !== "running" || !this.state.marks || this.rerun) return;
    this.app.link.call(`${this.path}/set`, { mark: true }).catch((/** @type {Error} */ error) => toast(error.message, "bad"));
  }

  /** What was found, and what a mark cost. @param {Record<string, any>} before @param {Record<string, any>} value */
  praise(before, value) {
    if (before.state !== "running") return;
    if (value.number > before.number) {
      toast(`Done: ${before.task}`, "good");
      return;
    }
    const there = names(before.found);
    for (const name of names(value.found)) if (!there.includes(name)) toast(`${spoken(name)}: ${value.marks ? "marked" : "inspected"}`, "good");
    if (value.lost > before.lost) toast(`There is nothing to mark here: ${figure(before.lost - value.lost, 0)} points`, "bad");
  }

  /** @param {Record<string, any>} value */
  hear(value) {
    const before = this.state.state;
    this.praise(this.state, value);
    this.state = value;
    const ends = before === "running" && (value.state === "done" || value.state === "failed");
    // Begun anew, ended by hand or by a reset of the world: what was flown can be watched all the same.
    const cut = before === "running" && (value.state === "ready" || value.state === "off");
    if ((ends || cut) && this.frames.length > 1) this.end({ score: Number(value.score), time: Number(value.time), state: cut ? "broken off" : value.state }, cut);
    if (value.state !== "running") this.frames = [];
    this.app.emit("training");
  }

  /** @param {Result} result @param {boolean} cut */
  end(result, cut) {
    this.ended = { ...result, frames: this.frames };
    const { best } = this;
    if (!cut && (best === null || result.score > best.score) && !this.app.status.playback) kept.always.set(this.key, JSON.stringify(result));
  }

  /** Keep a frame of the present. @param {Frame} frame */
  keep(frame) {
    if (this.state.state !== "running") return;
    const last = this.frames.at(-1);
    if (last && frame.t < last.t) return;
    if (last && (frame.t - last.t < PERIOD_S || frame.count !== last.count)) return;
    this.frames.push(frame);
    if (this.frames.length > MOST) this.frames.shift();
  }

  /** Watch the try that ended last, or the present again. @param {boolean} on */
  watch(on) {
    this.rerun = on && this.ended ? new Rerun(this.ended.frames) : null;
    this.app.timeline.breaks += 1;
    this.app.emit("training");
  }

  /** What the page shows now: the present, or the try that is watched. @param {number} now wall time, s @returns {Timeline | null} null while there is nothing */
  shown(now) {
    const { timeline } = this.app;
    const there = timeline.at(now);
    // Whoever begins anew looks at that.
    if (this.rerun && this.state.state === "running") this.watch(false);
    if (!this.rerun) return there ? timeline : null;
    this.rerun.at(now);
    return this.rerun.timeline;
  }
}
