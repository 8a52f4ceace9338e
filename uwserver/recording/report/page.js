// The page of a report. `uPlot` stands before it; what is shown is in the element "data". Text reaches the page by textContent alone.
"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const COLOURS = {
  light: ["#0b6e99", "#c2410c", "#15803d", "#7c3aed", "#b91c6b", "#8a6d00", "#475569", "#0f766e"],
  dark: ["#5cc8f2", "#ff9d5c", "#6fdc8c", "#b69cff", "#ff8ac2", "#e5c04b", "#a9b8c6", "#4fd6c4"],
};
const EVENTS = { fault: 1, diverged: 1, adapter_failed: 1, watchdog: 5, autopilot: 3, reset: 4, conflict: 1 };
const root = document.documentElement;
const shown = new Set(data.vehicles.map((vehicle) => vehicle.name));
const plots = new Map();
const state = { begin: 0, end: Math.max(data.end, 1e-3), at: null, quiet: false };
const full = [state.begin, state.end];
window.report = { data, plots, state, errors: [] };

function element(name, text, parent, className) {
  const node = document.createElement(name);
  if (text !== undefined && text !== null) node.textContent = text;
  if (className) node.className = className;
  if (parent) parent.append(node);
  return node;
}
function css(name) { return getComputedStyle(root).getPropertyValue(name).trim(); }
function colours() { return COLOURS[root.dataset.theme]; }
function colourOf(kind) { const c = colours(); return c[(EVENTS[kind] ?? 6) % c.length]; }

/** Numbers of a base64 text of float32; those that are none become null, at which a line breaks. */
function numbers(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return Array.from(new Float32Array(bytes.buffer), (x) => (Number.isFinite(x) ? x : null));
}

// -- what is zoomed to ---------------------------------------------------------------------------------------------------------------
function zoom(begin, end) {
  if (!(end - begin > 1e-6)) return;
  state.begin = Math.max(full[0], begin);
  state.end = Math.min(full[1], end);
  state.quiet = true;
  for (const plot of plots.values()) plot.setScale("x", { min: state.begin, max: state.end });
  state.quiet = false;
  drawMap();
}
function zoomBy(factor) {
  const middle = state.at ?? (state.begin + state.end) / 2, half = (state.end - state.begin) * factor / 2;
  zoom(middle - half, middle + half);
}
function point(t) {
  state.at = t;
  const line = document.getElementById("status");
  if (t === null) { line.textContent = ""; drawMap(); return; }
  const near = (state.end - state.begin) / 150;
  const events = data.events.filter((event) => Math.abs(event[0] - t) < near).slice(0, 3);
  line.textContent = [`t = ${t.toFixed(3)} s`, ...events.map((e) => `${e[0].toFixed(2)} s ${e[1]}: ${e[2]}`)].join("   ·   ");
  drawMap();
}

