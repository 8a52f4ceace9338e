// The pilot's panel: who steers, modes, sticks, keys, gamepad.
import { h, tell } from "../core/dom.js";
import { kept } from "../core/kept.js";
import { trainingCard } from "./training_card.js";
import { AXES } from "../pilot/sticks.js";
import { DIRECT } from "../pilot/pilot.js";
import { spoken } from "../pilot/words.js";
/** @typedef {import("../core/app.js").App} App @typedef {import("../pilot/pilot.js").Pilot} Pilot */

const NAMES = { surge: "Ahead", sway: "Aside", heave: "Down", roll: "Roll", pitch: "Pitch", yaw: "Turn" };
const SHOWN = [0, 1, 2, 5];
/** @type {[string[], string][]} */
const KEY_HELP = [
  [["W", "S"], "ahead, astern"], [["A", "D"], "turn to port, starboard"], [["Q", "E"], "aside to port, starboard"], [["R", "F"], "up, down"], [["Shift"], "held: a third of the speed"],
  [["Space"], "all stop"], [["Enter"], "take control"], [["1", "2", "3", "4"], "orbit, follow, on board, top"], [["N"], "next vehicle"], [["M"], "large map"], [["K"], "pause, go on"], [["L"], "lamps"], [["X"], "mark a finding"], [["P"], "panels"], [["↑", "↓"], "tilt of the camera"],
];

/** Of a recording that plays, whose time is steered. @type {[string[], string][]} */
const TIME_HELP = [
  [["Space"], "play, pause"], [["←", "→"], "one frame; with Shift 5 s"], [["[", "]"], "slower, faster"], [["1", "2", "3", "4"], "orbit, follow, on board, top"], [["N"], "next vehicle"], [["M"], "large map"], [["P"], "panels"],
];

