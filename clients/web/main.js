// The page begins here: connection, world, picture, pilot, panels; and the one loop that draws.
import { Address } from "./core/address.js";
import { App } from "./core/app.js";
import { byId, h, toast } from "./core/dom.js";
import { picture, states } from "./core/frames.js";
import { Bars } from "./core/header.js";
import { Playback } from "./core/playback.js";
import { ignore, Link } from "./core/link.js";
import { Chart } from "./core/map.js";
import { tellMessages } from "./core/modems.js";
import { Chooser } from "./core/chooser.js";
import { Dock } from "./panels/dock.js";
import { dataTab, eventsTab } from "./panels/data_tab.js";
import { servicesTab } from "./panels/form.js";
import { showPicture } from "./panels/picture.js";
import { missionTab, Planner } from "./panels/mission_tab.js";
import { pilotTab } from "./panels/pilot_tab.js";
import { worldTab } from "./panels/world_tab.js";
import { Hud } from "./pilot/hud.js";
import { Pilot } from "./pilot/pilot.js";
import { Training } from "./pilot/training.js";
import { LAYERS, USUAL } from "./scene/layers.js";

/** @typedef {import("./scene/layers.js").Layer} Layer */

window.uw = { frames: 0, t: 0, vehicles: {}, errors: [], said: [] };
addEventListener("error", (event) => window.uw.errors.push(String(event.message)));
addEventListener("unhandledrejection", (event) => window.uw.errors.push(String(event.reason)));

const address = new Address();
const app = new App(address);
const STILL_MS = 1000;
let picturing = /** @type {import("./core/drawing.js").Drawing | null} */ (null);

/** @param {string} text @param {boolean} [on] */
function notice(text, on = true) {
  const place = byId("notice");
  place.textContent = text;
  place.hidden = !on;
}

/** @param {string} path */
async function fetched(path) {
  const response = await fetch(path, address.token ? { headers: { Authorization: `Bearer ${address.token}` } } : {});
  if (!response.ok) throw new Error(`${path}: ${response.status} ${await response.text()}`);
  return response;
}

const store = {
  mesh: async (/** @type {string} */ hash) => (await fetched(`mesh/${hash}.bin`)).arrayBuffer(),
  looks: async (/** @type {string} */ hash) => (await fetched(`looks/${hash}.glb`)).arrayBuffer(),
  failed: (/** @type {string} */ why) => toast(why, "bad"),
};

/** Until the world is asked for again. */
const AGAIN_MS = 1000;
let loading = -1;
let asked = 0;
/** Get the world again; frames of another revision ask for it. @param {number} revision */
async function load(revision) {
  if (loading === revision) return;
  loading = revision;
  asked += 1;
  const turn = asked;
  const again = () => setTimeout(() => { if (turn === asked) loading = -1; }, AGAIN_MS);
  try {
    const world = /** @type {import("./types").World} */ (await (await fetched("world.json")).json());
    // It has changed again meanwhile: what was asked for later is newer, whatever comes first.
    if (turn !== asked) return;
    if (world.revision < revision) again();
    const name = app.bodies[app.chosen]?.name ?? address.get("vehicle");
    app.world = world;
    app.chosen = Math.max(0, app.bodies.findIndex((body) => body.name === name));
    app.emit("world");
    app.emit("chosen");
  } catch (error) {
    again();
    if (app.connected) toast(/** @type {Error} */ (error).message, "bad");
  }
}

async function describe() {
  try {
    app.description = await app.link.request("describe");
    app.emit("described");
  } catch (error) {
    if (app.connected) toast(/** @type {Error} */ (error).message, "bad");
  }
}

/** Ask for the token, which the server wants. @param {string} why */
function askToken(why) {
  const place = byId("notice");
  if (place.querySelector("form")) return;
  const input = h("input", { type: "text", "aria-label": "Token", autocomplete: "off" });
  place.replaceChildren(h("form", { class: "row", onsubmit: (/** @type {Event} */ event) => {
    event.preventDefault();
    address.keep(input.value.trim());
    place.replaceChildren();
    app.link.connect();
  } }, h("span", {}, why), input, h("button", { class: "primary" }, "Connect")));
  place.hidden = false;
}