// -- plots over time -----------------------------------------------------------------------------------------------------------------
function drawEvents(plot) {
  const { left, top, width, height } = plot.bbox, context = plot.ctx, seen = new Set();
  context.save();
  context.globalAlpha = 0.55;
  for (const [t, kind] of data.events) {
    if (t < state.begin || t > state.end) continue;
    const x = Math.round(plot.valToPos(t, "x", true));
    if (x < left || x > left + width || seen.has(x)) continue;
    seen.add(x);
    context.fillStyle = colourOf(kind);
    context.fillRect(x, top, 1, kind === "watchdog" ? 6 * devicePixelRatio : height);
  }
  context.restore();
}
function drawPicture(plot, picture, image) {
  const x0 = plot.valToPos(picture.begin, "x", true), x1 = plot.valToPos(picture.end, "x", true);
  const y0 = plot.valToPos(picture.high, "y", true), y1 = plot.valToPos(picture.low, "y", true);
  const { left, top, width, height } = plot.bbox, context = plot.ctx;
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  context.translate(0, Math.min(y0, y1));
  // The first row of the picture is the far end; where the axis points down that is below.
  if (y0 > y1) { context.translate(0, Math.abs(y1 - y0)); context.scale(1, -1); }
  context.imageSmoothingEnabled = false;
  context.drawImage(image, x0, 0, x1 - x0, Math.abs(y1 - y0));
  context.restore();
}
function content(panel) {
  if (panel.picture) {
    const p = panel.picture;
    return { values: [[p.begin, p.end], [null, null]], lines: [{ label: panel.unit || "row" }] };
  }
  const tables = panel.tables.map((table) => [numbers(table.t), ...table.lines.map((line) => numbers(line.y))]);
  const values = tables.length === 1 ? tables[0] : uPlot.join(tables);
  return { values, lines: panel.tables.flatMap((table) => table.lines) };
}
function options(panel, lines, image, width) {
  const c = colours(), text = css("--dim"), grid = { stroke: css("--line"), width: 1 }, p = panel.picture;
  const axis = { stroke: text, grid, ticks: grid, font: "11px system-ui" };
  const count = lines.length - (panel.band ? 2 : 0);
  return {
    width, height: 210, series: [
      { label: "t, s", value: (_, v) => (v === null ? "" : v.toFixed(2)) },
      ...lines.map((line, k) => ({
        label: line.label, stroke: line.faint ? text : c[k % c.length], width: line.faint ? 1 : 1.4, dash: line.faint ? [4, 4] : undefined,
        points: { show: false }, paths: line.step ? uPlot.paths.stepped({ align: 1 }) : undefined, show: true,
        value: (_, v) => (v === null || v === undefined ? "" : Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(3) : v.toPrecision(5)),
      })),
    ],
    bands: panel.band ? [{ series: [count + 1, count + 2], fill: css("--line") + "55" }] : [],
    scales: {
      x: { time: false, min: state.begin, max: state.end, range: () => [state.begin, state.end] },
      y: p ? { range: () => [p.low, p.high], dir: panel.down ? -1 : 1 } : { dir: panel.down ? -1 : 1 },
    },
    axes: [{ ...axis, size: 30 }, { ...axis, size: 58 }],
    legend: { show: !p },
    cursor: {
      y: false,
      drag: { x: true, y: false, setScale: false },
      sync: { key: "run", setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
      bind: { dblclick: () => () => zoom(...full) },
    },
    hooks: {
      drawClear: p ? [(plot) => image.complete && drawPicture(plot, p, image)] : [],
      draw: [drawEvents],
      setSelect: [(plot) => {
        const { left, width: wide } = plot.select;
        if (wide > 3) zoom(plot.posToVal(left, "x"), plot.posToVal(left + wide, "x"));
        plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      }],
      setCursor: [(plot) => {
        if (plot.cursor.event || plot.cursor.left < 0) point(plot.cursor.left >= 0 ? plot.posToVal(plot.cursor.left, "x") : null);
      }],
    },
  };
}
function build(box, panel) {
  const { values, lines } = content(panel);
  const image = new Image();
  const make = () => {
    plots.get(box)?.destroy();
    plots.set(box, new uPlot(options(panel, lines, image, box.clientWidth), values, box));
  };
  if (!panel.picture) return make();
  image.onload = make;
  image.src = panel.picture.png;
}
const seen = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (entry.isIntersecting && !plots.has(entry.target)) build(entry.target, entry.target.panel);
  }
}, { rootMargin: "400px" });
new ResizeObserver(() => {
  for (const [box, plot] of plots) if (box.clientWidth) plot.setSize({ width: box.clientWidth, height: 210 });
  drawMap();
}).observe(document.body);

