// Forms made from what the server tells of its services: fields by type, with units and limits.
import { h, tell } from "../core/dom.js";
/** @typedef {import("../types").Service} Service @typedef {import("../types").Argument} Argument @typedef {import("../core/app.js").App} App */

/** What stands in a field, or why it cannot be sent. @typedef {{value?: unknown, fault?: string}} Entry */

/** @param {Argument} argument */
function hint(argument) {
  const { minimum: low, maximum: high, unit, required } = argument;
  const parts = [unit && unit !== "1" ? unit : ""];
  const number = (/** @type {number} */ value) => (Math.abs(value) >= 1e5 ? value.toExponential(0) : String(value));
  if (typeof low === "number" && typeof high === "number") parts.push(`${number(low)} to ${number(high)}`);
  else if (typeof low === "number") parts.push(`at least ${number(low)}`);
  else if (typeof high === "number") parts.push(`at most ${number(high)}`);
  if (!required) parts.push("optional");
  return parts.filter(Boolean).join(" · ");
}

/** @param {string} text @param {Argument} argument @returns {Entry} */
export function read(text, argument) {
  const trimmed = text.trim();
  if (trimmed === "") return argument.required ? { fault: "is missing" } : {};
  if (argument.type === "json") {
    try {
      return { value: JSON.parse(trimmed) };
    } catch {
      return { fault: "is no JSON" };
    }
  }
  if (argument.type !== "float" && argument.type !== "int") return { value: text };
  const number = Number(trimmed);
  if (!Number.isFinite(number)) return { fault: "is no number" };
  if (argument.type === "int" && !Number.isInteger(number)) return { fault: "is no whole number" };
  if (typeof argument.minimum === "number" && number < argument.minimum) return { fault: `is below ${argument.minimum}` };
  if (typeof argument.maximum === "number" && number > argument.maximum) return { fault: `is above ${argument.maximum}` };
  return { value: number };
}

/** @param {unknown} value */
function shown(value) {
  // Floats of computation (0.15000000000000002) are shown as people write them.
  if (typeof value === "number") return String(Number(value.toPrecision(9)));
  return value === null || value === undefined ? "" : typeof value === "object" ? JSON.stringify(value) : String(value);
}

/**
 * One argument. `suggest` are texts that it may well be.
 * @param {Argument} argument @param {unknown} given @param {string[]} suggest
 * @returns {{element: HTMLElement, entry: () => Entry}}
 */
function field(argument, given, suggest) {
  const size = argument.shape?.length === 1 ? argument.shape[0] : 0;
  const start = given ?? argument.default;
  const number = argument.type === "float" || argument.type === "int";
  const input = (/** @type {unknown} */ value, label = argument.name) => h("input", { type: "text", inputmode: number ? "decimal" : null, value: shown(value), "aria-label": label, autocomplete: "off", spellcheck: "false" });
  const name = h("span", {}, h("b", {}, argument.name), h("span", { class: "hint" }, hint(argument)));
  const doc = argument.doc ? h("span", { class: "hint" }, argument.doc) : null;
  if (argument.type === "bool") {
    const box = h("input", { type: "checkbox", "aria-label": argument.name });
    box.checked = start === true;
    return { element: h("label", { class: "check" }, box, name, doc), entry: () => ({ value: box.checked }) };
  }
  if (argument.choices?.length) {
    const select = h("select", { "aria-label": argument.name }, argument.required ? null : h("option", { value: "" }, "–"), ...argument.choices.map((choice) => h("option", { value: choice }, choice)));
    if (start !== undefined && start !== null) select.value = String(start);
    return { element: h("label", { class: "field" }, name, select, doc), entry: () => read(select.value, argument) };
  }
  if (size > 0 && size <= 8) {
    const parts = Array.isArray(start) ? start : [];
    const inputs = Array.from({ length: size }, (_, k) => input(parts[k], `${argument.name} ${k + 1}`));
    const entry = () => {
      const entries = inputs.map((each) => read(each.value, { ...argument, required: true }));
      if (!argument.required && inputs.every((each) => each.value.trim() === "")) return {};
      const wrong = entries.find((each) => each.fault);
      return wrong ? { fault: wrong.fault } : { value: entries.map((each) => each.value) };
    };
    return { element: h("div", { class: "field" }, name, h("div", { class: "vector" }, ...inputs), doc), entry };
  }
  if (argument.type === "json") {
    const area = h("textarea", { "aria-label": argument.name, spellcheck: "false" }, shown(start));
    return { element: h("label", { class: "field" }, name, area, doc), entry: () => read(area.value, argument) };
  }
  const one = input(start);
  const id = `suggest-${Math.random().toString(36).slice(2)}`;
  if (suggest.length) one.setAttribute("list", id);
  return { element: h("label", { class: "field" }, name, one, suggest.length ? h("datalist", { id }, ...suggest.map((text) => h("option", { value: text }))) : null, doc), entry: () => read(one.value, argument) };
}