app.link = new Link({
  opened() {
    const again = app.world !== null;
    app.connected = true;
    app.timeline.clear();
    loading = -1;
    notice("", false);
    if (again) toast("Connected again", "good");
    app.emit("link");
    void load(0);
    void describe();
  },
  lost(why) {
    app.connected = false;
    if (!byId("notice").querySelector("form")) notice(why ? `Connection lost (${why}). Trying again …` : "No connection to the server. Trying again …");
    app.status = { ...app.status, lease: {} };
    app.emit("link");
    app.emit("status");
  },
  binary(data) {
    const kind = new Uint8Array(data, 0, 1)[0];
    if (kind === 2) void showPicture(app, picture(data)).catch(ignore);
    if (kind !== 1) return;
    const frame = states(data, performance.now() / 1000);
    app.timeline.add(frame);
    training.keep(frame);
    window.uw.arrived = frame.arrived;
    // Without a world: a server that is busy did not describe it in time.
    if (app.world ? frame.revision !== app.world.revision : loading < 0) void load(frame.revision);
  },
  status(status) {
    app.status = status;
    app.emit("status");
  },
  event(told) {
    if (told.event === "reset") app.timeline.clear();
    if (told.event === "ports_changed") void describe();
    app.tell(told);
    if (told.text?.startsWith("playback: ")) return; // a seek is seen
    if (["fault", "diverged", "adapter_failed", "shutdown", "reset"].includes(told.event)) toast(told.text || told.event, told.event === "reset" ? "" : "bad");
  },
  denied: askToken,
  refused: (why) => toast(why, "bad"),
}, () => address.token);

const hidden = (address.get("hide") ?? "").split(",");
const extra = (address.get("show") ?? "").split(",");
for (const layer of /** @type {Layer[]} */ (Object.keys(LAYERS))) if ((USUAL.includes(layer) && !hidden.includes(layer)) || extra.includes(layer)) app.layers.add(layer);
app.on("layers", () => {
  address.set("hide", USUAL.filter((layer) => !app.layers.has(layer)).join(","));
  address.set("show", [...app.layers].filter((layer) => !USUAL.includes(layer)).join(","));
});

const pilot = new Pilot(app);
const training = new Training(app);
const bars = new Bars(app, pilot);
const playback = new Playback(app, (service, args) => bars.act(service, args));
const hud = new Hud(app, pilot);
const chart = new Chart((north, east) => {
  if (!app.vehicle) return;
  if (planner.adding) {
    planner.add(north, east);
    return;
  }
  if (!pilot.hasAutopilot) {
    toast(`${north.toFixed(2)} N, ${east.toFixed(2)} E. ${app.vehicle} has no autopilot that could go there.`);
    return;
  }
  const depth = Number(pilot.state.depth_ref ?? app.timeline.poses[7 * app.chosen + 2]);
  chart.goal = [north, east];
  void pilot.goto([north, east, depth]).finally(() => { chart.goal = null; });
});
const planner = new Planner(app, chart);
tellMessages(app, (from, far) => {
  chart.pulse(from, app.timeline.t, far);
  picturing?.scene?.pulse(from, far);
});
const chooser = new Chooser(app, (view) => picturing?.setView(view), () => picturing !== null);

app.on("world", () => {
  if (app.world) chart.show(app.world);
  if (app.world && !app.world.exact_poses) notice("This server does not tell where vehicles are (exact_poses = false): panels only.");
});

