// One panel: a title, axes, its curves, and a cursor that follows the clock and moves it. Right is solid, left dashed;
// nothing is told by colour alone.
Gaitcal.Panel = class {
  // `subject`: {base, kind, joint}; `curves`: the grid that it stands in.
  constructor(subject, curves) {
    const { strides, state } = curves;
    Object.assign(this, { subject, curves, strides, state, plot: null, dirty: true, visible: false });
    const { base, kind, joint, column, detail, third } = subject;
    const sided = (part) =>
      Object.fromEntries(["r", "l", ""].map((side) => [side, html(part, { class: `side-${side || "none"}` })]));
    this.title = joint
      ? Gaitcal.button("", () => this.enlarge(), { class: "curve-title", tabindex: -1 })
      : html("span.curve-title");
    this.unit = html("span.curve-unit");
    this.told = sided("span");
    this.place = html("div.curve-plot");
    this.root = html("div.curve-panel",
      {
        "data-base": base, "data-kind": kind, "data-column": column, class: detail ? "detail" : third ? "third" : "",
        tabindex: 0, role: "figure", keydown: (event) => this.pressed(event), focus: () => curves.point(this),
      },
      html("div.curve-head", this.title, this.unit),
      html("div.curve-reading", Object.values(this.told)),
      this.place,
    );
  }

  get convention() { return this.curves.convention; }

  // Its words in the chosen convention.
  name() {
    const { base, kind } = this.subject;
    const side = this.strides.percent || kind === "force" ? "r" : "";
    this.title.textContent = this.convention.title(base, kind);
    this.words = this.convention.words(base, kind, side);
    // On the screen the row of switches says whose moments they are.
    this.unit.textContent = this.curves.density > 1 ? this.words : this.convention.brief(base, kind, side);
    this.root.setAttribute("aria-label", `${this.title.textContent}, ${this.words}`);
  }

  // Axes and curves as they are chosen now.
  draw(size) {
    this.dirty = false;
    this.traces = new Gaitcal.Traces(this.subject, this.strides, this.convention);
    const summary = this.curves.peaks.summary(this.subject);
    this.root.setAttribute("aria-label", `${this.title.textContent}, ${this.words}. ${summary}`);
    this.place.classList.toggle("empty", !this.traces.lines.length);
    this.plot?.destroy();
    this.plot = Gaitcal.plot(this.place, size, this.drawing());
    Gaitcal.dress(this.plot.over, {
      pointermove: (event) => this.moved(event),
      pointerdown: (event) => this.grasped(event),
      pointerup: (event) => this.released(event),
      pointercancel: () => this.released(null),
      pointerenter: () => this.curves.point(this),
    });
  }

  drawing() {
    const { traces, curves } = this;
    const { colours, offs, stances } = curves;
    const { percent, lines } = traces;
    const colour = (side) => colours[Gaitcal.LEGS[side] ?? "ink"];
    const dash = (side) => (side === "l" ? [6, 3.5] : []);
    const stroke = (line, values, more = {}) => ({
      x: line.x, y: values.map((value, i) => (line.valid[i] ? value : NaN)),
      colour: colour(line.side), dash: dash(line.side), ...more,
    });
    // Stretches between points of which one is not valid.
    const pale = ({ x, value, valid, side, weight }) => {
      const touches = (i) => !valid[i] || (i > 0 && !valid[i - 1]) || (i + 1 < x.length && !valid[i + 1]);
      const y = value.map((one, i) => (touches(i) ? one : NaN));
      return { x, y, colour: colour(side), width: weight === "thin" ? 0.8 : 0.7, alpha: 0.45 };
    };
    const main = lines.filter(({ isMain }) => isMain);
    const spread = main.flatMap((line) => {
      const part = traces.tellsErrors(line) ? "se" : "sd";
      const band = { x: line.x, colour: colour(line.side), alpha: part === "se" ? 0.3 : 0.16 };
      return !line[part] ? [] : [{ ...band, ...Gaitcal.around(stroke(line, line.value).y, line[part]) }];
    });
    const models = (part, more) => main.filter((line) => line[part]).map((line) => stroke(line, line[part], more));
    const norms = traces.bands.map(({ mean, sd }) => Gaitcal.normBand(Gaitcal.PERCENTS, mean, sd, colours));
    return {
      x: traces.x, y: traces.y, colours, density: curves.density, incrs: percent ? [25, 50, 100] : Gaitcal.STEPS,
      bands: [...norms, ...spread],
      lines: [
        ...lines.filter((line) => !line.valid.every(Boolean)).map(pale),
        ...lines.filter(({ weight }) => weight === "thin").map((line) => stroke(line, line.value, { width: 0.9, alpha: 0.55 })),
        ...models("nominal", { width: 1, colour: colours.nominal }),
        ...main.map((line) => stroke(line, line.value, { width: 1.9 })),
        ...models("truth", { width: 1.5, colour: colours.truth, dash: [1.5, 3] }),
      ],
      uprights: percent ? offs.map(({ side, at }) => ({ at, colour: colour(side), dash: side === "l" ? [3, 3] : [] })) : [],
      feet: percent ? [] : stances.map(({ side, span: [from, to] }) => ({ from, to, row: side === "r" ? 7 : 3.5, colour: colour(side) })),
      hooks: { draw: [(plot) => this.drawn(plot)] },
    };
  }

  // Where x lies, in px of the page, for cursors that move without any drawing.
  drawn({ bbox, scales }) {
    const { min, max } = scales.x;
    this.span = { min, max, wide: bbox.width / uPlot.pxRatio };
    this.window();
  }

  px(x) {
    const { min, max, wide } = this.span;
    return ((x - min) / (max - min)) * wide;
  }

  // The x of a place in the window.
  x(clientX) {
    const { min, max, wide } = this.span;
    const px = clientX - this.plot.over.getBoundingClientRect().left;
    return Math.min(max, Math.max(min, min + (px / wide) * (max - min)));
  }

  // px of a side's cursor at a moment {r, l: percents, "": seconds}; null where it has none.
  cursor(side, now) {
    return !this.span || now[side] === null || this.traces.percent === (side === "") ? null : this.px(now[side]);
  }

  // The cursors in the picture of all panels, those of legs with their letters: a line without one is a toe-off.
  follow(pen, { left: begin, top, height }, now, { right, left, ink, paper }) {
    for (const [k, [side, colour]] of [["r", right], ["l", left], ["", ink]].entries()) {
      const px = this.cursor(side, now);
      if (px === null) continue;
      Object.assign(pen, { strokeStyle: colour, fillStyle: colour, lineWidth: 1.5 });
      pen.setLineDash(side === "l" ? [4, 2.5] : []);
      pen.beginPath();
      pen.moveTo(begin + px, top);
      pen.lineTo(begin + px, top + height);
      pen.stroke();
      if (!side) continue;
      pen.fillRect(begin + px - 5.5, top + 11 * k, 11, 11);
      pen.fillStyle = paper;
      pen.fillText(side.toUpperCase(), begin + px, top + 11 * k + 6);
    }
  }

  // The values under the cursor, short, above the curves.
  read(now) {
    if (!this.traces) return;
    for (const [side, place] of Object.entries(this.told)) {
      const value = this.value(side, now);
      const text = value && `${side.toUpperCase()} ${value}`.trim();
      if (place.textContent !== text) place.textContent = text;
    }
  }

  // "0.62 ± 0.04" of a side at a moment, each leg at its own; nothing where there is no curve.
  value(side, now) {
    const x = this.traces.percent ? now[side] : now[""];
    const read = this.traces.at(side, x, this.state.seconds);
    if (!read || Number.isNaN(read.value)) return "";
    return read.valid ? Gaitcal.plusMinus(read.value, read.error, this.convention.digits(this.subject.kind)) : "not valid";
  }

  // The same in full: "Knee abduction moment: right 0.62 ± 0.04 (43 %), left 0.58 ± 0.05 (93 %) N·m/kg at 1.23 s".
  sentence(now) {
    if (!this.traces) return "";
    const place = (side) => (this.traces.percent && now[side] !== null ? `(${Gaitcal.numeral(now[side], 0)} %)` : "");
    const sides = ["r", "l", ""]
      .map((side) => [Gaitcal.LEGS[side] ?? "", this.value(side, now), place(side)])
      .filter(([, text]) => text)
      .map((words) => words.join(" ").trim())
      .join(", ");
    const means = ["r", "l"].map((side) => this.traces.main(side)).filter((line) => line?.weight === "mean");
    const part = means.some((line) => this.traces.tellsErrors(line)) ? "standard error" : "SD";
    const spread = means.length ? ` (mean ± ${part}, ${this.curves.strides.one}s: ${[...new Set(means.map(({ n }) => n))].join(" and ")})` : "";
    const unit = this.convention.unit(this.subject.kind);
    return `${this.title.textContent}: ${sides || "nothing"} ${unit}${spread} at ${Gaitcal.numeral(this.state.seconds, 2)} s`;
  }

  // The stretch of time that is looped.
  window() {
    if (!this.span) return;
    const { window } = this.state;
    const ends = window && (this.traces.percent ? this.curves.windowPercents() : window);
    const [from, to] = (ends ?? [this.span.min, this.span.min]).map((x) => this.px(x));
    this.stretch(from, to);
  }

  stretch(from, to) {
    const height = this.plot.over.clientHeight;
    this.plot.setSelect({ left: Math.min(from, to), width: Math.abs(to - from), top: 0, height }, false);
  }

  // A pointer that has not pressed leads the clock; one that has chooses a stretch, or a moment where it stays.
  moved(event) {
    const { clientX } = event;
    const pressed = this.held !== undefined;
    if (pressed && this.far(event)) this.stretch(this.px(this.x(this.held)), this.px(this.x(clientX)));
    if (this.state.playing || (event.pointerType === "touch" && !pressed)) return;
    if (!pressed) this.nearest(event);
    this.state.set({ seconds: this.frameAt(this.x(clientX)) });
  }

  grasped(event) {
    if (event.button) return;
    this.held = event.clientX;
    this.curves.point(this);
    this.nearest(event);
    this.plot.over.setPointerCapture?.(event.pointerId);
    this.state.set({ playing: false, seconds: this.frameAt(this.x(this.held)) });
  }

  released(event) {
    if (this.held === undefined) return;
    const ends = event && [this.held, event.clientX].map((at) => this.frameAt(this.x(at))).sort((a, b) => a - b);
    if (event && this.far(event) && ends[1] > ends[0]) this.state.set({ window: ends, seconds: ends[0] });
    else if (event) this.state.set({ window: null, seconds: this.frameAt(this.x(event.clientX)) });
    this.held = undefined;
    this.window();
    this.curves.schedule();
  }

  far({ pointerType, clientX }) { return pointerType !== "touch" && Math.abs(clientX - this.held) > Gaitcal.DRAGGED; }

  // The leg whose curve is nearest to the pointer leads the clock over the cycle.
  nearest({ clientX, clientY }) {
    const value = this.plot.posToVal(clientY - this.plot.over.getBoundingClientRect().top, "y");
    const away = (side) => Math.abs((this.traces.on(this.traces.main(side), this.x(clientX))?.value ?? NaN) - value);
    const [right, left] = [away("r"), away("l")];
    if (!Number.isNaN(right) || !Number.isNaN(left)) this.curves.lead = left < right || Number.isNaN(right) ? "l" : "r";
  }

  // The frame at an x of the axis.
  frameAt(x) { return this.traces.percent ? this.strides.timeAt(this.curves.lead, x) : this.strides.trial.frame(x); }

  enlarge() {
    const { joint } = this.subject;
    const name = Gaitcal.UNPAIRED.includes(joint) ? joint : `${joint}_${this.curves.lead}`;
    this.state.set({ joint: this.state.joint === name ? null : name });
  }

  pressed(event) {
    if (event.target !== this.root || event.ctrlKey || event.altKey || event.metaKey || !this.traces) return;
    const frames = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    const end = { Home: 0, End: 1 }[event.key];
    if (frames) this.curves.page.clock.step(frames * (event.shiftKey ? 10 : 1));
    else if (end !== undefined) this.state.set({ playing: false, seconds: this.frameAt(this.traces.x[end]) });
    else if (event.key === "Enter" && this.subject.joint) this.enlarge();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
};