// -- the map -------------------------------------------------------------------------------------------------------------------------
const map = { canvas: null, image: null, view: null, tracks: [] };
function fitMap() {
  const { area } = data.map, width = map.canvas.clientWidth, height = map.canvas.clientHeight;
  const scale = Math.min(width / (area[3] - area[2]), height / (area[1] - area[0])) * 0.96;
  map.view = { scale, north: (area[0] + area[1]) / 2, east: (area[2] + area[3]) / 2 };
}
function onMap(north, east) {
  const v = map.view;
  return [map.canvas.clientWidth / 2 + (east - v.east) * v.scale, map.canvas.clientHeight / 2 - (north - v.north) * v.scale];
}
function offMap(x, y) {
  const v = map.view;
  return [v.north - (y - map.canvas.clientHeight / 2) / v.scale, v.east + (x - map.canvas.clientWidth / 2) / v.scale];
}
function nearestTime(track, t) {
  let low = 0, high = track.t.length - 1;
  while (high - low > 1) { const middle = (low + high) >> 1; if (track.t[middle] > t) high = middle; else low = middle; }
  return t - track.t[low] < track.t[high] - t ? low : high;
}
function drawMap() {
  const canvas = map.canvas;
  if (!canvas || !canvas.clientWidth) return;
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
  if (!map.view) fitMap();
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.fillStyle = css("--back");
  g.fillRect(0, 0, width, height);
  if (map.image?.complete) {
    const [south, north, west, east] = data.map.picture.area, [x0, y0] = onMap(north, west), [x1, y1] = onMap(south, east);
    g.drawImage(map.image, x0, y0, x1 - x0, y1 - y0);
  }
  g.lineWidth = 1;
  for (const outline of data.map.outlines) {
    g.beginPath();
    for (const [north, east] of outline.points) g.lineTo(...onMap(north, east));
    g.closePath();
    g.fillStyle = "#6b6b6b99"; g.strokeStyle = "#333";
    g.fill(); g.stroke();
  }
  const c = COLOURS.light;
  for (const track of map.tracks) {
    if (!shown.has(track.vehicle)) continue;
    const line = (colour, wide, dash, all) => {
      g.strokeStyle = colour; g.lineWidth = wide; g.setLineDash(dash); g.beginPath();
      let pen = false;
      for (let i = 0; i < track.t.length; i++) {
        const inside = track.n[i] !== null && (all || (track.t[i] >= state.begin && track.t[i] <= state.end));
        if (inside) { if (pen) g.lineTo(...onMap(track.n[i], track.e[i])); else g.moveTo(...onMap(track.n[i], track.e[i])); }
        pen = inside;
      }
      g.stroke(); g.setLineDash([]);
    };
    const colour = c[track.colour % c.length];
    if (track.faint) { line(colour, 1.2, [5, 4], false); continue; }
    line("#ffffff88", 1.5, [], true);
    line("#ffffff", 4.5, [], false);
    line(colour, 2.5, [], false);
    const last = track.t.length - 1, spot = state.at === null ? last : nearestTime(track, state.at);
    const [x, y] = onMap(track.n[spot], track.e[spot]);
    g.fillStyle = colour; g.strokeStyle = "#fff"; g.lineWidth = 2;
    g.beginPath(); g.arc(x, y, 6, 0, 7); g.fill(); g.stroke();
    g.font = "600 12px system-ui"; g.lineWidth = 3; g.strokeText(track.vehicle, x + 9, y - 6); g.fillText(track.vehicle, x + 9, y - 6);
  }
  drawScale(g, width, height);
}
function drawScale(g, width, height) {
  const wanted = 110 / map.view.scale, power = 10 ** Math.floor(Math.log10(wanted));
  const length = power * (wanted / power >= 5 ? 5 : wanted / power >= 2 ? 2 : 1), pixels = length * map.view.scale;
  g.lineWidth = 3; g.strokeStyle = "#fff"; g.fillStyle = "#14222d"; g.font = "12px system-ui";
  g.strokeText(`${+length.toPrecision(3)} m`, 14, height - 22); g.fillText(`${+length.toPrecision(3)} m`, 14, height - 22);
  g.fillRect(14, height - 16, pixels, 3);
  g.strokeText("N ↑", width - 34, 22); g.fillText("N ↑", width - 34, 22);
}
function makeMap(parent) {
  const card = element("section", null, parent, "card"), m = data.map;
  element("h3", "Track from above", card);
  map.canvas = element("canvas", null, card, "map");
  map.canvas.setAttribute("role", "img");
  map.canvas.setAttribute("aria-label", "Tracks of the vehicles over the sea floor, north up");
  const floor = m.picture ? `sea floor ${m.picture.shallow.toFixed(1)} m (light) to ${m.picture.deep.toFixed(1)} m (dark), a line every ${m.picture.contour} m`
    : m.flat !== null ? `flat sea floor at ${m.flat} m` : "open water";
  element("p", `${floor}; dashed: what an estimator believed. Wheel: zoom, drag: move, double click: all, click: time of the nearest place.`, card, "note");
  map.tracks = m.tracks.map((track) => ({ ...track, t: numbers(track.t), n: numbers(track.n), e: numbers(track.e) }));
  if (m.picture) { map.image = new Image(); map.image.onload = drawMap; map.image.src = m.picture.png; }
  let held = null, moved = 0;
  map.canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const [north, east] = offMap(event.offsetX, event.offsetY), factor = Math.exp(-event.deltaY / 400), v = map.view;
    v.scale *= factor;
    v.north = north - (north - v.north) / factor;
    v.east = east - (east - v.east) / factor;
    drawMap();
  }, { passive: false });
  map.canvas.addEventListener("pointerdown", (event) => { held = [event.offsetX, event.offsetY]; moved = 0; map.canvas.setPointerCapture(event.pointerId); });
  map.canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    moved += Math.abs(event.offsetX - held[0]) + Math.abs(event.offsetY - held[1]);
    map.view.east -= (event.offsetX - held[0]) / map.view.scale;
    map.view.north += (event.offsetY - held[1]) / map.view.scale;
    held = [event.offsetX, event.offsetY];
    drawMap();
  });
  map.canvas.addEventListener("pointerup", (event) => {
    held = null;
    if (moved > 4) return;
    let best = 30, at = null;
    for (const track of map.tracks) {
      if (!shown.has(track.vehicle) || track.faint) continue;
      for (let i = 0; i < track.t.length; i++) {
        if (track.n[i] === null) continue;
        const [x, y] = onMap(track.n[i], track.e[i]), away = Math.hypot(x - event.offsetX, y - event.offsetY);
        if (away < best) { best = away; at = track.t[i]; }
      }
    }
    if (at !== null) point(at);
  });
  map.canvas.addEventListener("dblclick", () => { map.view = null; drawMap(); });
}