/** Three.js runs only where it can draw. */
async function begin() {
  let reason = "";
  // The world is asked for while three.js is loaded.
  app.link.connect();
  try {
    if (address.query.get("gl") === "off") throw new Error("it is switched off in the address");
    const { Drawing } = await import("./core/drawing.js");
    picturing = new Drawing(app, pilot, store, /** @type {any} */ (address.get("quality") ?? "auto"));
  } catch (error) {
    reason = /** @type {Error} */ (error).message;
  }
  if (reason) {
    byId("view").classList.add("flat");
    toast(`No picture in three dimensions: ${reason}. This is the map.`, "bad");
    reason = `No picture in three dimensions: ${reason}.`;
  }
  const drawing = {
    quality: () => address.get("quality") ?? "auto",
    setQuality: (/** @type {string} */ quality) => {
      address.set("quality", quality === "auto" ? null : quality);
      location.reload();
    },
    clear: () => picturing?.clear ?? false,
    setClear: (/** @type {boolean} */ clear) => picturing?.setClear(clear),
    reason,
  };
  new Dock(app, [
    { name: "pilot", title: "Pilot", open: pilotTab(app, pilot, training) },
    { name: "mission", title: "Mission", open: missionTab(app, pilot, planner) },
    { name: "data", title: "Data", open: dataTab(app) },
    { name: "world", title: "World", open: worldTab(app, drawing) },
    { name: "services", title: "Services", open: servicesTab(app) },
    { name: "events", title: "Events", open: eventsTab(app) },
  ]);
  bars.quality(picturing ? (picturing.stage.fine ? "high" : picturing.stage.software ? "low (software drawing)" : "low") : "map");
  Object.assign(window.uw, { drawing: picturing });
  chooser.show();
  requestAnimationFrame(draw);
}

const limit = Number(address.get("fps")) || 0;
let last = performance.now();
let told = 0;

/** @param {number} now ms */
function draw(now) {
  requestAnimationFrame(draw);
  const least = limit ? 1000 / limit - 2 : picturing?.stage.software ? 60 : 0;
  if (now - last < least) return;
  const dt = Math.min(0.25, (now - last) / 1000);
  last = now;
  const timeline = training.shown(now / 1000);
  if (!timeline) return;
  window.uw.frames += 1;
  window.uw.t = timeline.t;
  app.bodies.forEach((body, k) => { window.uw.vehicles[body.name] = [...timeline.poses.subarray(7 * k, 7 * k + 7)]; });
  bars.tick(timeline.t);
  if (!playback.seeking) playback.tick(timeline.t);
  picturing?.draw(timeline, training.rerun ? null : training.goal, dt);
  if (!window.uw.first && (picturing?.scene || !picturing)) window.uw.first = performance.now();
  if (now - told < 60) return;
  told = now;
  hud.update(timeline.poses, 7 * app.chosen);
  chart.aim = training.goal;
  chart.draw(timeline, app.chosen);
}

document.addEventListener("visibilitychange", () => app.link.view({ frames: !document.hidden }));
addEventListener("keydown", (event) => {
  if (event.target instanceof HTMLElement && /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName)) return;
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  const views = { Digit1: "orbit", Digit2: "follow", Digit3: "board", Digit4: "top" };
  if (event.code in views) chooser.view(/** @type {any} */ (views)[event.code]);
  else if (event.code === "KeyM") chart.enlarge();
  else if (event.code === "KeyX") training.mark();
  else if (event.code === "KeyP") bars.turnDock();
  else if (event.code === "KeyK") void bars.act(app.status.paused ? "world/resume" : "world/pause");
  else if (event.code === "KeyN" && app.bodies.length) app.choose((app.chosen + 1) % app.bodies.length);
  else if (event.code === "KeyL") {
    if (!app.layers.delete("lamps")) app.layers.add("lamps");
    pilot.shine(app.layers.has("lamps"));
    app.emit("layers");
  }
});
Object.assign(window.uw, { app, pilot, planner, chart, playback, training });
setTimeout(() => { if (!app.connected && byId("notice").hidden) notice("Connecting …"); }, STILL_MS);
void begin();
