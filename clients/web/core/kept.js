// What the browser keeps for the page. Where it keeps nothing (a frame in a page of another site, with such storage blocked), the page itself does until it is closed.

/** Texts by name. */
class Kept {
  /** @param {() => Storage} open throws where there is none */
  constructor(open) {
    /** @type {Map<string, string>} */
    this.here = new Map();
    /** @type {Storage | null} */
    this.storage = null;
    try {
      this.storage = open();
    } catch {
      // `here` is all there is
    }
  }

  /** @param {string} name @returns {string | null} */
  get(name) {
    return this.storage?.getItem(name) ?? this.here.get(name) ?? null;
  }

  /** @param {string} name @param {string} text */
  set(name, text) {
    this.here.set(name, text);
    try {
      this.storage?.setItem(name, text);
    } catch {
      // it is full
    }
  }

  /** @param {string} name */
  forget(name) {
    this.here.delete(name);
    this.storage?.removeItem(name);
  }
}

/** For all pages of this server, and for this one alone. */
export const kept = { always: new Kept(() => localStorage), here: new Kept(() => sessionStorage) };
