// Panels of the data: added from the list of ports, kept in the address.
import { h, symbol, tell } from "../core/dom.js";
import { card } from "./dock.js";
import { hasPicture, picturePanel } from "./picture.js";
import { numbersOf, plotPanel } from "./plot.js";
import { sonarPanel } from "./sonar.js";
import { valuesPanel } from "./values.js";
/** @typedef {import("../core/app.js").App} App @typedef {import("../types").Port} Port */
/** One panel: what kind, of which port, for plots of which field. @typedef {{kind: string, path: string, field: string}} Panel */

const ADDRESS = "panels";

/** @param {string | null} text @returns {Panel[]} */
export function parse(text) {
  return (text ?? "").split(",").filter(Boolean).map((part) => {
    const [kind, path = "", field = ""] = part.split(":");
    return { kind, path, field };
  });
}

/** @param {Panel[]} panels */
function write(panels) {
  return panels.map(({ kind, path, field }) => (field ? `${kind}:${path}:${field}` : `${kind}:${path}`)).join(",");
}

/** Panels for a vehicle of which nothing was asked yet: what its camera sees, its depth, its sonar. @param {App} app @returns {Panel[]} */
function first(app) {
  const mine = app.description?.ports.filter((port) => port.path.startsWith(app.prefix) && port.direction === "sensor") ?? [];
  const depth = mine.find((port) => port.fields.some((field) => field.name === "depth"));
  const sonar = mine.find((port) => port.message === "SonarPing");
  const pose = mine.find((port) => port.message === "Attitude" || port.message === "Pose");
  const seen = mine.find((port) => port.message === "Image" && hasPicture(port)) ?? mine.find((port) => port.message === "SonarImage" && hasPicture(port));
  return [...(seen ? [{ kind: "picture", path: seen.path, field: "" }] : []), ...(depth ? [{ kind: "plot", path: depth.path, field: "depth" }] : []), ...(sonar ? [{ kind: "sonar", path: sonar.path, field: "" }] : []), ...(pose ? [{ kind: "values", path: pose.path, field: "" }] : [])];
}