/**
 * A form that calls a service and shows what it says.
 * @param {Service} service @param {App} app
 * @param {{given?: Record<string, unknown>, suggest?: Record<string, string[]>, done?: (result: unknown) => void, label?: string, doc?: boolean}} [how]
 */
export function serviceForm(service, app, { given = {}, suggest = {}, done, label = "Call", doc = true } = {}) {
  const fields = service.arguments.map((argument) => ({ argument, ...field(argument, given[argument.name], suggest[argument.name] ?? []) }));
  const result = h("pre", { class: "result", hidden: true, tabindex: 0, "aria-label": "Result" });
  const bar = h("progress", { max: 1, hidden: true, "aria-label": "Progress" });
  const button = h("button", { class: service.reads_only ? "" : "primary", type: "submit" }, label);
  const cancel = h("button", { type: "button", hidden: true }, "Cancel");
  const say = (/** @type {string} */ text, bad = false) => {
    result.hidden = false;
    result.classList.toggle("bad", bad);
    tell(result, text);
  };
  const send = async (/** @type {SubmitEvent} */ event) => {
    event.preventDefault();
    /** @type {Record<string, unknown>} */
    const args = {};
    const wrong = [];
    for (const { argument, element, entry } of fields) {
      const { value, fault } = entry();
      element.classList.toggle("wrong", fault !== undefined);
      if (fault) wrong.push(`${argument.name} ${fault}`);
      else if (value !== undefined) args[argument.name] = value;
    }
    if (wrong.length) {
      say(wrong.join("; "), true);
      return;
    }
    button.disabled = true;
    const request = app.link.request("call", { service: service.path, args }, (fraction) => {
      bar.hidden = false;
      bar.value = fraction;
    });
    cancel.hidden = !service.long_running;
    cancel.onclick = () => app.link.request("cancel", { id: request.id }).catch(() => {});
    try {
      const reply = await request;
      say(reply.value === null || reply.value === undefined ? `Done at ${(reply.t_ns / 1e9).toFixed(2)} s.` : JSON.stringify(reply.value, null, 1));
      done?.(reply.value);
    } catch (error) {
      say(/** @type {Error} */ (error).message, true);
    }
    button.disabled = false;
    bar.hidden = cancel.hidden = true;
  };
  return h("form", { class: "service", onsubmit: send }, doc && service.doc ? h("p", { class: "doc" }, service.doc) : null, ...fields.map(({ element }) => element), h("div", { class: "row" }, button, cancel), bar, result);
}

/** @param {App} app */
export function servicesTab(app) {
  return (/** @type {HTMLElement} */ place) => {
    const search = h("input", { type: "text", placeholder: "Find a service …", "aria-label": "Find a service", style: "width:100%", oninput: () => show() });
    const list = h("div");
    place.append(h("div", { class: "stack" }, search, list));
    const show = () => {
      const services = (app.description?.services ?? []).filter((service) => service.path.includes(search.value.trim()));
      /** @type {Map<string, Service[]>} */
      const groups = new Map();
      for (const service of services) {
        const group = service.path.split("/").slice(0, -1).join("/");
        groups.set(group, [...(groups.get(group) ?? []), service]);
      }
      list.replaceChildren(...[...groups].map(([group, members]) => {
        const details = h("details", {}, h("summary", {}, group));
        details.open = search.value.trim() !== "" && groups.size < 4;
        const fill = () => {
          if (!details.open || details.children.length > 1) return;
          for (const service of members) {
            const one = h("details", { style: "margin-left:10px" }, h("summary", {}, service.path.slice(group.length + 1)));
            one.addEventListener("toggle", () => one.open && one.children.length === 1 && one.append(h("div", { class: "card" }, h("div", { class: "body" }, serviceForm(service, app)))));
            details.append(one);
          }
        };
        details.addEventListener("toggle", fill);
        fill();
        return details;
      }));
      if (!services.length) list.replaceChildren(h("p", { class: "empty" }, app.description ? "No such service." : "Not connected."));
    };
    show();
    return app.on("described", show);
  };
}
