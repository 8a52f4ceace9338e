// The picture in three dimensions, as the page uses it: one stage, and a scene that is built again when the world changes.
import { toast } from "./dom.js";
import { WorldScene } from "../scene/scene.js";
import { Stage } from "../scene/stage.js";
import { Views } from "../scene/views.js";
/** @typedef {import("./app.js").App} App @typedef {import("../scene/views.js").View} View */

/** Draws the world of an `App`. */
export class Drawing {
  /** @param {App} app @param {import("../pilot/pilot.js").Pilot} pilot @param {import("../scene/craft.js").Store} store @param {"auto" | "low" | "high"} quality */
  constructor(app, pilot, store, quality) {
    const canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("scene"));
    this.app = app;
    this.pilot = pilot;
    this.store = store;
    this.stage = new Stage(canvas, quality);
    this.views = new Views(this.stage.camera, canvas);
    this.clear = false;
    /** @type {WorldScene | null} */
    this.scene = null;
    /** @type {View} */
    this.view = "orbit";
    /** Name of the body about which the camera is. @type {string | null} */
    this.followed = null;
    this.lost = false;
    app.on("world", () => this.build());
    if (app.world) this.build();
    app.on("chosen", () => this.choose());
    app.on("layers", () => this.choose());
    new ResizeObserver(() => this.stage.resize()).observe(canvas);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.lost = true;
      toast("The graphics card was lost; the picture comes back by itself, or by loading the page again.", "bad");
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.lost = false;
      this.build();
    });
  }

  build() {
    this.scene?.dispose();
    this.scene = null;
    if (!this.app.world) return;
    this.scene = new WorldScene(this.app.world, this.stage, this.views, this.app.link, this.store);
    this.scene.clear = this.clear;
    this.choose();
  }

  /** The camera stays where one has put it while the same body is followed, whatever else changes. */
  choose() {
    if (!this.scene) return;
    this.scene.choose(this.app.chosen, this.app.layers);
    const name = this.app.bodies[this.app.chosen]?.name ?? "";
    if (name !== this.followed) this.setView(this.view);
    this.followed = name;
  }

  /** @param {View} view */
  setView(view) {
    this.view = view;
    const craft = this.scene?.crafts[this.app.chosen];
    this.views.choose(view, craft ? Math.max(craft.size.x, craft.size.y) : 0.6);
  }

  /** @param {boolean} clear */
  setClear(clear) {
    this.clear = clear;
    if (this.scene) this.scene.clear = clear;
  }

  /** @param {import("./frames.js").Timeline} timeline @param {number[] | null} aim where a training leads to, in N @param {number} dt s of wall time */
  draw(timeline, aim, dt) {
    if (!this.scene || this.lost || document.hidden) return;
    this.views.tilt = this.pilot.tilt;
    this.scene.aim.show(aim, timeline.t, this.stage.camera);
    this.scene.update(timeline, dt, this.app.layers);
    this.stage.render();
  }
}
