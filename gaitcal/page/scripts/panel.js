"use strict";
// One panel: a title, axes, its curves, and a cursor that follows the clock and moves it.

Gaitcal.curvePart = (name, classes = "", text = null) => {
  const made = document.createElement(name);
  if (classes) made.className = classes;
  if (text !== null) made.textContent = text;
  return made;
};

// Between ticks: 1, 2, 5, 10, ...
Gaitcal.STEPS = [-4, -3, -2, -1, 0, 1, 2, 3, 4].flatMap((power) => [1, 2, 5].map((digit) => Number(`${digit}e${power}`)));

// px: a pointer that moved less has pressed, not dragged.
Gaitcal.DRAGGED = 5;

Gaitcal.Panel = class {
  // `subject`: {base, kind, joint}; `curves`: the grid that it stands in.
  constructor(subject, curves) {
    this.subject = subject;
    this.curves = curves;
    this.strides = curves.strides;
    this.state = curves.state;
    this.plot = null;
    this.dirty = true;
    this.visible = false;
    this.lead = "r";
    this.build();
  }

  build() {
    const element = Gaitcal.curvePart;
    const { base, kind, joint } = this.subject;
    this.root = element("div", "curve-panel");
    Object.assign(this.root.dataset, { base, kind });
    this.root.tabIndex = 0;
    this.root.setAttribute("role", "figure");
    const head = element("div", "curve-head");
    this.title = element(joint ? "button" : "span", "curve-title");
    if (joint) {
      this.title.type = "button";
      this.title.tabIndex = -1;
      this.title.addEventListener("click", () => this.enlarge());
    }
    this.unit = element("span", "curve-unit");
    head.append(this.title, this.unit);
    this.reading = element("div", "curve-reading");
    this.told = Object.fromEntries(["r", "l", ""].map((side) => [side, element("span", `side-${side || "none"}`)]));
    this.reading.append(...Object.values(this.told));
    this.place = element("div", "curve-plot");
    this.root.append(head, this.reading, this.place);
    this.cursors = Object.fromEntries(["r", "l", ""].map((side) => [side, element("div", `curve-cursor side-${side || "none"}`)]));
    this.looped = element("div", "curve-window");
    this.looped.hidden = true;
    this.root.addEventListener("keydown", (event) => this.pressed(event));
    this.root.addEventListener("focus", () => this.curves.point(this));
  }

  // Its words in the chosen convention.
  name() {
    const { base, kind } = this.subject;
    const convention = this.curves.conventions[this.state.result];
    this.title.textContent = convention.title(base, kind);
    const side = this.strides.percent ? "r" : "";
    this.words = convention.words(base, kind, side);
    // On the screen the row of switches says whose moments they are.
    this.unit.textContent = this.curves.density > 1 ? this.words : convention.brief(base, kind, side);
    this.root.setAttribute("aria-label", `${this.title.textContent}, ${this.words}`);
  }

  // How large its plot is; null while it is hidden.
  size() {
    const [width, height] = [this.place.clientWidth, this.place.clientHeight];
    return width && height ? [width, height] : null;
  }

  // Axes and curves as they are chosen now.
  draw(size) {
    this.dirty = false;
    this.traces = new Gaitcal.Traces(this.subject, this.strides, this.curves.conventions);
    this.traces.offs = this.traces.percent ? this.curves.offs : [];
    this.traces.stances = this.traces.percent ? [] : this.curves.stances;
    this.root.setAttribute("aria-label", `${this.title.textContent}, ${this.words}. ${this.curves.summary(this)}`);
    const [width, height] = size.map((length) => length * this.curves.density);
    this.place.classList.toggle("empty", !this.traces.lines.length);
    const data = [this.traces.x, this.traces.y];
    if (this.plot && this.plot.density === this.curves.density) {
      if (this.plot.width !== width || this.plot.height !== height) this.plot.setSize({ width, height });
      this.plot.setData(data);
    } else this.create(width, height, data);
  }

  create(width, height, data) {
    this.plot?.destroy();
    const { density } = this.curves;
    const font = `${10 * density}px system-ui, sans-serif`;
    const stroke = () => this.curves.colours.soft;
    const grid = { stroke: () => this.curves.colours.line, width: 0.6 * density };
    const ticks = { stroke: () => this.curves.colours.line, width: 0.6 * density, size: 3 * density };
    const axis = { font, stroke, grid, ticks, gap: 2 * density };
    const values = (_plot, splits) => Gaitcal.ticks(splits);
    this.plot = new uPlot(
      {
        width, height, legend: { show: false }, cursor: { show: false }, padding: [4 * density, 12 * density, 0, 0],
        scales: { x: { time: false, range: () => this.traces.x }, y: { range: () => this.traces.y } },
        axes: [
          { ...axis, values, size: 16 * density, space: 38 * density, incrs: () => (this.traces.percent ? [25, 50, 100] : Gaitcal.STEPS) },
          { ...axis, size: 36 * density, space: 24 * density, values, incrs: Gaitcal.STEPS },
        ],
        series: [{}, { paths: () => null, points: { show: false } }],
        hooks: { drawAxes: [(plot) => this.paint(plot)] },
      },
      data,
      this.place,
    );
    this.plot.density = density;
    this.plot.over.append(...Object.values(this.cursors), this.looped);
    this.listen(this.plot.over);
  }

  paint(plot) {
    const ratio = uPlot.pxRatio;
    new Gaitcal.Pen(plot, this.curves.colours, ratio * this.curves.density).draw(this.traces, this.state);
    // Where x lies, in px of the page, for cursors that move without any drawing.
    const { min, max } = plot.scales.x;
    const wide = plot.bbox.width / ratio;
    this.span = { min, max, wide };
    this.follow(this.curves.now);
    this.window();
  }

  px(x) {
    const { min, max, wide } = this.span;
    return ((x - min) / (max - min)) * wide;
  }

  x(px) {
    const { min, max, wide } = this.span;
    return Math.min(max, Math.max(min, min + (px / wide) * (max - min)));
  }

  // The cursors at a moment {r, l: percents, "": seconds}, each null where it is not; no layout, no drawing.
  follow(now) {
    if (!this.span) return;
    for (const side of ["r", "l", ""]) {
      const x = this.traces.percent === (side === "") ? null : now[side];
      const shift = x === null ? "translateX(-99px)" : `translateX(${this.px(x).toFixed(1)}px)`;
      if (this.cursors[side].style.transform !== shift) this.cursors[side].style.transform = shift;
    }
  }

  // The values under the cursor, short, above the curves.
  read(now) {
    if (!this.traces) return;
    for (const side of ["r", "l", ""]) {
      const told = this.value(side, now);
      const text = told ? `${{ r: "R", l: "L" }[side] ?? ""} ${told}`.trim() : "";
      if (this.told[side].textContent !== text) this.told[side].textContent = text;
    }
  }

  // "0.62 ± 0.04" of a side at a moment; nothing where there is no curve.
  value(side, now, second = false) {
    const x = this.traces.percent ? now.percent : now[""];
    const read = x === null ? null : this.traces.at(side, x, second);
    if (!read || Number.isNaN(read.value)) return "";
    if (!read.valid) return "not valid";
    const digits = this.curves.conventions[this.state.result].digits(this.subject.kind);
    const error = Number.isFinite(read.error) ? ` \u00b1 ${Gaitcal.number(read.error, digits)}` : "";
    return `${Gaitcal.number(read.value, digits)}${error}`;
  }

  // The same in full: "Knee adduction moment: right 0.62 ± 0.04, left 0.58 ± 0.05 N·m/kg at 43 % / 1.23 s".
  sentence(now) {
    if (!this.traces) return "";
    const sides = (second) =>
      ["r", "l", ""]
        .map((side) => [Gaitcal.LEGS[side] ?? "", this.value(side, now, second)])
        .filter(([, text]) => text)
        .map(([side, text]) => `${side} ${text}`.trim())
        .join(", ");
    const unit = this.curves.conventions[this.state.result].unit(this.subject.kind);
    const at = this.traces.percent && now.percent !== null ? `${Gaitcal.number(now.percent, 0)} % / ` : "";
    const counts = ["r", "l"].map((side) => this.traces.main(side)).filter((line) => line?.weight === "mean").map(({ n }) => n);
    const spread = counts.length ? ` (mean \u00b1 SD of ${[...new Set(counts)].join(" and ")} strides)` : "";
    const other = sides(true);
    const second = other ? `; ${this.curves.named(1 - this.state.result)}: ${other}` : "";
    return `${this.title.textContent}: ${sides(false) || "nothing"} ${unit}${spread} at ${at}${Gaitcal.number(this.state.seconds, 2)} s${second}`;
  }

  // The stretch of time that is looped.
  window() {
    const { window } = this.state;
    this.looped.hidden = !window || !this.span;
    if (this.looped.hidden) return;
    const ends = this.traces.percent ? this.curves.windowPercents(this.lead) : window;
    this.looped.hidden = !ends;
    if (ends) this.stretch(this.px(ends[0]), this.px(ends[1]));
  }

  stretch(from, to) {
    this.looped.hidden = false;
    this.looped.style.left = `${Math.min(from, to)}px`;
    this.looped.style.width = `${Math.abs(to - from)}px`;
  }

  listen(over) {
    over.addEventListener("pointermove", (event) => this.moved(event));
    over.addEventListener("pointerdown", (event) => this.grasped(event));
    over.addEventListener("pointerup", (event) => this.released(event));
    over.addEventListener("pointercancel", () => this.released(null));
    over.addEventListener("pointerenter", () => this.curves.point(this));
  }

  moved(event) {
    const px = event.clientX - this.plot.over.getBoundingClientRect().left;
    if (this.held !== undefined && event.pointerType !== "touch" && Math.abs(px - this.held) > Gaitcal.DRAGGED) this.stretch(this.held, px);
    if (this.state.playing) return;
    if (event.pointerType === "touch" && this.held === undefined) return;
    if (this.held === undefined) this.nearest(px, event.clientY - this.plot.over.getBoundingClientRect().top);
    this.state.set({ seconds: this.timeAt(this.x(px)) });
  }

  grasped(event) {
    if (event.button) return;
    const box = this.plot.over.getBoundingClientRect();
    this.held = event.clientX - box.left;
    this.curves.point(this);
    this.nearest(this.held, event.clientY - box.top);
    this.plot.over.setPointerCapture?.(event.pointerId);
    this.state.set({ playing: false, seconds: this.timeAt(this.x(this.held)) });
  }

  released(event) {
    if (this.held === undefined) return;
    const { held } = this;
    this.held = undefined;
    if (!event) return this.window();
    const px = event.clientX - this.plot.over.getBoundingClientRect().left;
    const ends = [held, px].map((at) => this.timeAt(this.x(at))).sort((a, b) => a - b);
    const dragged = event.pointerType !== "touch" && Math.abs(px - held) > Gaitcal.DRAGGED && ends[1] > ends[0];
    if (dragged) this.state.set({ window: ends, seconds: ends[0] });
    else this.state.set({ window: null, seconds: this.timeAt(this.x(px)) });
    this.window();
  }

  // The leg whose curve is nearest to the pointer leads the clock over the cycle.
  nearest(px, py) {
    const { min, max } = this.plot.scales.y;
    const value = max - (py / this.plot.over.clientHeight) * (max - min);
    const away = (side) => Math.abs((this.traces.at(side, this.x(px))?.value ?? NaN) - value);
    const [right, left] = [away("r"), away("l")];
    if (!Number.isNaN(right) || !Number.isNaN(left)) this.lead = left < right || Number.isNaN(right) ? "l" : "r";
    this.curves.lead = this.lead;
  }

  timeAt(x) {
    return this.traces.percent ? this.strides.timeAt(this.lead, x) : this.strides.trial.frame(x);
  }

  enlarge() {
    const { joint } = this.subject;
    const paired = !["trunk", "pelvis"].includes(joint);
    const name = paired ? `${joint}_${this.lead}` : joint;
    this.state.set({ joint: this.state.joint === name ? null : name });
  }

  pressed(event) {
    if (event.target !== this.root || event.ctrlKey || event.altKey || event.metaKey || !this.traces) return;
    const frames = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (frames) this.curves.page.clock.step(frames * (event.shiftKey ? 10 : 1));
    else if (event.key === "Home" || event.key === "End") {
      this.state.set({ playing: false, seconds: this.timeAt(this.traces.x[event.key === "Home" ? 0 : 1]) });
    } else if (event.key === "Enter" && this.subject.joint) this.enlarge();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
};

// As many digits as tell the ticks apart.
Gaitcal.ticks = (splits) => {
  const step = splits.length > 1 ? splits[1] - splits[0] : 1;
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return splits.map((value) => Gaitcal.number(value, Math.min(digits, 4)));
};
