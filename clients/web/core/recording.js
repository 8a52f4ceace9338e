// Recordings of the server: begun and ended from the bar above and from a card.
import { h, tell, toast } from "./dom.js";
/** @typedef {import("./app.js").App} App */

/** @param {number} bytes */
export function size(bytes) {
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(2)} GB`;
}

/** Where the file is, how large, since when, and why it ended if it did. @param {App} app */
export function about(app) {
  const { recorder, recording } = app.status;
  if (!recorder) return "Nothing was recorded yet.";
  const since = `from ${(recorder.since_ns / 1e9).toFixed(1)} s`;
  if (recording) return `Recording ${recorder.name}, ${size(recorder.bytes)} ${since}, to ${recorder.path}`;
  return recorder.error ? `${recorder.path} ended early: ${recorder.error}` : `Recorded ${recorder.name}, ${size(recorder.bytes)} ${since}: ${recorder.path}`;
}

/** Begin a recording, or end the one that goes on. @param {App} app */
export async function turn(app) {
  const ends = Boolean(app.status.recording);
  try {
    const told = await app.link.call(ends ? "recording/stop" : "recording/start");
    if (ends) toast(told.error ? `${told.path} ended early: ${told.error}` : `Recorded ${size(told.bytes)} to ${told.path}`, told.error ? "bad" : "good");
  } catch (error) {
    toast(/** @type {Error} */ (error).message, "bad");
  }
}

/** The button of the bar. */
export class RecordButton {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.name = h("span", { class: "name" });
    this.size = h("span", {});
    this.element = h("button", { class: "rec live optional", "aria-pressed": "false", onclick: () => this.press() }, "REC", this.name, this.size);
    this.waits = false;
  }

  async press() {
    this.waits = this.element.disabled = true;
    await turn(this.app);
    this.waits = false;
  }

  /** @param {boolean} barred */
  show(barred) {
    const { recording, recorder } = this.app.status;
    const on = Boolean(recording);
    this.element.disabled = barred || this.waits;
    this.element.classList.toggle("on", on);
    this.element.classList.toggle("optional", !on); // on a narrow page it is there while the server records
    this.element.setAttribute("aria-pressed", String(on));
    tell(this.name, on && recorder ? ` ${recorder.name}` : "");
    tell(this.size, on && recorder ? ` ${size(recorder.bytes)}` : "");
    this.name.hidden = this.size.hidden = !on;
    this.element.title = on ? `${about(this.app)}. Push to end it.` : "Record what happens from now on";
  }
}
