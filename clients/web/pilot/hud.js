// What a pilot reads over the picture: heading, depth, attitude, altitude, battery, leak, autopilot.
import { byId, figure, h, s, tell } from "../core/dom.js";
import { euler, isNowhere } from "../core/frames.js";
/** @typedef {import("../core/app.js").App} App @typedef {import("./pilot.js").Pilot} Pilot @typedef {import("../types").Sample} Sample */

const DEG = 180 / Math.PI;
const STALE_MS = 3000;
const [ALTIMETER, DVL] = ["Range", "Dvl"];

/** Readings: label, field, standard message of the port (without one any port with the field), unit, digits, how it is judged. @type {{label: string, message?: string, field: string, unit: string, digits: number, mood?: (value: any) => "" | "warn" | "bad", text?: (value: any, all: Record<string, any>) => string, factor?: number}[]} */
const READINGS = [
  { label: "Altitude", message: ALTIMETER, field: "range", unit: "m", digits: 2, mood: (value) => (value < 0.5 ? "warn" : "") },
  { label: "DVL altitude", message: DVL, field: "altitude", unit: "m", digits: 2 },
  { label: "Battery", message: "BatteryState", field: "charge", unit: "%", digits: 0, factor: 100, mood: (value) => (value < 0.1 ? "bad" : value < 0.25 ? "warn" : "") },
  { label: "Training", message: "Training", field: "state", unit: "", digits: 0, text: trained, mood: (value) => (value === "failed" ? "bad" : "") },
  { label: "Tether", field: "tension", unit: "N", digits: 0 },
  { label: "Leak", message: "Leak", field: "leak", unit: "", digits: 0, text: (value) => (value ? "WET" : "dry"), mood: (value) => (value ? "bad" : "") },
];

/** Task, time and score of a pilot's training. @param {string} state @param {Record<string, any>} all */
function trained(state, all) {
  const [time, score] = [`${figure(all.time, 1)} s`, `${Math.round(all.score)} points`];
  if (state === "off") return "off";
  if (state === "done" || state === "failed") return `${state === "done" ? "done" : "time is over"} · ${time} · ${score}`;
  const held = all.hold > 0 && all.held > 0 ? ` (${figure(all.held, 0)} of ${figure(all.hold, 0)} s)` : "";
  const part = all.part > 0 ? `, ${figure(100 * all.part, 0)} %` : "";
  const hint = all.hint ? `: ${all.hint}` : "";
  return `${all.number}/${all.count} ${all.task}${part}${hint}${held} · ${state === "ready" ? "push to begin" : time} · ${score}`;
}

/** Gauges over the picture. */
export class Hud {
  /** @param {App} app @param {Pilot} pilot */
  constructor(app, pilot) {
    this.app = app;
    this.pilot = pilot;
    this.place = byId("hud");
    this.tape = headingTape();
    this.depth = depthTape();
    this.attitude = horizon();
    this.readings = h("div", { class: "readings" });
    this.banner = h("div", { class: "banner", hidden: true });
    // Where there is no room for the tape.
    this.deep = h("b", {}, "–");
    this.place.append(this.tape.root, this.depth.root, this.attitude.root, this.readings, this.banner);
    /** @type {(() => void)[]} */
    this.endings = [];
    app.on("chosen", () => this.listen());
    app.on("described", () => this.listen());
    app.on("pilot", () => this.tellOwner());
    app.on("status", () => this.tellOwner());
  }

  /** Show the readings of the chosen vehicle, each from the first sensor that has it. */
  listen() {
    for (const end of this.endings) end();
    this.endings = [];
    this.readings.replaceChildren(h("div", { class: "reading narrow" }, h("span", {}, "Depth"), this.deep));
    const { app } = this;
    const mine = app.description?.ports.filter((port) => port.direction === "sensor" && port.path.startsWith(app.prefix)) ?? [];
    const hasAltimeter = mine.some((port) => port.message === ALTIMETER);
    for (const reading of READINGS) {
      const port = mine.find((candidate) => (!reading.message || candidate.message === reading.message) && candidate.fields.some((field) => field.name === reading.field));
      if (!port || (reading.message === DVL && hasAltimeter)) continue;
      const value = h("b", {}, "–");
      const box = h("div", { class: "reading" }, h("span", {}, reading.label), value);
      this.readings.append(box);
      let seen = 0;
      this.endings.push(app.link.subscribe(port.path, 4, (sample) => {
        seen = performance.now();
        const raw = sample.value[reading.field];
        const number = typeof raw === "number" ? figure(raw * (reading.factor ?? 1), reading.digits) : "–";
        tell(value, raw === null || raw === undefined ? "–" : reading.text ? reading.text(raw, sample.value) : `${typeof raw === "number" ? (raw * (reading.factor ?? 1)).toFixed(reading.digits) : number} ${reading.unit}`);
        const mood = sample.valid && raw !== null ? (reading.mood?.(raw) ?? "") : "";
        box.className = `reading ${mood}`;
      }));
      const timer = setInterval(() => { if (performance.now() - seen > STALE_MS && !app.status.paused) tell(value, "–"); }, 1000);
      this.endings.push(() => clearInterval(timer));
    }
  }

