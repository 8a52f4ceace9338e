// Which vehicle, and from where it is seen.
import { byId, h } from "./dom.js";
/** @typedef {import("./app.js").App} App @typedef {"orbit" | "follow" | "board" | "top"} View */

const VIEWS = /** @type {[View, string][]} */ ([["orbit", "Orbit"], ["follow", "Follow"], ["board", "On board"], ["top", "Top"]]);

/** The bar over the picture. */
export class Chooser {
  /** @param {App} app @param {(view: View) => void} onView @param {() => boolean} draws whether there is a picture to view */
  constructor(app, onView, draws) {
    this.app = app;
    this.onView = onView;
    this.draws = draws;
    this.buttons = VIEWS.map(([view, text], k) => h("button", { "data-view": view, title: `${text} (${k + 1})`, onclick: () => this.view(view) }, text));
    this.bar = h("div", { class: "glass", role: "group", "aria-label": "View" }, ...this.buttons);
    this.select = h("select", { "aria-label": "Vehicle", title: "Vehicle (N for the next)", onchange: () => app.choose(Number(this.select.value)) });
    this.box = h("div", { class: "glass" }, this.select);
    byId("tools").append(this.bar, this.box);
    const asked = app.address.get("view");
    /** @type {View} */
    this.now = VIEWS.some(([view]) => view === asked) ? /** @type {View} */ (asked) : "orbit";
    app.on("world", () => this.list());
    app.on("chosen", () => { this.select.value = String(app.chosen); });
  }

  list() {
    const { bodies } = this.app;
    this.select.replaceChildren(...bodies.map((body, k) => h("option", { value: k }, body.model === "object" ? body.name : `${body.name} · ${body.model}`)));
    this.select.value = String(this.app.chosen);
    this.box.hidden = bodies.length === 0;
  }

  show() {
    this.bar.hidden = !this.draws();
    this.view(this.now);
  }

  /** @param {View} view */
  view(view) {
    this.now = view;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.view === view));
    this.app.address.set("view", view === "orbit" ? null : view);
    this.onView(view);
  }
}
