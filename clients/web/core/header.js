// The bars above and below: time and its controls, theme, and how well the server does.
import { byId, h, symbol, tell, toast } from "./dom.js";
import { RecordButton } from "./recording.js";
import { kept } from "./kept.js";
/** @typedef {import("./app.js").App} App */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20];

/** @param {number} t s */
export function clock(t) {
  const minutes = Math.floor(t / 60);
  const rest = (t - 60 * minutes).toFixed(1).padStart(4, "0");
  return minutes >= 60 ? `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}` : `${minutes}:${rest}`;
}

/** Header and footer. */
export class Bars {
  /** @param {App} app @param {import("../pilot/pilot.js").Pilot} pilot */
  constructor(app, pilot) {
    this.app = app;
    this.title = h("span", { class: "title" });
    this.clock = h("span", { class: "clock", "aria-label": "Simulation time" }, "0:00.0");
    this.plays = h("span", { class: "plays", hidden: true, title: "A recording plays" });
    this.record = new RecordButton(app);
    this.pause = h("button", { class: "icon live", onclick: () => this.act(app.status.paused ? "world/resume" : "world/pause") });
    this.step = h("button", { class: "icon live", title: "One tick (while paused)", "aria-label": "One tick", onclick: () => this.act("world/step", { n: 1 }) }, symbol("step"));
    this.speed = h("select", { class: "live", "aria-label": "Speed of time", title: "Simulated seconds a second", onchange: () => this.act("world/set_speed", { speed: Number(this.speed.value) }) },
      ...SPEEDS.map((speed) => h("option", { value: speed }, `${speed} ×`)));
    this.reset = h("button", { class: "icon live", title: "Reset the world", "aria-label": "Reset the world", onclick: () => this.act("world/reset") }, symbol("reset"));
    this.save = h("button", { class: "icon optional live", title: "Keep this moment", "aria-label": "Keep this moment", onclick: () => this.act("world/snapshot", { name: "page" }, "Moment kept") }, symbol("save"));
    this.back = h("button", { class: "icon optional live", title: "Back to the moment kept", "aria-label": "Back to the moment kept", onclick: () => this.act("world/restore", { name: "page" }) }, symbol("back"));
    this.stop = h("button", { class: "stop live", title: "All stop (Space)", onclick: () => pilot.stop() }, "ALL STOP");
    this.theme = h("button", { class: "icon", title: "Light or dark", "aria-label": "Light or dark", onclick: () => this.turnTheme() }, symbol("sun"));
    this.dock = h("button", { class: "icon", title: "Panels (P)", "aria-label": "Panels", onclick: () => this.turnDock() }, symbol("dock"));
    this.share = h("button", { class: "icon optional", title: "Copy a link to this view", "aria-label": "Copy a link to this view", onclick: () => this.copy() }, symbol("link"));
    byId("header").append(h("div", { class: "brand" }, h("img", { src: "favicon.svg", alt: "" }), h("span", { class: "optional" }, "uwserver"), this.title), h("span", { class: "grow" }), this.plays, this.record.element, this.clock,
      h("div", { class: "group" }, this.pause, this.step, this.speed, this.reset, this.save, this.back), h("div", { class: "group" }, this.stop), h("div", { class: "group" }, this.share, this.theme, this.dock));
    this.parts = Object.fromEntries(["link", "factor", "late", "frames", "bytes", "pages", "quality"].map((name) => [name, h("b", {}, "–")]));
    const item = (/** @type {string} */ label, /** @type {string} */ name, optional = false) => h("span", { class: optional ? "optional" : "" }, `${label} `, this.parts[name]);
    this.dot = h("span", { class: "dot away" }, this.parts.link);
    this.factor = item("real time", "factor");
    byId("footer").append(this.dot, this.factor, item("late p99", "late", true), item("frames/s", "frames"), item("kB/s", "bytes", true), item("pages", "pages", true), h("span", { class: "grow" }), item("quality", "quality", true));
    app.on("status", () => this.show());
    app.on("world", () => this.show());
    app.on("link", () => this.show());
    const theme = app.address.get("theme") ?? kept.always.get("uwserver.theme") ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
    document.documentElement.dataset.theme = theme === "light" ? "light" : "dark";
    if (app.address.get("dock") === "off" || (innerWidth <= 900 && app.address.get("dock") === null)) byId("main").classList.add("wide");
    this.frames = 0;
    this.measured = { at: performance.now(), frames: 0, bytes: 0 };
    setInterval(() => this.measure(), 1000);
    this.show();
  }

