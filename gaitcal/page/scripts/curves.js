"use strict";
// The grid of small multiples: joints by angle, moment and power; what is drawn when, and where the clock stands.

// What curves are drawn anew for. Time alone moves cursors.
Gaitcal.DRAWN_FOR = ["result", "trial", "axis", "unit", "signs", "acting", "nominal", "norm", "errors", "truth", "spread", "off", "second"];
// ms between the numbers above panels that nobody points at.
Gaitcal.READ_EVERY = 120;
Gaitcal.POINT_AT = "Point at a curve for its values; drag over it to loop a stretch; click its title to come near.";

Gaitcal.Curves = class {
  constructor(host, page) {
    this.host = host;
    this.page = page;
    this.state = page.state;
    this.strides = new Gaitcal.Strides(page);
    this.density = 1;
    this.lead = "r";
    this.pointed = null;
    this.readAt = 0;
    this.panels = [];
    this.colours = Gaitcal.curveColours();
    this.legend = new Gaitcal.CurveLegend(this);
    this.peaks = new Gaitcal.Peaks(this);
    this.watch = new IntersectionObserver((entries) => this.seen(entries), { rootMargin: "120px" });
    this.build();
    const { state } = this;
    state.on(["seconds"], () => this.tick());
    state.on(Gaitcal.DRAWN_FOR, (_, changed) => (changed.has("result") ? this.build() : this.refresh()));
    state.on(["window"], () => {
      for (const panel of this.panels) panel.window();
    });
    state.on(["joint"], () => this.enlarge(true));
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.refresh());
    new ResizeObserver(() => this.resized()).observe(host);
  }

  // The frame of the grid: what of the result has curves.
  build() {
    const element = Gaitcal.curvePart;
    for (const panel of this.panels) panel.plot?.destroy();
    this.watch.disconnect();
    this.panels = [];
    this.groups = [];
    this.pointed = null;
    this.sentence = element("p", "curve-sentence");
    this.grid = element("div", "curve-groups");
    this.host.replaceChildren();
    if (!this.strides.sheet) return;
    this.known = new Set(this.strides.sheets.filter(Boolean).flatMap((sheet) => sheet.trials.flatMap(({ packed }) => packed.curves.map((curve) => `${curve.base}/${curve.kind}`))));
    for (const joint of this.strides.sheet.joints) this.place(Gaitcal.jointGroup(joint, this));
    this.place(Gaitcal.groundGroup(this));
    this.top = element("div", "curve-top");
    this.top.append(this.legend.root, this.sentence);
    this.host.append(element("h2", "unseen", "Curves"), this.chooser(), this.top, this.grid, this.legend.notes, this.peaks.root);
    for (const panel of this.panels) this.watch.observe(panel.root);
    this.enlarge(false);
    this.refresh();
  }

  has({ base, kind }) {
    return this.known.has(`${base}/${kind}`);
  }

  place(group) {
    if (!group.panels.length) return;
    this.grid.append(group.root);
    this.groups.push(group);
    this.panels.push(...group.panels);
  }

  // Where there is room for one column only, what kind of curve it holds.
  chooser() {
    const field = Gaitcal.curvePart("fieldset", "curve-kinds");
    field.append(Gaitcal.curvePart("legend", "", "Curves"));
    for (const [kind, text] of [["angle", "angles"], ["moment", "moments"], ["power", "powers"], ["all", "all"]]) {
      const label = Gaitcal.curvePart("label");
      const input = Gaitcal.curvePart("input");
      Object.assign(input, { type: "radio", name: "curve-kind", value: kind, checked: kind === (this.kind ?? "angle") });
      input.addEventListener("change", () => this.choose(kind));
      label.append(input, Gaitcal.curvePart("span", "", text));
      field.append(label);
    }
    this.choose(this.kind ?? "angle");
    return field;
  }

  choose(kind) {
    this.kind = kind;
    this.grid.dataset.kind = kind;
  }

  // Everything anew, when it is looked at.
  refresh() {
    if (!this.strides.sheet) return;
    const { state, strides } = this;
    this.colours = this.density > 1 ? Gaitcal.ON_PAPER : Gaitcal.curveColours();
    this.conventions = strides.sheets.map((sheet) => sheet && new Gaitcal.Convention(sheet, state));
    this.offs = ["r", "l"].flatMap((side) => {
      const known = strides.on(state.result, side).straight.filter(({ stride }) => stride.off !== null);
      const percents = known.map(({ stride }) => (100 * (stride.off - stride.start)) / (stride.stop - stride.start));
      return percents.length ? [{ side, at: percents.reduce((a, b) => a + b, 0) / percents.length }] : [];
    });
    this.stances = ["r", "l"].flatMap((side) => strides.trial.stances(side).map(([from, to]) => ({ side, from, to })));
    this.held = this.current();
    this.now = this.moment();
    for (const panel of this.panels) {
      panel.dirty = true;
      panel.name();
    }
    this.legend.write();
    this.schedule();
    clearTimeout(this.writing);
    this.writing = setTimeout(() => this.peaks.write(this.panels.filter(({ subject }) => !subject.detail).map(({ subject }) => subject)), 60);
  }

  schedule() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.flush();
    });
  }

  flush() {
    this.draw(this.panels.filter((panel) => panel.dirty && panel.visible));
    this.readings();
  }

  // All sizes are read before the first is drawn: to draw in between would lay the page out each time.
  draw(panels) {
    const sizes = panels.map((panel) => panel.size());
    for (const [i, panel] of panels.entries()) if (sizes[i]) panel.draw(sizes[i]);
  }

  seen(entries) {
    if (this.strides.sheet) this.now = this.moment();
    for (const { target, isIntersecting } of entries) {
      const panel = this.panels.find(({ root }) => root === target);
      if (!panel) continue;
      panel.visible = isIntersecting;
      if (isIntersecting && !panel.dirty) panel.follow(this.now);
    }
    this.schedule();
  }

  resized() {
    const width = this.host.clientWidth;
    if (width === this.wide) return;
    this.wide = width;
    for (const panel of this.panels) panel.dirty = true;
    this.schedule();
  }

  // The strides in which the clock stands.
  current() {
    const { strides, state } = this;
    return strides.percent ? ["r", "l"].map((side) => strides.near(side, state.seconds)) : [];
  }

  moment() {
    const { strides, state } = this;
    if (!strides.percent) return { r: null, l: null, "": state.seconds, percent: null };
    const [r, l] = ["r", "l"].map((side) => strides.percentAt(side, state.seconds));
    const percent = this.lead === "l" ? (l ?? r) : (r ?? l);
    return { r, l, "": null, percent };
  }

  // Each frame while the clock runs.
  tick() {
    if (!this.strides.sheet || this.host.hidden) return;
    const held = this.current();
    const others = held.some((stride, i) => stride !== this.held[i]);
    this.held = held;
    if (others && this.state.spread !== "mean") {
      for (const panel of this.panels) panel.dirty = true;
      this.schedule();
    }
    this.now = this.moment();
    for (const panel of this.panels) if (panel.visible) panel.follow(this.now);
    if (this.pointed) {
      this.pointed.read(this.now);
      this.sentence.textContent = this.pointed.sentence(this.now);
    }
    const since = performance.now() - this.readAt;
    if (since >= Gaitcal.READ_EVERY) this.readings();
    else this.reading ??= setTimeout(() => this.readings(), Gaitcal.READ_EVERY - since);
  }

  readings() {
    clearTimeout(this.reading);
    this.reading = null;
    this.readAt = performance.now();
    for (const panel of this.panels) if (panel.visible && !panel.dirty) panel.read(this.now);
    this.sentence.textContent = this.pointed?.sentence(this.now) || Gaitcal.POINT_AT;
  }

  point(panel) {
    if (this.pointed === panel) return;
    this.pointed?.root.classList.remove("pointed");
    this.pointed = panel;
    panel.root.classList.add("pointed");
    this.readings();
  }

  // What a result is called.
  named(i) {
    return this.page.results[i].name || this.strides.sheets[i].person.name;
  }

  summary({ subject }) {
    return this.peaks.summary(subject);
  }

  // The looped window as percents of the stride of a leg that it lies in; null where it lies in none.
  windowPercents(side) {
    const { window } = this.state;
    const stride = this.strides.near(side, 0.5 * (window[0] + window[1])) ?? this.strides.near(side === "r" ? "l" : "r", window[0]);
    if (!stride) return null;
    const percents = window.map((t) => Math.min(100, Math.max(0, (100 * (t - stride.start)) / (stride.stop - stride.start))));
    return percents[1] > percents[0] ? percents : null;
  }

  // The chosen joint's curves are large, all its powers among them; the others step back.
  enlarge(move) {
    const joint = this.state.joint?.replace(/_[rl]$/, "") ?? null;
    const side = /_([rl])$/.exec(this.state.joint ?? "")?.[1];
    if (side) this.lead = side;
    const here = this.groups.some((group) => group.joint === joint);
    for (const group of this.groups) {
      const chosen = here && group.joint === joint;
      group.root.classList.toggle("large", chosen);
      group.root.classList.toggle("dim", here && !chosen);
      if (chosen && "open" in group.root) group.root.open = true;
      for (const panel of group.panels) {
        panel.dirty = true;
        if (side) panel.lead = side;
        if (panel.title.type === "button") panel.title.setAttribute("aria-pressed", String(chosen));
      }
    }
    this.schedule();
    if (move) this.reveal(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  // The enlarged curves come into view; where the body stands above the curves, it would be scrolled away.
  reveal(smooth) {
    const large = this.groups.find(({ root }) => root.classList.contains("large"));
    if (!large || this.host.hidden || !window.matchMedia("(min-width: 761px)").matches) return;
    large.root.scrollIntoView({ block: "start", behavior: smooth ? "smooth" : "auto" });
  }

  // For paper: all panels at once, light, at twice the density, by kind; and back.
  forPrint(on) {
    if (!this.strides.sheet) return;
    this.density = on ? 2 : 1;
    this.host.classList.toggle("for-print", on);
    this.papers?.remove();
    if (on) {
      this.papers = Gaitcal.curvePapers(this.panels);
      this.grid.before(this.papers);
    } else for (const group of this.groups) group.cells.append(...group.panels.map(({ root }) => root));
    this.refresh();
    for (const panel of this.panels) {
      panel.plot?.destroy();
      panel.plot = null;
    }
    if (on) this.draw(this.panels);
  }
};
