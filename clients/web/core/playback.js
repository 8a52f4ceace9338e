// The line of time of a recording that is played: where it stands, its events, its range; hidden while the server is live.
import { byId, h, symbol, tell, toast } from "./dom.js";
import { clock } from "./header.js";
/** @typedef {import("./app.js").App} App @typedef {{ run: number, t_s: number, event: string, text: string }} Mark */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50, 100];
/** One frame of the page, s. */
const FRAME_S = 1 / 30;
const FAR_S = 5;
/** Marks that are drawn: more could not be told apart. */
const MOST_MARKS = 400;

/** Bar, buttons and keys of playback. */
export class Playback {
  /** @param {App} app @param {(service: string, args?: Record<string, unknown>) => Promise<void>} act */
  constructor(app, act) {
    this.app = app;
    this.act = act;
    /** @type {Mark[]} */
    this.marks = [];
    this.asked = "";
    /** Where the pointer wants to go, s; null when nowhere. @type {number | null} */
    this.wanted = null;
    this.seeking = false;
    this.t = 0;
    this.place = byId("playback");
    this.toggle = h("button", { class: "icon", onclick: () => this.turn() });
    this.time = h("span", { class: "now" });
    this.length = h("span", { class: "length" });
    this.range = h("div", { class: "range" });
    this.ticks = h("div", { class: "ticks" });
    this.head = h("div", { class: "head" });
    this.bar = h("div", { class: "bar", role: "slider", tabindex: "0", "aria-label": "Time of the recording" }, this.range, this.ticks, this.head);
    this.speed = h("select", { "aria-label": "Speed of playback", title: "Speed ([ and ])", onchange: () => this.setSpeed(Number(this.speed.value)) },
      ...SPEEDS.map((speed) => h("option", { value: speed }, `${speed} ×`)), h("option", { value: 0 }, "max"));
    this.from = h("button", { title: "The range begins here", onclick: () => this.setRange({ from_s: this.t }) }, "A");
    this.to = h("button", { title: "The range ends here", onclick: () => this.setRange({ to_s: this.t }) }, "B");
    this.whole = h("button", { class: "icon", title: "Play all of it", "aria-label": "Play all of it", onclick: () => this.setRange({ from_s: 0, to_s: 1e9 }) }, symbol("close"));
    this.loop = h("button", { title: "Again and again", "aria-label": "Again and again", onclick: () => this.setRange({ on: !this.now?.loop }) }, symbol("reset"));
    this.place.append(this.toggle, this.time, this.bar, this.length, this.speed, h("div", { class: "group" }, this.from, this.to, this.whole, this.loop));
    this.bar.addEventListener("pointerdown", (event) => {
      this.bar.setPointerCapture(event.pointerId);
      this.want(event.clientX);
    });
    this.bar.addEventListener("pointermove", (event) => { if (this.bar.hasPointerCapture(event.pointerId)) this.want(event.clientX); });
    this.bar.addEventListener("pointerup", () => { this.wanted = this.seeking ? this.wanted : null; });
    // Before all others: what steers a vehicle steers time here.
    addEventListener("keydown", (event) => this.key(event), true);
    app.on("status", () => this.show());
    app.on("told", () => { if (this.now?.growing) this.asked = ""; });
    app.on("link", () => { this.asked = ""; });
  }

  /** What the server says of it; undefined while it is live. */
  get now() {
    return this.app.status.playback ?? undefined;
  }

  turn() {
    void this.act(this.app.status.paused ? "playback/resume" : "playback/pause");
  }

  /** @param {number} speed */
  setSpeed(speed) {
    void this.act("playback/speed", { speed });
  }

  /** @param {{ on?: boolean, from_s?: number, to_s?: number }} range */
  setRange(range) {
    void this.act("playback/loop", { on: this.now?.loop ?? false, ...range });
  }

  /** The pointer is at this place of the screen. @param {number} x */
  want(x) {
    const { now } = this;
    if (!now) return;
    const box = this.bar.getBoundingClientRect();
    const part = Math.min(1, Math.max(0, (x - box.left) / box.width));
    this.seek(now.from_s + part * (now.to_s - now.from_s));
  }

  /** Go there; while a drag goes on, one request at a time, and the last wish wins. @param {number} t s */
  seek(t) {
    this.wanted = t;
    this.tick(t);
    if (!this.seeking) void this.follow();
  }

