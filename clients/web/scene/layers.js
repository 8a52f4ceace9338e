// What may be shown or left out; apart from the scene, so that a page without WebGL does not load three.js for it.
export const LAYERS = /** @type {const} */ ({ trails: "Trails", beams: "Sensor beams", acoustics: "Pings and messages", current: "Current", contacts: "Contacts", labels: "Names", surface: "Sea surface", motes: "Specks in the water", lamps: "Lamps" });
/** @typedef {keyof typeof LAYERS} Layer */

/** Shown unless the address says otherwise. @type {Layer[]} */
export const USUAL = ["trails", "beams", "acoustics", "contacts", "labels", "surface", "motes"];
