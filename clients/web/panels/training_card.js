// The card of a pilot's training: task, time, score, the best try, and the last one to be watched again.
import { figure, h, tell } from "../core/dom.js";
import { spoken } from "../pilot/words.js";
import { names } from "../pilot/training.js";
import { card } from "./dock.js";
/** @typedef {import("../core/app.js").App} App @typedef {import("../pilot/training.js").Training} Training */

const SAID = /** @type {Record<string, string>} */ ({ ready: "Push to begin: then time runs.", running: "Time runs.", done: "All done.", failed: "The time is over.", off: "Nobody is judged." });

/** @param {unknown} value */
const tenth = (value) => (typeof value === "number" ? value.toFixed(1) : "–");

/** @param {App} app @param {Training} training @returns {[element: HTMLElement, end: () => void]} */
export function trainingCard(app, training) {
  const cells = Object.fromEntries(["task", "hint", "part", "found", "distance", "time", "left", "score", "collisions", "best", "last"].map((name) => [name, h("dd", {}, "–")]));
  const labels = { task: "Task", hint: "Now", part: "Done", found: "Found", distance: "Distance", time: "Time", left: "Left", score: "Score", collisions: "Collisions", best: "Best so far", last: "Last try" };
  const said = h("p", { class: "doc" });
  // Where vehicles are held at the start, one goes back there; elsewhere the task begins where the vehicle is.
  const anew = () => (app.service("world/let_go") ? app.link.call("world/reset") : app.link.call(`${training.path}/set`, { running: true }));
  const again = h("button", { onclick: () => anew().catch((/** @type {Error} */ error) => tell(said, error.message)) }, "Begin anew");
  const mark = h("button", { title: "What the camera shows is a finding: key X", onclick: () => training.mark() }, "Mark");
  const watch = h("button", { onclick: () => training.watch(!training.rerun) });
  const bar = h("input", { type: "range", min: 0, max: 1, step: 0.001, "aria-label": "Time of the try", style: "flex:1;accent-color:var(--accent)", oninput: () => {
    const { rerun } = training;
    if (!rerun) return;
    rerun.playing = false;
    rerun.seek(rerun.from + Number(bar.value) * (rerun.to - rerun.from));
  } });
  const play = h("button", { onclick: () => {
    const { rerun } = training;
    if (!rerun) return;
    if (rerun.t >= rerun.to) rerun.seek(rerun.from);
    rerun.playing = !rerun.playing;
  } });
  const clock = h("b", { class: "mono" });
  const time = h("div", { class: "row" }, play, bar, clock);
  const element = card("Training", [], h("div", { class: "stack" },
    h("dl", { class: "values" }, ...Object.entries(labels).flatMap(([name, text]) => [h("dt", {}, text), cells[name], h("span")])), said, h("div", { class: "row" }, again, mark, watch), time));
  const show = () => {
    const { state, best, ended, rerun } = training;
    element.hidden = !training.path;
    if (!training.path) return;
    const goes = state.state === "ready" || state.state === "running";
    tell(cells.task, goes ? `${figure(state.number)} of ${figure(state.count)}: ${state.task}` : "–");
    tell(cells.distance, goes ? `${tenth(state.distance)} m` : "–");
    tell(cells.hint, goes && state.hint ? `${state.hint}${state.held > 0 ? ` (${figure(state.held, 0)} of ${figure(state.hold, 0)} s)` : ""}` : "–");
    tell(cells.part, typeof state.part === "number" ? `${figure(100 * state.part, 0)} %` : "–");
    const there = names(state.found);
    tell(cells.found, there.length || state.missing > 0 ? `${there.length} of ${there.length + state.missing}${there.length ? `: ${there.map(spoken).join(", ")}` : ""}` : "–");
    mark.hidden = !state.marks;
    mark.disabled = state.state !== "running" || Boolean(rerun);
    for (const name of ["time", "left"]) tell(cells[name], `${tenth(state[name])} s`);
    for (const name of ["score", "collisions"]) tell(cells[name], typeof state[name] === "number" ? String(Math.round(state[name])) : "–");
    tell(cells.best, best ? `${Math.round(best.score)} in ${tenth(best.time)} s` : "–");
    tell(cells.last, ended ? ended.state === "broken off" ? "broken off" : `${Math.round(ended.score)} in ${tenth(ended.time)} s` : "–");
    tell(said, rerun ? "This is your last try. The world goes on meanwhile." : (SAID[state.state] ?? ""));
    again.disabled = Boolean(app.status.playback) || Boolean(app.world?.read_only);
    watch.disabled = !ended;
    tell(watch, rerun ? "Back to the present" : "Watch the last try");
    watch.classList.toggle("primary", rerun !== null);
    time.hidden = rerun === null;
  };
  const timer = setInterval(() => {
    const { rerun } = training;
    if (!rerun) return;
    bar.value = String((rerun.t - rerun.from) / Math.max(1e-6, rerun.to - rerun.from));
    tell(play, rerun.playing ? "Pause" : "Play");
    tell(clock, `${(rerun.t - rerun.from).toFixed(1)} s`);
  }, 100);
  const endings = [app.on("training", show), app.on("world", show), app.on("status", show)];
  show();
  return [element, () => {
    clearInterval(timer);
    for (const end of endings) end();
  }];
}
