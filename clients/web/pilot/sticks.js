// What the pilot's hands do: keys that are held, and a gamepad's sticks. Nothing is held once the page loses the focus.
import { kept } from "../core/kept.js";
/** @typedef {import("./allocation.js").Sticks} Sticks */

export const AXES = /** @type {const} */ (["surge", "sway", "heave", "roll", "pitch", "yaw"]);

/** Keys by their place on the keyboard (`KeyboardEvent.code`), so that any layout has them side by side: which stick, and which way. @type {Record<string, [number, number]>} */
export const KEYS = {
  KeyW: [0, 1], KeyS: [0, -1], KeyE: [1, 1], KeyQ: [1, -1], KeyF: [2, 1], KeyR: [2, -1], KeyD: [5, 1], KeyA: [5, -1],
};
const SLOW = 0.35;
const RISE_S = 0.18;

/** Whether somebody writes a text there. @param {EventTarget | null} target */
export function writes(target) {
  return target instanceof HTMLElement && (target.isContentEditable || /^(INPUT|TEXTAREA|SELECT)$/.test(target.tagName));
}

/** Keys that are held down. */
export class Keyboard {
  /** @param {(code: string) => boolean} onKey a key that is no stick; says whether it was taken */
  constructor(onKey) {
    /** @type {Set<string>} */
    this.held = new Set();
    this.slow = false;
    this.values = new Float64Array(6);
    addEventListener("keydown", (event) => {
      if (writes(event.target) || event.ctrlKey || event.metaKey || event.altKey) return;
      this.slow = event.shiftKey;
      if (event.code in KEYS) {
        this.held.add(event.code);
        event.preventDefault();
      } else if (!event.repeat && onKey(event.code)) {
        event.preventDefault();
      }
    });
    addEventListener("keyup", (event) => {
      this.slow = event.shiftKey;
      this.held.delete(event.code);
    });
    const release = () => this.release();
    addEventListener("blur", release);
    document.addEventListener("visibilitychange", () => document.hidden && release());
    document.addEventListener("focusin", (event) => writes(event.target) && release());
  }

  release() {
    this.held.clear();
    this.values.fill(0);
  }

  /** Move towards what the keys say. @param {number} dt s @returns {Float64Array} */
  read(dt) {
    const wanted = new Float64Array(6);
    for (const code of this.held) {
      const [axis, way] = KEYS[code];
      wanted[axis] += way * (this.slow ? SLOW : 1);
    }
    const step = dt / RISE_S;
    for (let k = 0; k < 6; k += 1) {
      const off = wanted[k] - this.values[k];
      this.values[k] = wanted[k] === 0 ? 0 : this.values[k] + Math.sign(off) * Math.min(Math.abs(off), step);
    }
    return this.values;
  }
}

/** Which axis of a gamepad is which stick, and whether it is turned round. @typedef {{axes: [number, number][], buttons: Record<string, string>}} Mapping */

/** For pads of the standard layout: left stick heave and yaw, right stick surge and sway, as ROV pilots have it. @returns {Mapping} */
export function usual() {
  return { axes: [[3, -1], [2, 1], [1, 1], [-1, 1], [-1, 1], [0, 1]], buttons: { 0: "depth_hold", 1: "stop", 2: "stabilise", 3: "position_hold", 9: "take", 8: "give", 12: "tilt_up", 13: "tilt_down" } };
}

const DEAD = 0.08;
const EXPO = 0.3;
const KEPT = "uwserver.gamepad.";

/** @param {number} raw -1..1 */
export function shaped(raw) {
  const size = Math.abs(raw);
  if (!(size > DEAD)) return 0;
  const x = Math.min(1, (size - DEAD) / (1 - DEAD));
  return Math.sign(raw) * ((1 - EXPO) * x + EXPO * x * x * x);
}

/** The first gamepad on which a button was pressed: browsers show none before. */
export class Pad {
  /** @param {(action: string) => void} onAction @param {() => void} onChange a pad came or went */
  constructor(onAction, onChange) {
    this.onAction = onAction;
    this.values = new Float64Array(6);
    this.pressed = new Set();
    /** Actions of buttons that are held. @type {Set<string>} */
    this.held = new Set();
    this.id = "";
    /** @type {Mapping} */
    this.mapping = usual();
    /** Which stick waits for an axis to move; -1 for none. */
    this.learning = -1;
    /** @type {number[]} */
    this.rest = [];
    this.onChange = onChange;
    addEventListener("gamepadconnected", () => this.read());
    addEventListener("gamepaddisconnected", () => this.read());
  }

  /** @returns {Gamepad | null} */
  get pad() {
    const pads = [...navigator.getGamepads()].filter((pad) => pad !== null);
    return pads.find((pad) => pad.mapping === "standard") ?? pads[0] ?? null;
  }

  /** @returns {Float64Array} */
  read() {
    const pad = this.pad;
    const id = pad?.id ?? "";
    if (id !== this.id) {
      this.id = id;
      this.mapping = remembered(id) ?? usual();
      this.pressed.clear();
      this.onChange();
    }
    this.values.fill(0);
    this.held.clear();
    if (!pad || document.hidden || !document.hasFocus()) return this.values;
    if (this.learning >= 0) this.learn(pad);
    this.mapping.axes.forEach(([axis, way], stick) => {
      if (axis >= 0) this.values[stick] = shaped(way * (pad.axes[axis] ?? 0));
    });
    pad.buttons.forEach((button, k) => {
      const action = this.mapping.buttons[k];
      if (button.pressed && action) this.held.add(action);
      if (button.pressed && !this.pressed.has(k) && action) this.onAction(action);
      if (button.pressed) this.pressed.add(k);
      else this.pressed.delete(k);
    });
    return this.values;
  }

  /** The next axis that moves far becomes this stick; moved the positive way. @param {number} stick */
  begin(stick) {
    this.learning = stick;
    this.rest = [...(this.pad?.axes ?? [])];
  }

  /** @param {Gamepad} pad */
  learn(pad) {
    const axis = pad.axes.findIndex((value, k) => Math.abs(value - (this.rest[k] ?? 0)) > 0.6);
    if (axis < 0) return;
    this.mapping.axes[this.learning] = [axis, Math.sign(pad.axes[axis] - (this.rest[axis] ?? 0)) || 1];
    this.learning = -1;
    kept.always.set(KEPT + this.id, JSON.stringify(this.mapping));
    this.onChange();
  }

  forget() {
    kept.always.forget(KEPT + this.id);
    this.mapping = usual();
    this.onChange();
  }
}

/** @param {string} id @returns {Mapping | null} */
function remembered(id) {
  try {
    const found = JSON.parse(kept.always.get(KEPT + id) ?? "null");
    return found && Array.isArray(found.axes) && found.axes.length === 6 && found.buttons ? found : null;
  } catch {
    return null;
  }
}