  async follow() {
    this.seeking = true;
    try {
      while (this.wanted !== null) {
        const t_s = Math.max(0, this.wanted);
        this.wanted = null;
        await this.app.link.call("playback/seek", { t_s });
      }
    } catch (error) {
      toast(/** @type {Error} */ (error).message, "bad");
    } finally {
      this.seeking = false;
      this.wanted = null;
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (!this.now || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target instanceof HTMLElement && /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName)) return;
    const step = event.shiftKey ? FAR_S : FRAME_S;
    if (event.code === "Space") { if (!event.repeat) this.turn(); }
    else if (event.code === "ArrowLeft") this.seek(Math.max(this.now.from_s, this.t - step));
    else if (event.code === "ArrowRight") this.seek(Math.min(this.now.to_s, this.t + step));
    else if (event.key === "[" || event.code === "BracketLeft") this.setSpeed(this.next(-1));
    else if (event.key === "]" || event.code === "BracketRight") this.setSpeed(this.next(1));
    else return;
    event.preventDefault();
    event.stopImmediatePropagation();
  }

  /** The next slower or faster speed. @param {1 | -1} way */
  next(way) {
    const speed = this.now?.speed || SPEEDS[SPEEDS.length - 1];
    const others = SPEEDS.filter((each) => (way > 0 ? each > speed * 1.001 : each < speed * 0.999));
    return (way > 0 ? others[0] : others.at(-1)) ?? speed;
  }

  show() {
    const { now, app } = this;
    this.place.hidden = !now;
    document.body.classList.toggle("plays", Boolean(now));
    if (!now) return;
    const paused = Boolean(app.status.paused);
    if (this.toggle.dataset.now !== String(paused)) {
      this.toggle.dataset.now = String(paused);
      this.toggle.replaceChildren(symbol(paused ? "play" : "pause"));
      this.toggle.title = paused ? "Play (Space)" : "Pause (Space)";
      this.toggle.setAttribute("aria-label", paused ? "Play" : "Pause");
    }
    tell(this.length, clock(now.to_s) + (now.runs > 1 ? ` (${now.run + 1}/${now.runs})` : ""));
    if (document.activeElement !== this.speed) {
      const speed = String(now.speed);
      if (![...this.speed.options].some((option) => option.value === speed)) this.speed.append(h("option", { value: speed }, `${speed} ×`));
      this.speed.value = speed;
    }
    this.loop.setAttribute("aria-pressed", String(now.loop));
    const [from, to] = now.range_s;
    this.range.hidden = from === null && to === null;
    this.range.style.left = `${100 * this.part(from ?? now.from_s)}%`;
    this.range.style.right = `${100 * (1 - this.part(to ?? now.to_s))}%`;
    this.tick(now.t_s);
    const about = `${now.file} ${now.run} ${now.to_s}`;
    if (about !== this.asked) void this.ask(about);
  }

  /** Events of the file. @param {string} about */
  async ask(about) {
    this.asked = about;
    try {
      const state = /** @type {{ marks: Mark[] }} */ (await this.app.link.call("playback/state"));
      this.marks = state.marks;
    } catch {
      return;
    }
    const run = this.now?.run ?? 0;
    const marks = this.marks.filter((mark) => mark.run === run).slice(0, MOST_MARKS);
    this.ticks.replaceChildren(...marks.map((mark) => {
      const tick = h("i", { class: mark.event, title: `${clock(mark.t_s)} ${mark.event}: ${mark.text}` });
      tick.style.left = `${100 * this.part(mark.t_s)}%`;
      return tick;
    }));
  }

  /** Where a time stands on the bar, 0 to 1. @param {number} t s */
  part(t) {
    const { now } = this;
    const span = now ? now.to_s - now.from_s : 0;
    return now && span > 0 ? Math.min(1, Math.max(0, (t - now.from_s) / span)) : 0;
  }

  /** Time has come here. @param {number} t s */
  tick(t) {
    if (!this.now) return;
    this.t = t;
    tell(this.time, clock(t));
    this.head.style.left = `${100 * this.part(t)}%`;
    this.bar.setAttribute("aria-valuenow", t.toFixed(1));
    this.bar.setAttribute("aria-valuemin", this.now.from_s.toFixed(1));
    this.bar.setAttribute("aria-valuemax", this.now.to_s.toFixed(1));
  }
}
