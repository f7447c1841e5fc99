"use strict";
// Zoom and pan of whole recordings. A trace tells in data-of how its whole numbers become times and values: seconds a
// step, the value at zero, and the value of a unit. Without this script the drawings are whole and stand still.
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const SHORTEST = 8; // samples in view
  const ROOM = 0.06;

  const made = (kind, attributes, parent) => {
    const element = document.createElementNS(NS, kind);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    if (parent) parent.append(element);
    return element;
  };
  const stepOf = (span, count) => {
    const least = span / count;
    const power = 10 ** Math.floor(Math.log10(least));
    return power * ([1, 2, 5, 10].find((m) => m * power >= least * 0.999) || 10);
  };
  const ticksOf = (low, high, count) => {
    const step = stepOf(high - low, count);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12) + 1e-15; k++) {
      found.push([k * step, (k * step).toFixed(Math.min(digits, 12)).replace("-", "−")]);
    }
    return found;
  };
  const shown = (value) => String(Number(value.toPrecision(4))).replace("-", "−");

  // Points of a path of relative whole numbers; a new piece begins with m.
  const parsed = (group) => {
    const [step, low, unit] = group.dataset.of.split(" ").map(Number);
    const [t, y, begins] = [[], [], []];
    let [a, b] = [0, 0];
    for (const piece of group.firstElementChild.getAttribute("d").split("m").slice(1)) {
      begins[t.length] = true;
      const numbers = piece.match(/-?\d+/g).map(Number);
      for (let i = 0; i < numbers.length; i += 2) {
        a += numbers[i];
        b += numbers[i + 1];
        t.push(a * step);
        y.push(low + b * unit);
      }
    }
    return { group, name: group.dataset.name, step, low, unit, t, y, begins };
  };
  const after = (t, at) => {
    let [a, b] = [0, t.length];
    while (a < b) {
      const middle = (a + b) >> 1;
      if (t[middle] < at) a = middle + 1;
      else b = middle;
    }
    return a;
  };

  class Plot {
    constructor(svg) {
      this.svg = svg;
      this.frame = svg.querySelector("svg");
      [this.left, this.top, this.wide, this.high] = ["x", "y", "width", "height"].map((n) => +this.frame.getAttribute(n));
      this.name = svg.querySelector("text.name").textContent.split(", rms")[0];
      this.traces = [...this.frame.querySelectorAll("g.trace")].map(parsed);
      const first = this.traces[0];
      const scale = -Number(first.group.getAttribute("transform").split(/[( )]+/)[4]);
      this.whole = [first.low, first.low + (first.unit * this.high) / scale];
      this.shade = made("rect", { class: "shade", y: 0, height: this.high, width: 0 }, this.frame);
      this.cursor = made("path", { class: "cursor" }, this.frame);
    }

    range(from, to, everything) {
      if (everything) return this.whole;
      const room = this.whole[1] - this.whole[0];
      let [low, high] = [Infinity, -Infinity];
      for (const { t, y } of this.traces) {
        for (let i = Math.max(0, after(t, from) - 1); i < t.length && t[i] <= to; i++) {
          const value = Math.min(Math.max(y[i], this.whole[0] - room), this.whole[1] + room);
          low = Math.min(low, value);
          high = Math.max(high, value);
        }
      }
      if (!(high > low)) return this.whole;
      return [low - ROOM * (high - low), high + ROOM * (high - low)];
    }

    draw(from, to, everything) {
      const [low, high] = this.range(from, to, everything);
      const [across, up] = [this.wide / (to - from), this.high / (high - low)];
      for (const trace of this.traces) {
        const numbers = [across * trace.step, 0, 0, -up * trace.unit, -from * across, this.high - up * (trace.low - low)];
        trace.group.setAttribute("transform", `matrix(${numbers.join(" ")})`);
      }
      this.svg.querySelectorAll(":scope > .rule, :scope > .axis, :scope > .tick").forEach((e) => e.remove());
      const base = this.top + this.high;
      const add = (kind, attributes, text) => {
        const element = made(kind, attributes);
        if (text) element.textContent = text;
        this.svg.insertBefore(element, this.frame);
      };
      add("path", { class: "axis", d: `M${this.left} ${base}h${this.wide}` });
      for (const [value, text] of ticksOf(low, high, 4)) {
        const y = base - up * (value - low);
        add("path", { class: "rule", d: `M${this.left} ${y}h${this.wide}` });
        add("text", { class: "tick", x: this.left - 5, y: y + 4, "text-anchor": "end" }, text);
      }
      for (const [value, text] of ticksOf(from, to, this.wide / 80)) {
        const x = this.left + across * (value - from);
        add("path", { class: "axis", d: `M${x} ${base}v3` });
        add("text", { class: "tick", x, y: base + 14, "text-anchor": "middle" }, text);
      }
      this.view = [from, to];
    }

    time(event) {
      const box = this.svg.getBoundingClientRect();
      const at = ((event.clientX - box.left) * this.svg.viewBox.baseVal.width) / box.width - this.left;
      const [from, to] = this.view;
      return Math.min(to, Math.max(from, from + (at / this.wide) * (to - from)));
    }

    place(time) {
      return (this.wide * (time - this.view[0])) / (this.view[1] - this.view[0]);
    }

    mark(time, begun) {
      this.cursor.setAttribute("d", time === null ? "" : `M${this.place(time)} 0V${this.high}`);
      const ends = begun === null || time === null ? [0, 0] : [this.place(begun), this.place(time)];
      this.shade.setAttribute("x", Math.min(...ends));
      this.shade.setAttribute("width", Math.abs(ends[1] - ends[0]));
    }

    told(time) {
      return this.traces
        .map(({ name, t, y, begins }) => {
          const i = after(t, time);
          if (i < t.length && t[i] === time) return `${name} ${shown(y[i])}`;
          if (i === 0 || i === t.length || begins[i]) return `${name} –`;
          const share = (time - t[i - 1]) / (t[i] - t[i - 1]);
          return `${name} ${shown(y[i - 1] + share * (y[i] - y[i - 1]))}`;
        })
        .join(", ");
    }
  }

  const views = {}; // by recording: what all of its signals show

  class Figure {
    constructor(figure) {
      this.figure = figure;
      this.seconds = Number(figure.dataset.seconds);
      this.step = Number(figure.dataset.step);
      this.recording = figure.dataset.recording;
      this.begun = null;
      this.controls();
      this.listen();
    }

    get plots() {
      // Traces are read when a figure is first touched: a page may hold a hundred thousand points.
      this.read = this.read || [...this.figure.querySelectorAll("svg.drawn")].map((svg) => new Plot(svg));
      return this.read;
    }

    get view() {
      return views[this.recording] || [0, this.seconds];
    }

    controls() {
      const bar = document.createElement("div");
      bar.className = "controls";
      const buttons = [
        ["+", "Zoom in", () => this.zoom(0.5)],
        ["−", "Zoom out", () => this.zoom(2)],
        ["◀", "Earlier", () => this.pan(-0.4)],
        ["▶", "Later", () => this.pan(0.4)],
        ["Whole recording", "Show the whole recording", () => this.show(0, this.seconds)],
      ];
      for (const [text, label, action] of buttons) {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = text;
        button.setAttribute("aria-label", label);
        button.title = label;
        button.addEventListener("click", action);
        bar.append(button);
      }
      this.status = document.createElement("span");
      this.status.setAttribute("role", "status");
      this.values = document.createElement("output");
      this.values.textContent = "Drag over a stretch to enlarge it.";
      bar.append(this.status, this.values);
      this.figure.querySelector("figcaption").after(bar);
    }

    listen() {
      const keys = {
        "+": () => this.zoom(0.5),
        "=": () => this.zoom(0.5),
        "-": () => this.zoom(2),
        0: () => this.show(0, this.seconds),
        ArrowLeft: () => this.pan(-0.2),
        ArrowRight: () => this.pan(0.2),
      };
      this.figure.addEventListener("keydown", (event) => {
        if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        keys[event.key]();
      });
      const area = this.figure.querySelector(".plots");
      const at = (event) => this.plots.find((p) => p.svg.contains(event.target));
      area.addEventListener("pointerdown", (event) => {
        const plot = at(event);
        if (!plot || event.button) return;
        this.ready();
        this.begun = plot.time(event);
        this.held = plot;
        area.setPointerCapture(event.pointerId);
      });
      area.addEventListener("pointermove", (event) => {
        const plot = this.held || at(event);
        if (!plot) return;
        this.ready();
        const time = plot.time(event);
        this.plots.forEach((p) => p.mark(time, this.begun));
        this.values.textContent = `${shown(time)} s, ${plot.name}: ${plot.told(time)}`;
      });
      area.addEventListener("pointerup", (event) => {
        const [plot, begun] = [this.held, this.begun];
        this.held = null;
        this.begun = null;
        if (!plot) return;
        const time = plot.time(event);
        this.plots.forEach((p) => p.mark(time, null));
        const few = 0.01 * (this.view[1] - this.view[0]);
        if (Math.abs(time - begun) > few) this.show(Math.min(begun, time), Math.max(begun, time));
      });
      area.addEventListener("pointercancel", () => {
        this.held = null;
        this.begun = null;
        this.plots.forEach((p) => p.mark(null, null));
      });
      area.addEventListener("pointerleave", () => this.held || !this.read || this.plots.forEach((p) => p.mark(null, null)));
      area.addEventListener("dblclick", () => this.show(0, this.seconds));
      area.addEventListener(
        "wheel",
        (event) => {
          if (event.ctrlKey) {
            const plot = at(event);
            event.preventDefault();
            if (plot) this.ready();
            this.zoom(Math.exp(event.deltaY / 100), plot ? plot.time(event) : undefined);
          } else if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
            event.preventDefault();
            this.pan(event.deltaX / 500);
          }
        },
        { passive: false },
      );
    }

    ready() {
      if (!this.plots[0].view) this.draw();
    }

    draw() {
      const [from, to] = this.view;
      const everything = from <= 0 && to >= this.seconds;
      this.plots.forEach((p) => p.draw(from, to, everything));
      this.status.textContent = everything ? "" : `${shown(from)} to ${shown(to)} s of ${shown(this.seconds)} s`;
    }

    show(from, to) {
      const least = SHORTEST * this.step;
      const span = Math.min(this.seconds, Math.max(least, to - from));
      const begin = Math.min(this.seconds - span, Math.max(0, (from + to - span) / 2));
      views[this.recording] = [begin, begin + span];
      this.draw();
    }

    zoom(factor, about) {
      const [from, to] = this.view;
      const fixed = about === undefined ? (from + to) / 2 : about;
      this.show(fixed - factor * (fixed - from), fixed + factor * (to - fixed));
    }

    pan(share) {
      const [from, to] = this.view;
      this.show(from + share * (to - from), to + share * (to - from));
    }
  }

  for (const box of document.querySelectorAll(".recorded")) {
    const figures = [...box.querySelectorAll("figure[data-seconds]")].map((f) => new Figure(f));
    box.addEventListener("change", () => {
      for (const f of figures) if (views[f.recording] && f.figure.offsetParent !== null) f.draw();
    });
  }
})();
