// The world: what is drawn, current, moments kept, faults, settings of sensors.
import { h, tell } from "../core/dom.js";
import { card } from "./dock.js";
import { about } from "../core/recording.js";
import { serviceForm } from "./form.js";
import { LAYERS } from "../scene/layers.js";
/** @typedef {import("../core/app.js").App} App */

const PLAYS = "A recording plays: nothing in it can be changed.";

/** What changes the world; inactive while a recording plays. @param {App} app @param {Node[]} forms */
const changing = (app, ...forms) => held(app, h("fieldset", { class: "changing stack" }, ...forms));

/** @param {App} app @param {HTMLFieldSetElement} forms */
function held(app, forms) {
  forms.disabled = Boolean(app.status.playback);
  forms.title = forms.disabled ? PLAYS : "";
  return forms;
}

/**
 * @param {App} app
 * @param {{quality: () => string, setQuality: (quality: string) => void, clear: () => boolean, setClear: (clear: boolean) => void, reason: string}} drawing
 */
export function worldTab(app, drawing) {
  return (/** @type {HTMLElement} */ place) => {
    const quality = h("select", { "aria-label": "Quality of the picture", onchange: () => drawing.setQuality(quality.value) }, ...[["auto", "Automatic"], ["high", "High"], ["low", "Low"]].map(([value, text]) => h("option", { value }, text)));
    quality.value = drawing.quality();
    const clear = h("input", { type: "checkbox", onchange: () => drawing.setClear(clear.checked) });
    clear.checked = drawing.clear();
    const layers = Object.entries(LAYERS).map(([name, text]) => {
      const box = h("input", { type: "checkbox", onchange: () => {
        const layer = /** @type {import("../scene/layers.js").Layer} */ (name);
        if (box.checked) app.layers.add(layer);
        else app.layers.delete(layer);
        app.emit("layers");
      } });
      box.checked = app.layers.has(/** @type {any} */ (name));
      return h("label", { class: "check" }, box, text);
    });
    const served = h("div");
    place.append(card("Drawn", [], drawing.reason ? h("p", { class: "doc" }, drawing.reason) : h("div", {}, ...layers, h("label", { class: "check" }, clear, "Clear water"), h("label", { class: "row", style: "margin-top:6px" }, h("span", { class: "dim grow" }, "Quality"), quality))), served);
    const show = () => {
      served.replaceChildren(...services(app));
    };
    const hold = () => served.querySelectorAll("fieldset").forEach((forms) => held(app, forms));
    show();
    const recorded = () => served.querySelectorAll(".recorded").forEach((place) => tell(place, about(app)));
    const endings = [app.on("status", recorded), app.on("described", show), app.on("chosen", show), app.on("status", hold)];
    return () => endings.forEach((end) => end());
  };
}

/** @param {App} app @returns {Node[]} */
function services(app) {
  const form = (/** @type {string} */ path, /** @type {Parameters<typeof serviceForm>[2]} */ how = {}) => {
    const service = app.service(path);
    return service ? serviceForm(service, app, how) : null;
  };
  /** @type {Node[]} */
  const cards = [];
  const current = form("world/set_current", { label: "Set", given: { velocity_N: app.world?.water.current } });
  if (current) cards.push(card("Current", [], changing(app, current)));
  const keep = form("world/snapshot", { label: "Keep" });
  const back = form("world/restore", { label: "Go back" });
  if (keep && back) cards.push(card("Moments", [], changing(app, keep, back)));
  const begin = form("recording/start", { label: "Record", doc: false });
  const end = form("recording/stop", { label: "End", doc: false });
  if (begin && end) cards.push(card("Recording", [], changing(app, h("p", { class: "doc recorded" }, about(app)), begin, end)));
  const faults = faultsCard(app);
  if (faults) cards.push(faults);
  const sensors = settings(app);
  if (sensors) cards.push(sensors);
  const spawn = form("world/spawn", { label: "Spawn" });
  const remove = form("world/remove", { label: "Remove", suggest: { name: app.bodies.map((body) => body.name) } });
  if (spawn) cards.push(card("Vehicles", [], changing(app, spawn, ...(remove ? [remove] : []))));
  return cards;
}

/** @param {App} app */
function faultsCard(app) {
  const set = app.service("world/set_fault");
  if (!set) return null;
  const list = h("div");
  const show = async () => {
    try {
      const found = await app.link.call("world/faults");
      const faults = Array.isArray(found) ? found : Array.isArray(found?.faults) ? found.faults : Object.entries(found ?? {}).map(([name, rest]) => ({ name, .../** @type {object} */ (rest) }));
      list.replaceChildren(...faults.map((/** @type {any} */ fault) => h("div", { class: "port" }, h("div", {}, h("div", { class: "path" }, String(fault.name)), h("div", { class: "kind" }, `${fault.kind ?? ""} · ${fault.target ?? ""}${fault.active === undefined ? "" : fault.active ? " · active" : " · waits"}`)),
        h("button", { onclick: () => app.link.call("world/clear_fault", { name: fault.name }).then(show, (/** @type {Error} */ error) => tell(list, error.message)) }, "Clear"))));
      if (!faults.length) list.replaceChildren(h("p", { class: "doc" }, "None."));
    } catch (error) {
      tell(list, /** @type {Error} */ (error).message);
    }
  };
  void show();
  const targets = [...app.bodies.map((body) => body.name), ...(app.description?.ports ?? []).map((port) => port.path)];
  const form = serviceForm(set, app, { label: "Set the fault", done: () => void show(), suggest: { target: targets }, given: { name: "from_the_page", parameters: {} }, doc: false });
  return card("Faults", [h("button", { class: "quiet", onclick: () => void show() }, "Refresh")], h("div", { class: "stack" }, list, h("details", {}, h("summary", {}, "New fault"), changing(app, form))));
}

/** Settings of the chosen vehicle's sensors and actuators: what `get` says, to be changed by `set`. @param {App} app */
function settings(app) {
  const settable = (app.description?.services ?? []).filter((service) => service.path.startsWith(app.prefix) && service.path.endsWith("/set"));
  if (!settable.length || !app.vehicle) return null;
  const rows = settable.map((service) => {
    const base = service.path.slice(0, -"/set".length);
    const one = h("details", {}, h("summary", {}, base.slice(app.prefix.length)));
    one.addEventListener("toggle", async () => {
      if (!one.open || one.children.length > 1) return;
      const now = await app.link.call(`${base}/get`).catch(() => ({}));
      const given = now?.parameters ?? now ?? {};
      const doing = (/** @type {string} */ verb) => h("button", { type: "button", onclick: () => app.link.call(`${base}/${verb}`).catch((/** @type {Error} */ error) => tell(note, error.message)) }, verb === "activate" ? "Switch on" : "Switch off");
      const note = h("span", { class: "dim" });
      one.append(h("div", { style: "margin:6px 0 10px 12px" }, changing(app, serviceForm(service, app, { given, label: "Set", doc: false }), h("div", { class: "row" }, doing("activate"), doing("deactivate"), note))));
    });
    return one;
  });
  return card(`Settings of ${app.vehicle}`, [], ...rows);
}
