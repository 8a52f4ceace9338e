// The mission: way-points by clicks on the map or by numbers; sent to the autopilot, kept as .plan files.
import { h, symbol, tell, toast } from "../core/dom.js";
import { items, LARGEST_FILE, mission, parsed, written } from "../pilot/plan.js";
/** @typedef {import("../core/app.js").App} App @typedef {import("../pilot/pilot.js").Pilot} Pilot @typedef {import("../core/map.js").Chart} Chart @typedef {import("../pilot/plan.js").Waypoint} Waypoint */

/** What a new depth or altitude is, m. */
const USUAL_M = { depth: 2, altitude: 3 };

/** What is being planned; it outlives its tab. */
export class Planner {
  /** @param {App} app @param {Chart} chart */
  constructor(app, chart) {
    this.app = app;
    this.chart = chart;
    /** @type {Waypoint[]} */
    this.waypoints = [];
    /** @type {number | null} */
    this.speed = null;
    /** Whether clicks on the map are way-points. */
    this.adding = false;
    this.show = () => {};
    // Told again when the world changes about the same vehicle.
    let vehicle = "";
    app.on("chosen", () => {
      if (app.vehicle !== vehicle) this.set([], null);
      vehicle = app.vehicle;
    });
  }

  /** @param {Waypoint[]} waypoints @param {number | null} speed */
  set(waypoints, speed) {
    this.waypoints = waypoints;
    this.speed = speed;
    this.changed();
  }

  /** @param {number} north @param {number} east */
  add(north, east) {
    const cm = (/** @type {number} */ value) => Math.round(100 * value) / 100;
    const { height, metres } = this.waypoints.at(-1) ?? { height: /** @type {const} */ ("depth"), metres: cm(Math.max(0, this.app.timeline.poses[7 * this.app.chosen + 2] || 0)) };
    this.waypoints.push({ north: cm(north), east: cm(east), height, metres, hold: 0 });
    this.changed();
  }

  /** A way-point is told by its depth or altitude from now on: as another one before or after it, or as usual. @param {Waypoint} waypoint @param {Waypoint["height"]} height */
  measure(waypoint, height) {
    const like = this.waypoints.find((other) => other.height === height);
    Object.assign(waypoint, { height, metres: like?.metres ?? USUAL_M[height] });
    this.changed();
  }

  changed() {
    this.chart.route = this.waypoints.map(({ north, east, height, metres }) => ({ place: [north, east], above: height === "altitude", text: height === "altitude" ? `${metres} m up` : `${metres} m` }));
    this.show();
  }
}