  /** @param {string} service @param {Record<string, unknown>} [args] @param {string} [done] */
  async act(service, args = {}, done = "") {
    try {
      await this.app.link.call(service, args);
      if (done) toast(done, "good");
    } catch (error) {
      toast(/** @type {Error} */ (error).message, "bad");
    }
  }

  turnTheme() {
    const theme = document.documentElement.dataset.theme === "light" ? "dark" : "light";
    document.documentElement.dataset.theme = theme;
    kept.always.set("uwserver.theme", theme);
    if (this.app.address.get("theme") !== null) this.app.address.set("theme", theme);
    this.app.emit("theme");
  }

  turnDock() {
    const wide = byId("main").classList.toggle("wide");
    this.app.address.set("dock", wide ? "off" : innerWidth <= 900 ? "on" : null);
    dispatchEvent(new Event("resize"));
  }

  async copy() {
    try {
      await navigator.clipboard.writeText(location.href);
      toast("Link copied", "good");
    } catch {
      toast(location.href);
    }
  }

  show() {
    const { app } = this;
    const { status } = app;
    const title = app.world ? app.world.title || app.world.scenario : "connecting …";
    tell(this.title, title);
    document.title = app.world ? `${app.world.scenario || title} · uwserver` : "uwserver";
    const paused = Boolean(status.paused);
    if (this.pause.dataset.now !== String(paused)) {
      this.pause.dataset.now = String(paused);
      this.pause.replaceChildren(symbol(paused ? "play" : "pause"));
      this.pause.title = paused ? "Go on (K)" : "Pause (K)";
      this.pause.setAttribute("aria-label", paused ? "Go on" : "Pause");
    }
    const barred = !app.connected || Boolean(app.world?.read_only);
    for (const control of [this.pause, this.speed, this.reset, this.save, this.back]) control.disabled = barred;
    this.step.disabled = barred || !paused;
    this.plays.hidden = !status.playback;
    tell(this.plays, status.playback ? `plays ${status.playback.file}` : "");
    this.record.show(barred);
    if (document.activeElement !== this.speed && typeof status.speed === "number") {
      const speed = String(status.speed);
      if (![...this.speed.options].some((option) => option.value === speed)) this.speed.append(h("option", { value: speed }, `${speed} ×`));
      this.speed.value = speed;
    }
    this.dot.classList.toggle("away", !app.connected);
    tell(this.parts.link, app.connected ? (status.mode ?? "connected") : "no connection");
    const factor = status.real_time_factor;
    tell(this.parts.factor, paused ? "paused" : typeof factor === "number" ? `${factor.toFixed(2)} ×` : "–");
    this.factor.classList.toggle("late", typeof factor === "number" && !paused && factor < 0.95 * (status.speed ?? 1));
    tell(this.parts.late, typeof status.lateness_p99 === "number" ? `${(1000 * status.lateness_p99).toFixed(1)} ms` : "–");
    tell(this.parts.pages, String(status.pages ?? "–"));
  }

  measure() {
    const now = performance.now();
    const span = (now - this.measured.at) / 1000;
    tell(this.parts.frames, ((this.frames - this.measured.frames) / span).toFixed(0));
    tell(this.parts.bytes, ((this.app.link.bytes - this.measured.bytes) / span / 1000).toFixed(1));
    this.measured = { at: now, frames: this.frames, bytes: this.app.link.bytes };
  }

  /** @param {number} t s */
  tick(t) {
    this.frames += 1;
    tell(this.clock, clock(t));
  }

  /** @param {string} text */
  quality(text) {
    tell(this.parts.quality, text);
  }
}
