// What stands in the page's address: a link shows a friend the same view. The token is taken out at once and kept for this tab alone.
import { kept } from "./kept.js";

const KEPT = "uwserver.token";

/** Settings in the fragment (`#view=follow&vehicle=rov`), with those of the query (`?fps=5`) as a fall-back. */
export class Address {
  constructor() {
    this.values = new URLSearchParams(location.hash.slice(1));
    this.query = new URLSearchParams(location.search);
    const token = this.values.get("token");
    if (token !== null) {
      kept.here.set(KEPT, token);
      this.values.delete("token");
      this.write();
    }
  }

  /** @returns {string | null} */
  get token() {
    return kept.here.get(KEPT);
  }

  /** @param {string} token */
  keep(token) {
    kept.here.set(KEPT, token);
  }

  /** @param {string} name @returns {string | null} */
  get(name) {
    return this.values.get(name) ?? this.query.get(name);
  }

  /** @param {string} name @param {string | null} value */
  set(name, value) {
    if (this.values.get(name) === value) return;
    if (value === null || value === "") this.values.delete(name);
    else this.values.set(name, value);
    this.write();
  }

  write() {
    const text = this.values.toString();
    history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
  }
}