// -- the page ------------------------------------------------------------------------------------------------------------------------
function rows(parent, pairs) {
  const body = element("tbody", null, element("table", null, parent));
  for (const [name, value] of pairs) {
    const row = element("tr", null, body);
    element("th", name, row).scope = "row";
    element("td", value, row, "number");
  }
}
function makeTop(main) {
  const cards = element("div", null, main, "cards"), run = element("section", null, cards, "card");
  element("h3", "Run", run);
  rows(run, data.summary);
  for (const remark of data.remarks) element("p", remark, run, "remarks");
  for (const vehicle of data.vehicles) {
    const card = element("section", null, cards, "card");
    card.dataset.vehicle = vehicle.name;
    element("h3", vehicle.model ? `${vehicle.name} (${vehicle.model})` : vehicle.name, card);
    rows(card, vehicle.rows);
  }
}
function makeErrors(parent) {
  if (!data.errors.length) return;
  const card = element("section", null, parent, "card");
  element("h3", "Sensors against the truth", card);
  const table = element("table", null, card), head = element("tr", null, element("thead", null, table));
  for (const name of ["port", "what", "samples", "rms", "within 3 sigma"]) element("th", name, head).scope = "col";
  const body = element("tbody", null, table);
  for (const error of data.errors) {
    const row = element("tr", null, body);
    row.dataset.vehicle = error.vehicle;
    for (const value of [error.path, error.what, error.count, error.rms, error.inside]) element("td", value, row, "number");
  }
}
function makeEvents(parent) {
  const card = element("section", null, parent, "card");
  element("h3", `Events (${data.events.length})`, card);
  const body = element("tbody", null, element("table", null, element("div", null, card, "events")));
  for (const [t, kind, text] of data.events.slice(0, 2000)) {
    const row = element("tr", null, body), button = element("button", `${t.toFixed(2)} s`, element("td", null, row));
    button.addEventListener("click", () => { zoom(t - 5, t + 5); point(t); });
    element("td", kind, row).style.color = colourOf(kind);
    element("td", text, row);
  }
}
function makePlots(main) {
  for (const vehicle of data.vehicles) {
    const part = element("div", null, main);
    part.dataset.vehicle = vehicle.name;
    let group = null, grid = null;
    for (const panel of data.panels.filter((each) => each.vehicle === vehicle.name)) {
      if (panel.group !== group) {
        group = panel.group;
        element("h2", `${vehicle.name}: ${group}`, part);
        grid = element("div", null, part, "plots");
      }
      const card = element("section", null, grid, "card");
      element("h3", panel.unit && panel.unit !== "1" ? `${panel.title}, ${panel.unit}` : panel.title, card);
      const box = element("div", null, card, "plot");
      box.panel = panel;
      const p = panel.picture;
      const scale = p ? `dark ${p.least.toPrecision(3)} to bright ${p.most.toPrecision(3)}${p.unit === "1" ? "" : ` ${p.unit}`}` : "";
      const note = [scale, panel.note].filter(Boolean).join("; ");
      if (note) element("p", note, card, "note");
      seen.observe(box);
    }
  }
}
function show() {
  for (const node of document.querySelectorAll("[data-vehicle]")) node.hidden = !shown.has(node.dataset.vehicle);
  drawMap();
}
function setTheme(theme) {
  root.dataset.theme = theme;
  for (const box of [...plots.keys()]) build(box, box.panel);
  drawMap();
}
function makeHeader() {
  const header = element("header", null, document.body);
  element("h1", data.title, header);
  const button = (text, action) => { const b = element("button", text, header); b.type = "button"; b.addEventListener("click", () => action(b)); return b; };
  if (data.vehicles.length > 1) {
    for (const { name } of data.vehicles) {
      button(name, (b) => {
        if (shown.has(name)) shown.delete(name); else shown.add(name);
        b.setAttribute("aria-pressed", String(shown.has(name)));
        show();
      }).setAttribute("aria-pressed", "true");
    }
  }
  button("Whole run", () => zoom(...full));
  button("Zoom in", () => zoomBy(0.5));
  button("Zoom out", () => zoomBy(2));
  button("Light or dark", () => setTheme(root.dataset.theme === "dark" ? "light" : "dark"));
}
root.dataset.theme = window.matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
makeHeader();
const main = element("main", null, document.body);
makeTop(main);
const second = element("div", null, main, "cards");
second.style.marginTop = ".8rem";
makeMap(second);
const third = element("div", null, second);
makeErrors(third);
makeEvents(third);
makePlots(main);
element("div", "", document.body).id = "status";
drawMap();
