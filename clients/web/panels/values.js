// All fields of a port as numbers.
import { figure, h, tell } from "../core/dom.js";
/** @typedef {import("../types").Port} Port @typedef {import("../types").Sample} Sample @typedef {import("../core/link.js").Link} Link */

const LONGEST = 16;

/** @param {unknown} value @returns {string} */
export function written(value) {
  if (Array.isArray(value)) {
    const flat = value.flat(3);
    const parts = flat.slice(0, LONGEST).map((part) => figure(part));
    return parts.join("  ") + (flat.length > LONGEST ? `  … ${flat.length}` : "");
  }
  if (value !== null && typeof value === "object") return "dtype" in value ? `${JSON.stringify(/** @type {any} */ (value).shape)} ${/** @type {any} */ (value).dtype}` : JSON.stringify(value);
  if (typeof value === "boolean") return value ? "yes" : "no";
  return figure(value);
}

/** @param {Port} port @param {Link} link @param {HTMLElement} place @returns {() => void} */
export function valuesPanel(port, link, place) {
  const list = h("dl", { class: "values" });
  const cells = new Map(port.fields.map((field) => {
    const cell = h("dd", {}, "–");
    list.append(h("dt", { title: field.doc }, field.name), cell, h("span", { class: "unit" }, field.unit === "1" ? "" : field.unit));
    return [field.name, cell];
  }));
  place.append(list);
  return link.subscribe(port.path, 5, (sample) => {
    list.classList.toggle("stale", !sample.valid);
    for (const [name, cell] of cells) tell(cell, written(sample.value[name]));
  });
}