/** @param {App} app */
export function dataTab(app) {
  /** @type {Panel[] | null} */
  let panels = app.address.get(ADDRESS) === null ? null : parse(app.address.get(ADDRESS));
  return (/** @type {HTMLElement} */ place) => {
    const cards = h("div");
    const list = h("div");
    const search = h("input", { type: "text", placeholder: "Find a port …", "aria-label": "Find a port", oninput: () => showPorts(), style: "width:100%" });
    const adder = h("details", {}, h("summary", {}, "Add a panel"), h("div", { class: "stack", style: "margin-top:6px" }, search, list));
    place.append(cards, adder);
    /** @type {Map<string, {element: HTMLElement, end: () => void}>} */
    const open = new Map();
    const keep = (/** @type {Panel[]} */ next) => {
      panels = next;
      app.address.set(ADDRESS, write(next) || "none:");
      show();
    };
    const add = (/** @type {string} */ kind, /** @type {Port} */ port, field = "") => {
      const panel = { kind, path: port.path, field };
      const rest = (panels ?? first(app)).filter((other) => write([other]) !== write([panel]));
      keep([panel, ...rest]);
      place.scrollTop = 0;
    };
    const show = () => {
      const wanted = (panels ?? first(app)).filter((panel) => app.port(panel.path));
      const keys = wanted.map((panel) => write([panel]));
      for (const [key, { element, end }] of open) {
        if (keys.includes(key)) continue;
        end();
        element.remove();
        open.delete(key);
      }
      wanted.forEach((panel, k) => {
        const there = open.get(keys[k]) ?? make(panel);
        open.set(keys[k], there);
        if (cards.children[k] !== there.element) cards.insertBefore(there.element, cards.children[k] ?? null);
      });
      adder.open = adder.open || wanted.length === 0;
    };
    const make = (/** @type {Panel} */ panel) => {
      const port = /** @type {Port} */ (app.port(panel.path));
      const unit = port.fields.find((field) => field.name === panel.field)?.unit;
      const close = h("button", { class: "quiet icon", title: "Close", "aria-label": `Close the panel of ${panel.path}`, onclick: () => keep((panels ?? first(app)).filter((other) => write([other]) !== write([panel]))) }, symbol("close"));
      const title = panel.field ? `${panel.path} · ${panel.field}` : panel.path;
      const element = card(title, [unit && unit !== "1" ? h("span", { class: "unit" }, unit) : null, close]);
      const body = /** @type {HTMLElement} */ (element.querySelector(".body"));
      body.classList.toggle("flush", panel.kind === "plot");
      // Charts measure their place: it must be in the page first.
      cards.append(element);
      const end = panel.kind === "plot" ? plotPanel(port, panel.field, app, body) : panel.kind === "sonar" ? sonarPanel(port, app, body) : panel.kind === "picture" ? picturePanel(port, app, body) : valuesPanel(port, app.link, body);
      return { element, end };
    };
    const showPorts = () => {
      const sensors = (app.description?.ports ?? []).filter((port) => port.direction === "sensor" && port.path.includes(search.value.trim()));
      list.replaceChildren(...sensors.map((port) => h("div", { class: "port" },
        h("div", {}, h("div", { class: "path", title: port.doc }, port.path), h("div", { class: "kind" }, `${port.kind.replaceAll("_", " ")}${port.rate_hz ? ` · ${port.rate_hz} Hz` : ""}`)),
        h("div", { class: "row" }, h("button", { onclick: () => add("values", port) }, "Values"),
          port.message === "SonarPing" ? h("button", { onclick: () => add("sonar", port) }, "Sonar") : null,
          hasPicture(port) ? h("button", { onclick: () => add("picture", port) }, "Picture") : null, plotMenu(port, add)))));
      if (!sensors.length) list.replaceChildren(h("p", { class: "empty" }, app.description ? "No such port." : "Not connected."));
    };
    const all = () => {
      showPorts();
      show();
    };
    const chosen = () => panels === null && show();
    const endings = [app.on("described", all), app.on("chosen", chosen), app.on("world", chosen)];
    all();
    return () => {
      for (const end of endings) end();
      for (const { end } of open.values()) end();
    };
  };
}

/** @param {Port} port @param {(kind: string, port: Port, field: string) => void} add */
function plotMenu(port, add) {
  const fields = port.fields.filter((field) => numbersOf(field).length);
  if (!fields.length) return null;
  const menu = h("select", { "aria-label": `Plot a field of ${port.path}`, onchange: () => {
    add("plot", port, menu.value);
    menu.value = "";
  } }, h("option", { value: "" }, "Plot …"), ...fields.map((field) => h("option", { value: field.name }, field.unit === "1" ? field.name : `${field.name} (${field.unit})`)));
  return menu;
}

/** @param {App} app */
export function eventsTab(app) {
  return (/** @type {HTMLElement} */ place) => {
    const list = h("ul", { class: "events" });
    const empty = h("p", { class: "empty" }, "Nothing has happened yet.");
    place.append(list, empty);
    const show = () => {
      empty.hidden = app.told.length > 0;
      list.replaceChildren(...app.told.slice(0, 200).map((told) => {
        const mood = /fault|diverged|failed|shutdown/.test(told.event) ? "bad" : /watchdog|conflict|no_answer/.test(told.event) ? "warn" : "";
        const kind = h("span", { class: "kind" });
        tell(kind, told.event.replaceAll("_", " "));
        return h("li", { class: mood }, h("span", { class: "t" }, `${(told.t_ns / 1e9).toFixed(2)} s`), kind, h("span", {}, told.text ?? ""));
      }));
    };
    show();
    return app.on("told", show);
  };
}
