// The connection: JSON-RPC over one WebSocket, samples by port, binary frames; it comes back by itself.
/** @typedef {import("../types").Sample} Sample @typedef {import("../types").Status} Status @typedef {import("../types").Told} Told */

/** A refusal of the server, or the loss of the connection (`code` is "lost"). */
export class Refusal extends Error {
  /** @param {string} message @param {string} code @param {string} [where] */
  constructor(message, code, where = "") {
    super(message);
    this.code = code;
    this.where = where;
  }
}

/**
 * @typedef {object} Listeners
 * @property {() => void} opened a session has begun
 * @property {(why: string) => void} lost
 * @property {(data: ArrayBuffer) => void} binary
 * @property {(status: Status) => void} status
 * @property {(told: Told) => void} event
 * @property {(why: string) => void} denied a token is asked for
 * @property {(why: string) => void} refused something that nobody waits for was refused
 */

/** @typedef {{port: string, rate: number, each: (sample: Sample) => void}} Feed */
/** @typedef {{done: (value: any) => void, failed: (why: Error) => void, progress?: (fraction: number) => void}} Waiting */

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 3000;
/** The server tells its status twice a second: a connection of which nothing is heard in so many turns has gone, whatever the browser knows of it. */
const TURN_MS = 1000;
const SILENT_TURNS = 8;

/** One WebSocket to `/live`. */
export class Link {
  /** @param {Listeners} listeners @param {() => string | null} token */
  constructor(listeners, token) {
    this.listeners = listeners;
    this.token = token;
    this.name = `page ${Math.floor(1000 + 9000 * Math.random())}`;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.open = false;
    this.bytes = 0;
    this.nextId = 1;
    /** @type {Map<number, Waiting>} */
    this.waiting = new Map();
    /** @type {Set<Feed>} */
    this.feeds = new Set();
    /** Rate at which each port is subscribed at the server, Hz. @type {Map<string, number>} */
    this.subscribed = new Map();
    this.wait = FIRST_WAIT_MS;
    this.timer = 0;
    /** The token was not taken: nothing is tried before there is another one. */
    this.isDenied = false;
    /** Which binary frames we want. @type {{frames: boolean, pictures: string[]}} */
    this.wish = { frames: true, pictures: [] };
    /** Ports of pictures by their number in the frames. @type {Map<number, string>} */
    this.pictures = new Map();
    /** Number of our session, by which leases name their owner. */
    this.session = -1;
    /** Turns since something was heard. Turns, not time: who has slept, or was busy, listens before it judges. */
    this.silence = 0;
    setInterval(() => this.watch(), TURN_MS);
  }

  /** A network that has gone, or a server that hangs, closes nothing: try again. */
  watch() {
    const { socket } = this;
    if (!socket) return;
    this.silence += 1;
    if (this.silence < SILENT_TURNS) return;
    this.end(socket, "the server says nothing");
    socket.close();
  }

  connect() {
    clearTimeout(this.timer);
    this.isDenied = false;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.silence = 0;
    socket.onopen = () => socket === this.socket && void this.begin(socket);
    socket.onmessage = (event) => socket === this.socket && this.take(event.data);
    socket.onclose = (event) => this.end(socket, event.reason);
  }

  /** @param {WebSocket} socket */
  async begin(socket) {
    const token = this.token();
    try {
      const hello = await this.request("hello", { version: 1, name: this.name, ...(token === null ? {} : { token }) });
      this.session = hello.session;
    } catch (error) {
      if (error instanceof Refusal && error.code === "denied") {
        this.isDenied = true; // who connects again with the same token is locked out: the form is waited for
        this.listeners.denied(error.message);
      }
      socket.close();
      return;
    }
    this.open = true;
    this.wait = FIRST_WAIT_MS;
    this.view(this.wish);
    const ports = new Set([...this.feeds].map((feed) => feed.port));
    for (const port of ports) this.follow(port);
    this.listeners.opened();
  }

  /** @param {WebSocket} socket @param {string} reason */
  end(socket, reason) {
    if (socket !== this.socket) return;
    this.socket = null;
    const was = this.open;
    this.open = false;
    this.subscribed.clear();
    const failed = new Refusal("the connection to the server is lost", "lost");
    for (const waiting of this.waiting.values()) waiting.failed(failed);
    this.waiting.clear();
    if (was || this.wait === FIRST_WAIT_MS) this.listeners.lost(reason);
    if (this.isDenied) return;
    this.timer = setTimeout(() => this.connect(), this.wait);
    this.wait = Math.min(LONGEST_WAIT_MS, this.wait * 1.6);
  }

