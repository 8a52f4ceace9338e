// The column of panels: tabs, of which one is open.
import { byId, h } from "../core/dom.js";
/** @typedef {import("../core/app.js").App} App */
/** A tab: its name, and what it shows while it is open; `close` ends what it listens to. @typedef {{name: string, title: string, open: (place: HTMLElement) => () => void}} Tab */

/** Tabs after the pattern of WAI-ARIA: arrows move, only the open one is in the order of Tab. */
export class Dock {
  /** @param {App} app @param {Tab[]} tabs */
  constructor(app, tabs) {
    this.app = app;
    this.tabs = tabs;
    this.page = h("div", { class: "page", role: "tabpanel", id: "page", tabindex: 0 });
    this.buttons = tabs.map((tab, k) => h("button", { role: "tab", id: `tab-${tab.name}`, "aria-controls": "page", onclick: () => this.open(tab.name), onkeydown: (/** @type {KeyboardEvent} */ event) => this.move(event, k) }, tab.title));
    byId("dock").append(h("div", { class: "tabs", role: "tablist", "aria-label": "Panels" }, ...this.buttons), this.page);
    /** @type {() => void} */
    this.close = () => {};
    this.now = "";
    this.open(tabs.some((tab) => tab.name === app.address.get("tab")) ? String(app.address.get("tab")) : tabs[0].name);
  }

  /** @param {string} name */
  open(name) {
    this.close();
    this.now = name;
    this.page.replaceChildren();
    this.page.scrollTop = 0;
    this.tabs.forEach((tab, k) => {
      this.buttons[k].setAttribute("aria-selected", String(tab.name === name));
      this.buttons[k].tabIndex = tab.name === name ? 0 : -1;
      if (tab.name !== name) return;
      this.page.setAttribute("aria-labelledby", `tab-${name}`);
      this.close = tab.open(this.page);
    });
    this.app.address.set("tab", name === this.tabs[0].name ? null : name);
  }

  /** @param {KeyboardEvent} event @param {number} k */
  move(event, k) {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    event.preventDefault();
    const next = (k + by + this.tabs.length) % this.tabs.length;
    this.buttons[next].focus();
    this.open(this.tabs[next].name);
  }
}

/** A card with a title. @param {string} title @param {(Node | null)[]} buttons @param {...Node} body */
export function card(title, buttons, ...body) {
  return h("section", { class: "card" }, h("header", {}, h("h2", {}, title), h("span", { class: "grow" }), ...buttons), h("div", { class: "body" }, ...body));
}