/** @param {App} app @param {Pilot} pilot @param {import("../pilot/training.js").Training} training */
export function pilotTab(app, pilot, training) {
  return (/** @type {HTMLElement} */ place) => {
    const who = h("span", { class: "who grow" });
    const take = h("button", { onclick: () => (pilot.owns ? pilot.give() : pilot.take()) });
    const force = h("button", { onclick: () => confirm(`${pilot.owner?.owner ?? "Somebody"} steers ${app.vehicle}. Take it from them?`) && pilot.take(true) }, "Take over");
    const owner = h("div", { class: "owner" }, who, take, force);
    const modes = h("div", { class: "modes", role: "group", "aria-label": "Modes of the autopilot" });
    const note = h("p", { class: "doc" });
    const bars = SHOWN.map(() => ({ fill: h("i"), number: h("b", {}, "0") }));
    const gain = h("input", { type: "range", min: 0.1, max: 1, step: 0.05, "aria-label": "Gain", style: "flex:1;accent-color:var(--accent)", oninput: () => {
      pilot.gain = Number(gain.value);
      kept.always.set("uwserver.gain", gain.value);
      tell(gainText, `${Math.round(100 * pilot.gain)} %`);
    } });
    gain.value = String(pilot.gain);
    const gainText = h("b", { class: "mono" }, `${Math.round(100 * pilot.gain)} %`);
    const keyList = h("dl", { class: "keys" });
    const padPlace = h("div", { class: "stack" });
    const [tries, endTries] = trainingCard(app, training);
    // What cannot be steered shows no sticks.
    const steering = h("div", { class: "steering" }, h("h3", {}, "Sticks"),
      h("div", { class: "sticks" }, ...SHOWN.map((axis, k) => h("div", { class: "stick" }, h("span", {}, NAMES[AXES[axis]]), h("div", { class: "bar" }, bars[k].fill), bars[k].number))),
      h("div", { class: "row", style: "margin-top:8px" }, h("span", { class: "dim" }, "Gain"), gain, gainText),
      h("h3", {}, "Gamepad"), padPlace);
    place.append(h("div", { class: "stack" }, owner, modes, note, tries), steering, h("h3", {}, "Keys"), keyList);

    const show = () => {
      const { owns, owner: there, barred } = pilot;
      owner.className = `owner ${owns ? "mine" : there ? "theirs" : ""}`;
      tell(who, barred ? barred : !app.vehicle ? "Choose a vehicle" : owns ? `You steer ${app.vehicle}` : there ? `${there.owner} steers ${app.vehicle}` : `Nobody steers ${app.vehicle}`);
      tell(take, owns ? "Give up" : "Take control");
      take.className = owns ? "" : "primary";
      take.hidden = (Boolean(there) && !owns) || Boolean(barred);
      steering.hidden = Boolean(barred);
      modes.hidden = Boolean(barred);
      take.disabled = !app.vehicle || !app.connected || Boolean(barred);
      force.hidden = !there || owns || Boolean(barred);
      showKeys();
      showModes();
      showPad();
    };
    const showKeys = () => {
      const of = app.status.playback ? "time" : "vehicle";
      if (keyList.dataset.of === of) return;
      keyList.dataset.of = of;
      keyList.replaceChildren(...(of === "time" ? TIME_HELP : KEY_HELP).flatMap(([keys, text]) => [h("dt", {}, ...keys.map((key) => h("kbd", {}, key))), h("dd", {}, text)]));
    };
    const showModes = () => {
      const names = pilot.hasAutopilot ? pilot.modes : [];
      if (modes.dataset.names !== `${names} ${pilot.barred}`) {
        modes.dataset.names = `${names} ${pilot.barred}`;
        modes.replaceChildren(...names.map((mode) => h("button", { "data-mode": mode, title: mode === DIRECT ? "Disarm: sticks go to the actuators" : "Arm the autopilot in this mode", disabled: Boolean(pilot.barred), onclick: () => pilot.setMode(mode) }, mode === DIRECT ? "Direct" : spoken(mode))));
      }
      for (const button of modes.children) button.setAttribute("aria-pressed", String(/** @type {HTMLElement} */ (button).dataset.mode === pilot.mode));
      tell(note, !app.vehicle || pilot.barred ? "" : pilot.hasAutopilot ? (pilot.state.failsafe ? `Fail-safe: ${pilot.state.failsafe}` : pilot.armed ? "Armed. A click on the map sends it there." : "Disarmed: sticks go to the actuators. A mode arms the autopilot.")
        : "This vehicle has no autopilot: sticks go to its actuators.");
    };
    const showPad = () => {
      const { pad } = pilot;
      const sign = `${pad.id} ${pad.learning} ${JSON.stringify(pad.mapping)}`;
      if (padPlace.dataset.sign === sign) return;
      padPlace.dataset.sign = sign;
      if (!pad.id) {
        padPlace.replaceChildren(h("p", { class: "doc" }, "None yet: plug it in and press one of its buttons; browsers show a gamepad only then."));
        return;
      }
      padPlace.replaceChildren(h("div", { class: "dim" }, pad.id),
        h("div", { class: "mapping" }, ...SHOWN.flatMap((stick) => {
          const [axis, way] = pad.mapping.axes[stick];
          const waiting = pad.learning === stick;
          return [h("span", {}, NAMES[AXES[stick]]), h("span", { class: "mono" }, axis < 0 ? "–" : `${way < 0 ? "−" : "+"} axis ${axis}`), h("button", { class: waiting ? "waiting" : "", "aria-label": `Set the axis of ${NAMES[AXES[stick]]}`, onclick: () => { pad.begin(stick); show(); } }, waiting ? "move it" : "Set")];
        })),
        h("div", { class: "row" }, h("span", { class: "dim grow" }, Object.entries(pad.mapping.buttons).map(([button, action]) => `${button}: ${spoken(action)}`).join(" · ")), h("button", { onclick: () => pad.forget() }, "Usual")));
    };
    const timer = setInterval(() => bars.forEach(({ fill, number }, k) => {
      const value = pilot.sticks[SHOWN[k]];
      fill.style.left = `${50 + 50 * Math.min(0, value)}%`;
      fill.style.width = `${50 * Math.abs(value)}%`;
      tell(number, value.toFixed(2));
    }), 80);
    const endings = [app.on("pilot", show), app.on("world", show), app.on("described", show), app.on("status", show), app.on("chosen", show), app.on("link", show)];
    show();
    return () => {
      clearInterval(timer);
      endTries();
      for (const end of endings) end();
    };
  };
}
