// What tests/integration/test_web_page.py asks the page: measurements, put into it before its own scripts run.
globalThis.probe = {
  /** Pixels of a picture drawn now. */
  pixels() {
    uw.drawing.draw(uw.app.timeline, null, 0);
    const gl = uw.drawing.stage.renderer.getContext();
    const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    const data = new Uint8Array(4 * w * h);
    gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, data);
    return { w, h, data };
  },

  /** Which pixels a vehicle covers: how many, the middle of them, and where its origin should be; parts of the picture, from below left. */
  drawn(name) {
    for (const layer of ["beams", "trails", "surface", "motes"]) uw.app.layers.delete(layer);
    uw.app.emit("layers");
    uw.app.choose(uw.app.bodies.findIndex((body) => body.name === name));
    const { scene, stage } = uw.drawing;
    const craft = scene.crafts[uw.app.chosen].looks;
    const shown = probe.pixels();
    craft.visible = false;
    const without = probe.pixels();
    craft.visible = true;
    let [n, x, y] = [0, 0, 0];
    for (let i = 0; i < shown.data.length; i += 4) {
      const off = [0, 1, 2].reduce((sum, c) => sum + Math.abs(shown.data[i + c] - without.data[i + c]), 0);
      if (off < 12) continue;
      n += 1;
      x += (i / 4) % shown.w;
      y += Math.floor(i / 4 / shown.w);
    }
    const p = uw.vehicles[name];
    const at = stage.camera.position.clone().set(p[1], -p[2], -p[0]).project(stage.camera);
    return { n, x: x / n / shown.w, y: y / n / shown.h, at: [(at.x + 1) / 2, (at.y + 1) / 2] };
  },

  /** Interpolation between frames, and what thrusters make of sticks. */
  async numbers() {
    const { Timeline } = await import("/core/frames.js");
    const { patterns, mixed } = await import("/pilot/allocation.js");
    const frame = (t, arrived, x) => ({
      t, arrived, flags: 0, revision: 1, count: 1, poses: Float32Array.of(x, 0, 0, 1, 0, 0, 0), achieved: new Int8Array(0),
    });
    const line = new Timeline();
    line.period = 0.1;
    line.add(frame(1, 10, 0));
    line.add(frame(1.1, 10.1, 0.4));
    line.at(10.2);
    const half = [line.poses[0], line.t];
    line.at(99);
    const late = line.poses[0];
    line.add(frame(1.2, 10.2, 7));
    line.at(10.31);
    const jump = line.poses[0];
    line.add(frame(1.3, 10.3, NaN));
    line.at(10.41);
    const none = Number.isNaN(line.poses[0]);
    const { breaks } = line;
    line.add(frame(0, 10.4, 0));
    const { propulsors } = uw.app.port("rov/thrusters");
    const rows = patterns(propulsors);
    const push = (sticks) => {
      const u = mixed(rows, sticks);
      return propulsors.reduce((sum, p, k) => sum.map((part, i) => part + p.axis_B[i] * u[k]), [0, 0, 0]);
    };
    const most = Math.max(...mixed(rows, [1, 1, 1, 0, 0, 1]).map(Math.abs));
    return { half, late, jump, none, breaks: line.breaks - breaks, surge: push([1, 0, 0, 0, 0, 0]), heave: push([0, 0, 1, 0, 0, 0]), most };
  },

  /** Put a value into the field with this label, as by hand. */
  choose(label, value) {
    const field = document.querySelector(`[aria-label="${label}"]`);
    field.value = value;
    field.dispatchEvent(new Event("change"));
  },

  /** A mission written as a plan and read again, what its first place is on the Earth, and what is said of plans that are none. */
  async plans() {
    const { items, mission: readBack, written, parsed } = await import("/pilot/plan.js");
    const origin = { latitude: (63.43 * Math.PI) / 180, longitude: (10.4 * Math.PI) / 180 };
    const mission = { speed: 0.7, waypoints: [
      { north: 1000, east: 0, height: "depth", metres: 5, hold: 3 }, { north: -2, east: 500, height: "depth", metres: 0, hold: 0 }, { north: 3, east: 4, height: "altitude", metres: 2.5, hold: 0 },
    ] };
    const text = written(mission, origin);
    const place = JSON.parse(text).mission.items[1].params;
    const said = (changed) => {
      try {
        return parsed(changed, origin).left;
      } catch (error) {
        return error.message;
      }
    };
    const other = (change) => {
      const plan = JSON.parse(text);
      change(plan.mission.items);
      return said(JSON.stringify(plan));
    };
    const framed = (frame, up) => {
      const plan = JSON.parse(text);
      Object.assign(plan.mission.items[1], { frame });
      plan.mission.items[1].params[6] = up;
      const { height, metres } = parsed(JSON.stringify(plan), origin).waypoints[0];
      return [height, metres];
    };
    const modes = (kinds) => {
      const plan = JSON.parse(written({ speed: null, waypoints: kinds.map((height) => ({ ...mission.waypoints[2], height })) }, origin)).mission;
      return [plan.globalPlanAltitudeMode, ...plan.items.flatMap((item) => [item.frame, item.AltitudeMode, item.Altitude, item.params[6]])];
    };
    const asked = items(mission);
    return {
      back: parsed(text, origin), latitude: place[4], asked, again: readBack(asked).waypoints,
      ne: readBack([{ kind: "waypoint", position_ne_m: [1, 2], depth_m: 7 }]).waypoints[0],
      frames: [0, 3, 5, 6, 10, 11].map((frame) => framed(frame, frame < 10 ? -4 : 4)), modes: [modes(["depth"]), modes(["altitude"]), modes(["depth", "altitude"])],
      faults: [
        said("{"), said('{"fileType": "Plan"}'), said("x".repeat(2 << 20)), other((items) => { items[1].params[4] = null; }),
        other((items) => { items[2].params[5] = 14; }), other((items) => { items[1].frame = 8; }), other((items) => { items[3].params[6] = 0; }), other((items) => { items[2].command = 20; }),
        other((items) => { for (let k = 0; k < 700; k += 1) items.push(items[1]); }),
      ],
    };
  },

  /** Texts with less contrast to their ground than 4.5 : 1 (WCAG 2.2, AA). */
  faint() {
    const linear = (v) => (v / 255 <= 0.03928 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
    const level = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
    const parts = (text) => {
      const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number);
      return [r, g, b, a];
    };
    const ground = (element) => {
      let [colour, left] = [[0, 0, 0], 1];
      for (let e = element; e && left > 0.01; e = e.parentElement) {
        const painted = parts(getComputedStyle(e).backgroundColor);
        colour = colour.map((v, i) => v + left * painted[3] * painted[i]);
        left *= 1 - painted[3];
      }
      return colour;
    };
    const found = [];
    for (const element of document.querySelectorAll("#header *, #footer *, #dock *, #tools *")) {
      const own = [...element.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.textContent.trim());
      if (!own || !element.checkVisibility() || element.closest(":disabled, option, svg")) continue;
      const [a, b] = [level(parts(getComputedStyle(element).color)), level(ground(element))];
      const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (ratio < 4.5) found.push([element.textContent.slice(0, 30), ratio]);
    }
    return found;
  },

  /** Controls that a screen reader has no name for. */
  nameless() {
    return [...document.querySelectorAll("button, input, select, textarea")]
      .filter((e) => e.checkVisibility() && !e.textContent.trim() && !e.getAttribute("aria-label") && !e.closest("label"))
      .map((e) => e.outerHTML.slice(0, 90));
  },

  /** From now on, note what gets the focus. Gives how many controls there are. */
  watchFocus() {
    const all = [...document.querySelectorAll("button, select, input, canvas[tabindex]")];
    probe.wanted = all.filter((e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0);
    probe.reached = new Set();
    document.addEventListener("focusin", (event) => probe.reached.add(event.target));
    document.activeElement.blur();
    return probe.wanted.length;
  },

  unreached() {
    return probe.wanted.filter((e) => !probe.reached.has(e)).map((e) => e.outerHTML.slice(0, 90));
  },

  /** Colours on the map. */
  colours() {
    const map = document.querySelector("#map canvas");
    if (map.width < 300) return 0;
    return new Set(new Uint32Array(map.getContext("2d").getImageData(0, 0, map.width, map.height).data.buffer)).size;
  },

  card(title) {
    return [...document.querySelectorAll(".card")].find((card) => card.querySelector("h2").textContent === title);
  },
};