  /** @param {string | ArrayBuffer} data */
  take(data) {
    this.silence = 0;
    if (typeof data !== "string") {
      this.bytes += data.byteLength;
      this.listeners.binary(data);
      return;
    }
    this.bytes += data.length;
    const message = JSON.parse(data);
    if (message.type === "status") this.listeners.status(message);
    else if (message.type === "event") this.listeners.event(message);
    else if (message.method === "sample") this.sample(message.params);
    else if (message.method === "event") this.listeners.event(message.params);
    else if (message.method === "progress") this.waiting.get(message.params.id)?.progress?.(message.params.fraction);
    else if (message.method === "status") this.listeners.status(message.params);
    else if (message.id !== undefined && message.id !== null) this.answer(message);
    else if (message.error) this.listeners.refused(message.error.message);
  }

  /** @param {Sample} sample */
  sample(sample) {
    for (const feed of this.feeds) if (feed.port === sample.port) feed.each(sample);
  }

  /** @param {{id: number, result?: any, error?: {message: string, data?: {code?: string, where?: string}}}} message */
  answer(message) {
    const waiting = this.waiting.get(message.id);
    this.waiting.delete(message.id);
    if (!waiting) return;
    if (message.error) waiting.failed(new Refusal(message.error.message, message.error.data?.code ?? "", message.error.data?.where));
    else waiting.done(message.result);
  }

  /**
   * Ask for something and wait for the reply.
   * @param {string} method @param {Record<string, unknown>} [params] @param {(fraction: number) => void} [progress]
   * @returns {Promise<any> & {id: number}}
   */
  request(method, params = {}, progress) {
    const id = this.nextId;
    this.nextId += 1;
    const promise = new Promise((done, failed) => {
      if (this.socket?.readyState !== WebSocket.OPEN) {
        failed(new Refusal("not connected to the server", "lost"));
        return;
      }
      this.waiting.set(id, { done, failed, progress });
      this.socket.send(JSON.stringify({ jsonrpc: "2.0", id, method, params }));
    });
    return Object.assign(promise, { id });
  }

  /** @param {string} service @param {Record<string, unknown>} [args] @param {(fraction: number) => void} [progress] @returns {Promise<any>} the service's own result */
  async call(service, args = {}, progress) {
    return (await this.request("call", { service, args }, progress)).value;
  }

  /** @param {string} port @param {Record<string, unknown>} value */
  command(port, value) {
    return this.request("command", { port, value });
  }

  /** Send without waiting for a reply; only a failure is told. @param {string} method @param {Record<string, unknown>} params */
  notify(method, params) {
    if (this.open && this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ jsonrpc: "2.0", method, params }));
  }

  /** Say which binary frames we want. @param {{frames?: boolean, pictures?: string[]}} wish */
  view(wish) {
    this.wish = { ...this.wish, ...wish };
    if (!this.open) return;
    this.request("view", this.wish).then(({ pictures }) => {
      this.pictures = new Map(Object.entries(pictures ?? {}).map(([port, number]) => [/** @type {number} */ (number), port]));
    }, (error) => this.listeners.refused(error.message));
  }

  /** Pictures of these ports were drawn. @param {number[]} numbers */
  seen(numbers) {
    this.notify("seen", { pictures: numbers });
  }

  /**
   * Get samples of a port, at most so many a second.
   * @param {string} port @param {number} rate @param {(sample: Sample) => void} each
   * @returns {() => void} ends it
   */
  subscribe(port, rate, each) {
    const feed = { port, rate, each };
    this.feeds.add(feed);
    if (this.open) this.follow(port);
    return () => {
      if (this.feeds.delete(feed) && this.open) this.follow(port);
    };
  }

  /** Make the server's subscription of a port fit those who listen. @param {string} port */
  follow(port) {
    const rates = [...this.feeds].filter((feed) => feed.port === port).map((feed) => feed.rate);
    const wanted = rates.length ? Math.max(...rates) : 0;
    const now = this.subscribed.get(port) ?? 0;
    if (wanted === now) return;
    if (now) this.request("unsubscribe", { pattern: port }).catch(ignore);
    this.subscribed.delete(port);
    if (!wanted) return;
    this.subscribed.set(port, wanted);
    this.request("subscribe", { pattern: port, rate_hz: wanted, delivery: "latest" }).catch(() => this.subscribed.delete(port));
  }
}

/** What may fail without anyone being worse off. */
export function ignore() {}
