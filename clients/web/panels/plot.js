// Fields of a port over the last minute of simulation.
import uPlot from "uplot";
/** @typedef {import("../types").Port} Port @typedef {import("../types").Sample} Sample @typedef {import("../core/app.js").App} App */

const WINDOW_S = 60;
const MOST = 1800;
const MOST_SERIES = 6;
const REDRAW_MS = 200;
/** Width of a figure on the vertical axis, and what stands beside it; px. */
const [FIGURE, BESIDE, LEAST] = [6.7, 18, 44];

/** Room for the longest number of the vertical axis. @param {uPlot} _ @param {string[] | null} values */
const room = (_, values) => Math.max(LEAST, ...(values ?? []).map((text) => BESIDE + FIGURE * String(text).length));

/** Names of all numbers in a field: itself, or its elements. @param {import("../types").Field} field */
export function numbersOf(field) {
  if (!["float", "int", "bool"].includes(field.type)) return [];
  const count = field.shape.reduce((product, extent) => product * Math.max(0, extent), 1);
  if (field.shape.length === 0) return [field.name];
  return Array.from({ length: Math.min(count, MOST_SERIES) }, (_, k) => `${field.name}[${k}]`);
}

/** @param {Record<string, unknown>} value @param {string} name such as "v_S[1]" */
export function numberAt(value, name) {
  const [field, index] = name.split("[");
  const whole = value[field];
  const raw = index === undefined ? whole : Array.isArray(whole) ? whole.flat(3)[parseInt(index, 10)] : undefined;
  if (typeof raw === "boolean") return Number(raw);
  return typeof raw === "number" && Number.isFinite(raw) ? raw : null;
}

/** @param {Port} port @param {string} fieldName @param {App} app @param {HTMLElement} place @returns {() => void} */
export function plotPanel(port, fieldName, app, place) {
  const field = port.fields.find((candidate) => candidate.name === fieldName) ?? port.fields[0];
  const names = numbersOf(field);
  /** @type {(number | null)[][]} */
  const data = [[], ...names.map(() => [])];
  /** @type {uPlot | null} */
  let plot = null;
  let dirty = false;
  const build = () => {
    plot?.destroy();
    const axis = { stroke: app.colour("dim"), grid: { stroke: app.colour("line"), width: 1 }, ticks: { stroke: app.colour("line"), width: 1 }, font: "11px system-ui", size: room };
    plot = new uPlot({
      width: Math.max(200, place.clientWidth), height: 150, cursor: { y: false }, legend: { show: true, live: true },
      scales: { x: { time: false } },
      axes: [{ ...axis, size: 28, values: (_, splits) => splits.map((split) => `${split}`) }, axis],
      series: [{ label: "t", value: (_, value) => (value === null ? "–" : `${value.toFixed(2)} s`) }, ...names.map((name, k) => ({ label: name, stroke: app.colour(`series-${k + 1}`), width: 1.6, points: { show: false }, spanGaps: false, value: (/** @type {uPlot} */ _, /** @type {number | null} */ value) => (value === null ? "–" : value.toPrecision(4)) }))],
    }, /** @type {any} */ (data), place);
  };
  build();
  const stop = app.link.subscribe(port.path, 15, (sample) => {
    const t = sample.t_ns / 1e9;
    const times = data[0];
    if (times.length && t <= Number(times[times.length - 1])) {
      if (t < Number(times[times.length - 1]) - 1e-9) for (const row of data) row.length = 0;
      else return;
    }
    times.push(t);
    names.forEach((name, k) => data[k + 1].push(sample.valid ? numberAt(sample.value, name) : null));
    let drop = 0;
    while (times.length - drop > MOST || Number(times[drop]) < t - WINDOW_S) drop += 1;
    if (drop) for (const row of data) row.splice(0, drop);
    dirty = true;
  });
  const timer = setInterval(() => {
    if (!dirty || document.hidden) return;
    dirty = false;
    plot?.setData(/** @type {any} */ (data));
    if (plot && (plot.cursor.left ?? -1) < 0) plot.setLegend({ idx: data[0].length - 1 });
  }, REDRAW_MS);
  const watch = new ResizeObserver(() => plot && plot.width !== place.clientWidth && place.clientWidth > 0 && plot.setSize({ width: place.clientWidth, height: 150 }));
  watch.observe(place);
  const themed = app.on("theme", build);
  return () => {
    stop();
    themed();
    clearInterval(timer);
    watch.disconnect();
    plot?.destroy();
  };
}