/** @param {App} app @param {Pilot} pilot @param {Planner} planner */
export function missionTab(app, pilot, planner) {
  return (/** @type {HTMLElement} */ place) => {
    const adding = h("input", { type: "checkbox", onchange: () => { planner.adding = adding.checked; } });
    adding.checked = planner.adding;
    const rows = h("tbody");
    const number = (/** @type {number} */ value, /** @type {string} */ label, /** @type {(value: number) => void} */ change) => {
      const input = h("input", { type: "text", inputmode: "decimal", value, "aria-label": label, style: "width:100%;min-width:0;padding:3px 5px", onchange: () => {
        const given = Number(input.value.trim() === "" ? NaN : input.value);
        try {
          if (Number.isFinite(given)) change(given);
        } catch (error) {
          toast(/** @type {Error} */ (error).message, "bad");
        }
        planner.changed();
      } });
      return input;
    };
    const field = (/** @type {Waypoint} */ waypoint, /** @type {"north" | "east" | "metres" | "hold"} */ key, /** @type {number} */ k) =>
      h("td", {}, number(waypoint[key], `${key === "metres" ? waypoint.height : key} of way-point ${k + 1}`, (value) => {
        if (key === "metres" && waypoint.height === "altitude" && value <= 0) throw new Error("an altitude is above the bottom, so more than 0 m");
        waypoint[key] = key === "hold" ? Math.max(0, value) : value;
      }));
    const choice = (/** @type {Waypoint} */ waypoint, /** @type {number} */ k) => {
      const select = h("select", { "aria-label": `Depth or altitude of way-point ${k + 1}`, title: "Below the surface, or above the bottom", style: "padding:3px 2px", onchange: () => planner.measure(waypoint, select.value === "altitude" ? "altitude" : "depth") },
        h("option", { value: "depth" }, "depth"), h("option", { value: "altitude" }, "altitude"));
      select.value = waypoint.height;
      return select;
    };
    const speed = h("input", { type: "text", inputmode: "decimal", placeholder: "as it likes", "aria-label": "Speed in m/s", style: "width:110px", onchange: () => {
      const given = Number(speed.value);
      planner.speed = speed.value.trim() !== "" && given > 0 && Number.isFinite(given) ? given : null;
      planner.changed();
    } });
    const note = h("p", { class: "doc" });
    const act = async (/** @type {() => Promise<unknown>} */ deed, /** @type {string} */ done) => {
      try {
        await deed();
        if (done) toast(done, "good");
      } catch (error) {
        toast(/** @type {Error} */ (error).message, "bad");
      }
    };
    const call = (/** @type {string} */ verb, args = {}) => app.link.call(`${app.prefix}autopilot/${verb}`, args);
    const send = async () => {
      if (!pilot.owns && !(await pilot.take())) throw new Error("take control first");
      await call("set_mission", { items: items(planner) });
    };
    const start = async () => {
      await send();
      if (!pilot.armed) await call("arm");
      await call("start_mission");
    };
    const fetch = async () => {
      const told = await call("get_mission");
      const found = mission(Array.isArray(told) ? told : (told?.items ?? []));
      planner.set(found.waypoints, found.speed);
      if (found.left) toast(`${found.left} items of other kinds are not shown`);
    };
    const file = h("input", { type: "file", accept: ".plan,application/json", hidden: true, "aria-label": "Plan file", onchange: () => act(async () => {
      const [chosen] = file.files ?? [];
      if (!chosen || !app.world?.origin) return;
      if (chosen.size > LARGEST_FILE) throw new Error("a plan has at most 1 MiB");
      const found = parsed(await chosen.text(), app.world.origin);
      file.value = "";
      planner.set(found.waypoints, found.speed);
      if (found.left) toast(`${found.left} items of other kinds were left out`);
    }, "") });
    const save = () => {
      if (!app.world?.origin) return;
      const address = URL.createObjectURL(new Blob([written(planner, app.world.origin)], { type: "application/json" }));
      h("a", { href: address, download: `${app.vehicle || "mission"}.plan` }).click();
      setTimeout(() => URL.revokeObjectURL(address), 1000);
    };
    const buttons = {
      start: h("button", { class: "primary", onclick: () => act(start, "The mission has begun") }, "Send and start"),
      send: h("button", { onclick: () => act(send, "Sent") }, "Send"),
      fetch: h("button", { onclick: () => act(fetch, "") }, "Get"),
      clear: h("button", { onclick: () => planner.set([], null) }, "Clear"),
      load: h("button", { onclick: () => file.click() }, "Load .plan"),
      save: h("button", { onclick: save }, "Save .plan"),
    };
    place.append(h("div", { class: "stack" }, h("label", { class: "check" }, adding, "Clicks on the map add way-points"),
      h("table", {}, h("thead", {}, h("tr", {}, ...["", "north m", "east m", "", "m", "hold s", ""].map((text) => h("th", { style: text === "m" ? "min-width:3.4em" : null }, text)))), rows),
      h("label", { class: "row" }, h("span", { class: "dim" }, "Speed m/s"), speed), h("div", { class: "row" }, buttons.start, buttons.send, buttons.fetch, buttons.clear), h("div", { class: "row" }, buttons.load, buttons.save, file), note));
    const show = () => {
      rows.replaceChildren(...planner.waypoints.map((waypoint, k) => h("tr", { "aria-current": pilot.mode === "mission" && pilot.state.mission_index === k + (planner.speed === null ? 0 : 1) ? "step" : null }, h("td", { class: "mono" }, k + 1),
        field(waypoint, "north", k), field(waypoint, "east", k), h("td", {}, choice(waypoint, k)), field(waypoint, "metres", k), field(waypoint, "hold", k),
        h("td", {}, h("button", { class: "quiet icon", "aria-label": `Remove way-point ${k + 1}`, title: "Remove", onclick: () => { planner.waypoints.splice(k, 1); planner.changed(); } }, symbol("close"))))));
      if (document.activeElement !== speed) speed.value = planner.speed === null ? "" : String(planner.speed);
      const [flies, some, origin] = [app.service(`${app.prefix}autopilot/set_mission`) !== undefined, planner.waypoints.length > 0, Boolean(app.world?.origin)];
      buttons.start.disabled = buttons.send.disabled = !flies || !some;
      buttons.fetch.disabled = !flies;
      buttons.clear.disabled = !some;
      buttons.load.disabled = !origin;
      buttons.save.disabled = !origin || !some;
      const { mission_index: index, mission_count: count } = pilot.state;
      tell(note, !flies ? `${app.vehicle || "This"} has no autopilot that could fly a mission.` : pilot.mode === "mission" ? `Under way: item ${Number(index) + 1} of ${count}.` : !some ? "No way-points yet: tick the box above, enlarge the map (M) and click, or load a plan." : origin ? "" : "Plans need a place on the Earth: origin_lat_deg and origin_lon_deg of [world].");
    };
    planner.show = show;
    const endings = [app.on("pilot", () => tellUnderWay()), app.on("described", show), app.on("world", show)];
    const tellUnderWay = () => { if (!rows.contains(document.activeElement)) show(); };
    show();
    return () => {
      planner.show = () => {};
      for (const end of endings) end();
    };
  };
}