  tellOwner() {
    const { pilot, app } = this;
    const owner = pilot.owner;
    const held = app.status.held?.includes(app.vehicle) ?? false;
    this.banner.hidden = !app.vehicle || (!owner && !pilot.owns && !held);
    this.banner.className = `banner ${pilot.owns ? "mine" : owner ? "theirs" : "held"}`;
    const waits = held ? " · held until the first command" : "";
    const failsafe = pilot.state.failsafe ? ` · ${pilot.state.failsafe}` : "";
    const mode = pilot.mode === "direct" ? "direct to the actuators" : pilot.mode.replace("_", " ");
    const who = pilot.owns ? `You steer ${app.vehicle} · ${mode}${failsafe}` : owner ? `${owner.owner} steers ${app.vehicle}` : app.vehicle;
    tell(this.banner, who + waits);
  }

  /** @param {Float32Array} poses @param {number} i of the chosen body's pose */
  update(poses, i) {
    const there = poses.length > i + 6 && Number.isFinite(poses[i]) && !isNowhere(poses, i);
    this.place.style.display = there ? "" : "none";
    if (!there) return;
    const { roll, pitch, yaw } = euler(poses, i + 3);
    const heading = (yaw * DEG + 360) % 360;
    const { state } = this.pilot;
    const armed = this.pilot.armed;
    this.tape.show(heading, armed && typeof state.heading_ref === "number" ? (state.heading_ref * DEG + 360) % 360 : null);
    this.depth.show(poses[i + 2], armed && typeof state.depth_ref === "number" ? state.depth_ref : null);
    tell(this.deep, `${poses[i + 2].toFixed(2)} m`);
    this.attitude.show(roll * DEG, pitch * DEG);
  }
}

/** Heading, 60 degrees to either side. */
function headingTape() {
  const wide = 320;
  const perDegree = wide / 120;
  const strip = s("g");
  const marks = Array.from({ length: 108 }, (_, k) => {
    const degrees = k * 5 - 90;
    const main = degrees % 30 === 0;
    const name = { 0: "N", 90: "E", 180: "S", 270: "W" }[((degrees % 360) + 360) % 360] ?? String(((degrees % 360) + 360) % 360);
    strip.append(s("line", { class: "tick", x1: degrees * perDegree, x2: degrees * perDegree, y1: main ? 22 : 27, y2: 33 }));
    if (main) strip.append(s("text", { x: degrees * perDegree, y: 17, "text-anchor": "middle" }, name));
    return degrees;
  });
  const wanted = s("path", { class: "want", d: "M-5 34l5-7 5 7z" });
  strip.append(wanted);
  const number = s("text", { class: "big", x: wide / 2, y: 52, "text-anchor": "middle" });
  const clip = s("clipPath", { id: "tape" }, s("rect", { width: wide, height: 35 }));
  const root = s("svg", { class: "heading", width: wide, height: 58, viewBox: `0 0 ${wide} 58` }, s("defs", {}, clip), s("rect", { class: "plate", width: wide, height: 35, rx: 7 }),
    s("g", { "clip-path": "url(#tape)" }, strip), s("path", { class: "bug", d: `M${wide / 2 - 6} 36l6-8 6 8z` }), s("rect", { class: "plate", x: wide / 2 - 28, y: 37, width: 56, height: 20, rx: 6 }), number);
  return {
    root,
    marks,
    /** @param {number} heading degrees @param {number | null} want */
    show(heading, want) {
      strip.setAttribute("transform", `translate(${(wide / 2 - heading * perDegree).toFixed(1)} 0)`);
      tell(number, `${Math.round(heading) % 360}°`.padStart(4, "0"));
      wanted.style.display = want === null ? "none" : "";
      if (want !== null) wanted.setAttribute("transform", `translate(${((heading + (((want - heading + 540) % 360) - 180)) * perDegree).toFixed(1)} 0)`);
    },
  };
}

