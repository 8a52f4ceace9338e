// Elements. Texts of the server reach the page only as text nodes.

/**
 * Make an element. Attributes: `on<Event>` listens, `true`/`false` set or leave out, others are set as they are.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Record<string, any>} [attributes]
 * @param {...(Node | string | number | null | undefined | false)} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  dress(element, attributes);
  for (const child of children) {
    if (child !== null && child !== undefined && child !== false) element.append(typeof child === "number" ? String(child) : child);
  }
  return element;
}

/**
 * Make an SVG element.
 * @template {keyof SVGElementTagNameMap} K
 * @param {K} tag
 * @param {Record<string, any>} [attributes]
 * @param {...(Node | string)} children
 * @returns {SVGElementTagNameMap[K]}
 */
export function s(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  dress(element, attributes);
  element.append(...children);
  return element;
}

/** @param {Element} element @param {Record<string, any>} attributes */
function dress(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2).toLowerCase(), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, String(value));
  }
}

/** Element by its id, which the page has. @param {string} id @returns {HTMLElement} */
export function byId(id) {
  const element = document.getElementById(id);
  if (!element) throw new Error(`no element ${id}`);
  return element;
}

/** Set a text only if it differs, so that nothing is laid out again for nothing. @param {Element} element @param {string} text */
export function tell(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Strokes of the few symbols that the page draws, on a ground of 16 x 16. */
const SYMBOLS = {
  pause: "M5 3v10M11 3v10",
  play: "M4 2.500l9 5.500-9 5.500z",
  step: "M3 3l6 5-6 5zM12 3v10",
  reset: "M3 8a5 5 0 1 0 1.600-3.700M3 2v3.500h3.500",
  save: "M3 2h8l2 2v10H3zM5.500 2v4h5V2M5 14V9h6v5",
  back: "M7 4L3 8l4 4M3 8h6a4 4 0 0 1 4 4",
  sun: "M8 5a3 3 0 1 0 0 6 3 3 0 0 0 0-6M8 1v2M8 13v2M1 8h2M13 8h2M3 3l1.400 1.400M11.600 11.600L13 13M13 3l-1.400 1.400M4.400 11.600L3 13",
  dock: "M2 3h12v10H2zM10 3v10",
  close: "M4 4l8 8M12 4l-8 8",
  large: "M9 3h4v4M7 13H3V9M13 3L9 7M3 13l4-4",
  link: "M6.500 9.500l3-3M7 4.500l1.500-1.500a3 3 0 0 1 4.500 4.500L11.500 9M9 11.500L7.500 13A3 3 0 0 1 3 8.500L4.500 7",
};

/** A symbol. @param {keyof typeof SYMBOLS} name */
export function symbol(name) {
  return s("svg", { viewBox: "0 0 16 16", "aria-hidden": "true", fill: name === "play" ? "currentColor" : "none", stroke: "currentColor", "stroke-width": 1.6,
    "stroke-linecap": "round", "stroke-linejoin": "round" }, s("path", { d: SYMBOLS[name] }));
}

/** Say something for a few seconds. @param {string} text @param {"" | "good" | "bad"} [mood] */
export function toast(text, mood = "") {
  window.uw.said.push(text);
  if (window.uw.said.length > 50) window.uw.said.shift();
  const place = byId("toasts");
  if ([...place.children].some((child) => child.textContent === text)) return;
  const line = h("div", { class: `toast glass ${mood}` }, text);
  place.append(line);
  while (place.children.length > 4) place.firstElementChild?.remove();
  setTimeout(() => line.remove(), mood === "bad" ? 7000 : 3500);
}

/** A number in few figures; a dash for what is none. @param {unknown} value @param {number} [digits] */
export function figure(value, digits = 3) {
  if (typeof value !== "number") return value === null || value === undefined ? "–" : String(value);
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (Number.isInteger(value) && size < 1e7) return String(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2);
  return value.toFixed(size >= 1000 ? 1 : size >= 100 ? 2 : digits);
}