/** Depth, three metres up and down. */
function depthTape() {
  const tall = 190;
  const strip = s("g");
  const per = tall / 6;
  const ticks = Array.from({ length: 17 }, () => {
    const line = s("line", { class: "tick", x1: 56, x2: 66 });
    const text = s("text", { x: 52, "text-anchor": "end" });
    strip.append(line, text);
    return { line, text };
  });
  const wanted = s("path", { class: "want", d: "M67 -5l-8 5 8 5z" });
  const number = s("text", { class: "big", x: 38, y: tall / 2 + 5, "text-anchor": "middle" });
  const root = s("svg", { class: "depth", width: 78, height: tall, viewBox: `0 0 78 ${tall}` }, s("defs", {}, s("clipPath", { id: "deep" }, s("rect", { width: 78, height: tall }))),
    s("rect", { class: "plate", width: 70, height: tall, rx: 7 }), s("g", { "clip-path": "url(#deep)" }, strip, wanted),
    s("rect", { class: "plate", x: 2, y: tall / 2 - 12, width: 66, height: 24, rx: 6, style: "fill:#06202c" }), number, s("text", { x: 8, y: -5 }, "DEPTH m"));
  return {
    root,
    /** @param {number} depth m @param {number | null} want */
    show(depth, want) {
      const first = Math.floor((depth - 3.5) * 2) / 2;
      ticks.forEach(({ line, text }, k) => {
        const value = first + k / 2;
        const y = tall / 2 + (value - depth) * per;
        line.setAttribute("y1", y.toFixed(1));
        line.setAttribute("y2", y.toFixed(1));
        line.setAttribute("x1", Number.isInteger(value) ? "56" : "61");
        text.setAttribute("y", (y + 4).toFixed(1));
        tell(text, Number.isInteger(value) ? String(value) : "");
      });
      tell(number, depth.toFixed(2));
      wanted.style.display = want === null ? "none" : "";
      if (want !== null) wanted.setAttribute("transform", `translate(0 ${(tall / 2 + (want - depth) * per).toFixed(1)})`);
    },
  };
}

/** An artificial horizon. */
function horizon() {
  const r = 54;
  const ball = s("g", {}, s("rect", { class: "sky", x: -200, y: -300, width: 400, height: 300 }), s("rect", { class: "ground", x: -200, y: 0, width: 400, height: 300 }), s("line", { class: "ink", x1: -120, x2: 120, y1: 0, y2: 0 }),
    ...[-60, -40, -20, 20, 40, 60].flatMap((degrees) => [s("line", { class: "tick", x1: -16, x2: 16, y1: -degrees, y2: -degrees }), s("text", { x: 20, y: -degrees + 4, class: "small" }, String(Math.abs(degrees)))]));
  const caption = s("text", { class: "small", x: 0, y: r + 13, "text-anchor": "middle" });
  const root = s("svg", { class: "attitude", width: 2 * r + 4, height: 2 * r + 20, viewBox: `${-r - 2} ${-r - 2} ${2 * r + 4} ${2 * r + 20}` }, s("defs", {}, s("clipPath", { id: "ball" }, s("circle", { r }))),
    s("g", { "clip-path": "url(#ball)" }, ball), s("circle", { class: "ink", r, style: "opacity:.7" }), s("path", { class: "ink", d: "M-34 0h22l6 7M34 0h-22l-6 7", style: "stroke:#f0b441;stroke-width:2.600" }), s("circle", { class: "want", r: 2.5 }), caption);
  return {
    root,
    /** @param {number} roll degrees @param {number} pitch degrees */
    show(roll, pitch) {
      ball.setAttribute("transform", `rotate(${(-roll).toFixed(1)}) translate(0 ${Math.max(-85, Math.min(85, pitch)).toFixed(1)})`);
      tell(caption, `roll ${signed(roll)}  pitch ${signed(pitch)}`);
    },
  };
}

/** A small angle, without a minus before nothing. @param {number} degrees */
function signed(degrees) {
  return `${Math.round(degrees) || 0}°`;
}
