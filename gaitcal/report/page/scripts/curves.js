// The grid of small multiples: joints by angle, moment and power; what is drawn when, and where the clock stands.

// What curves are drawn anew for. Time alone moves cursors.
Gaitcal.DRAWN_FOR = ["trial", "axis", "unit", "signs", "acting", "nominal", "norm", "errors", "truth", "spread", "off"];
// ms between the numbers above panels that nobody points at, at rest and while the clock runs: nobody reads them then, and
// to set them anew costs more than the body.
Gaitcal.READ_EVERY = { rest: 120, playing: 1000 };
Gaitcal.POINT_AT = "Point at a curve for its values; drag to replay this part; click a title to enlarge.";

Gaitcal.Curves = class {
  constructor(host, page) {
    const { state } = page;
    Object.assign(this, { host, page, state, strides: new Gaitcal.Strides(page) });
    Object.assign(this, { density: 1, lead: "r", looped: "r", pointed: null, readAt: 0, panels: [], groups: [] });
    const part = (name) => host.querySelector(`.curve-${name}`);
    Object.assign(this, { legend: part("legend"), notes: part("notes"), grid: part("groups"), sentence: part("sentence") });
    this.peaks = new Gaitcal.Peaks(part("peaks"), this);
    this.overlay = part("now");
    this.watch = new IntersectionObserver((entries) => this.came(entries), { rootMargin: "120px" });
    this.build();
    state.on(["seconds"], () => this.tick());
    state.on(Gaitcal.DRAWN_FOR, () => this.refresh());
    state.on(["window"], () => {
      this.looped = this.lead;
      for (const panel of this.panels) panel.window();
      this.tell();
    });
    state.on(["joint"], () => this.enlarge(true));
    state.on(["playing"], () => {
      this.follow();
      this.readings();
    });
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.refresh());
    new ResizeObserver(() => {
      this.resized();
      this.measure();
    }).observe(host);
    window.addEventListener("scroll", () => this.measure(), { passive: true });
  }

  // The frame of the grid: what of the result has curves.
  build() {
    const { trials } = this.strides.sheet;
    const known = new Set(trials.flatMap(({ packed }) => packed.curves.map(({ base, kind }) => `${base}/${kind}`)));
    const has = ({ base, kind }) => known.has(`${base}/${kind}`);
    const joints = Gaitcal.conventions().joints.map((joint) => Gaitcal.jointGroup(joint, has));
    const ground = Gaitcal.groundGroup(has);
    const place = ({ joint }) => Gaitcal.ROWS.indexOf(joint);
    this.groups = Gaitcal.besidePelvis(joints.sort((a, b) => place(a) - place(b)), ground)
      .filter(({ subjects }) => subjects.length)
      .map((group) => Gaitcal.curveGroup(group, this));
    this.panels = this.groups.flatMap(({ panels }) => panels);
    this.grid.replaceChildren(...this.groups.map(({ root }) => root));
    for (const panel of this.panels) this.watch.observe(panel.root);
    this.enlarge(false);
    this.refresh();
  }

  // Everything anew, when it is looked at.
  refresh() {
    const { state, strides } = this;
    const { trial } = strides;
    this.colours = Gaitcal.pageColours();
    this.convention = new Gaitcal.Convention(strides.sheet, state);
    this.offs = ["r", "l"].flatMap((side) => {
      const known = strides.on(side).straight.filter(({ stride }) => stride.off !== null);
      const { n, mean } = Gaitcal.average(known.map(({ stride }) => Gaitcal.percentOf(stride, stride.off)));
      return n ? [{ side, at: mean }] : [];
    });
    this.stances = ["r", "l"].flatMap((side) =>
      Gaitcal.stances(trial, side, trial.duration).map((span) => ({ side, span })),
    );
    this.held = this.current();
    this.now = this.moment();
    for (const panel of this.panels) panel.name();
    this.tell();
    this.redraw();
    clearTimeout(this.writing);
    this.writing = setTimeout(() => this.peaks.write(), 60);
  }

  schedule() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.draw(this.panels.filter(({ dirty, visible, held }) => dirty && visible && held === undefined));
      requestAnimationFrame(() => this.measure()); // panels draw after this frame's scripts
      this.readings();
    });
  }

  // All sizes are read before the first is drawn: to draw in between would lay the page out each time.
  draw(panels) {
    const sizes = panels.map(({ place }) => [place.clientWidth, place.clientHeight]);
    for (const [i, panel] of panels.entries()) if (!sizes[i].includes(0)) panel.draw(sizes[i]);
  }

  // The cursors of all panels in one picture above them: one element each, put together anew in every frame, costs a
  // processor without a graphics card ten times as much.
  cursors() {
    this.drawing = null;
    const { overlay, spots = [], ratio } = this;
    const pen = overlay.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, overlay.width, overlay.height);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    Object.assign(pen, { font: "700 9px system-ui, sans-serif", textAlign: "center", textBaseline: "middle" });
    for (const [panel, spot] of spots) panel.follow(pen, spot, this.now, this.colours);
  }

  // Where in that picture the panels in view are: to ask in every frame would lay out the page each time.
  measure() {
    const { overlay, host } = this;
    if (host.hidden) return;
    const { left, top } = overlay.parentElement.getBoundingClientRect();
    this.ratio = Math.min(2, window.devicePixelRatio);
    const [width, height] = [host.clientWidth, window.innerHeight].map((px) => Math.round(this.ratio * px));
    if (overlay.width !== width || overlay.height !== height) Object.assign(overlay, { width, height });
    overlay.style.width = `${width / this.ratio}px`;
    const drawn = this.panels.filter(({ visible, span }) => visible && span);
    this.spots = drawn.map((panel) => {
      const over = panel.plot.over.getBoundingClientRect();
      return [panel, { left: over.left - left, top: over.top - top, height: over.height }];
    });
    this.cursors();
  }

  came(entries) {
    for (const { target, isIntersecting } of entries) this.panels.find(({ root }) => root === target).visible = isIntersecting;
    this.schedule();
  }

  resized() {
    const size = `${this.host.clientWidth} ${window.innerHeight}`;
    if (size === this.size) return;
    this.size = size;
    this.redraw();
  }

  redraw() {
    for (const panel of this.panels) panel.dirty = true;
    this.schedule();
  }

  // The strides in which the clock stands.
  current() {
    const { strides, state } = this;
    return strides.percent ? ["r", "l"].map((side) => strides.near(side, state.seconds)) : [];
  }

  // Where the clock stands on the axis, of each leg in its own stride: {r, l: percents, "": seconds}, null where nowhere.
  moment() {
    const { strides, state } = this;
    if (!strides.percent) return { r: null, l: null, "": state.seconds };
    const [r, l] = ["r", "l"].map((side) => strides.percentAt(side, state.seconds));
    return { r, l, "": null };
  }

  // Each frame while the clock runs.
  tick() {
    if (this.host.hidden) return;
    this.follow();
    this.now = this.moment();
    this.drawing ??= requestAnimationFrame(() => this.cursors());
    if (this.pointed) {
      this.pointed.read(this.now);
      this.sentence.textContent = this.pointed.sentence(this.now);
    }
    const since = performance.now() - this.readAt;
    const every = Gaitcal.READ_EVERY[this.state.playing ? "playing" : "rest"];
    if (since >= every) this.readings();
    else this.reading ??= setTimeout(() => this.readings(), every - since);
  }

  // The stride in which the clock stands is thick; while it runs all panels would be drawn anew again and again.
  follow() {
    if (this.state.playing || this.state.spread === "mean") return;
    const held = this.current();
    if (held.some((stride, i) => stride !== this.held[i])) this.redraw();
    this.held = held;
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

  // The looped window as percents of the stride that it lies in, of the leg that led; null where it lies in none.
  windowPercents() {
    const { window } = this.state;
    const stride = this.strides.nearAny(this.looped, 0.5 * (window[0] + window[1]));
    const percents = window.map((t) => Math.min(100, Math.max(0, Gaitcal.percentOf(stride, t))));
    return percents[1] > percents[0] ? percents : null;
  }

  // The chosen joint's curves are large, all its powers among them; the others step back.
  enlarge(move) {
    const [, joint = null, side] = /^(.*?)(?:_([rl]))?$/.exec(this.state.joint ?? "");
    if (side) this.lead = side;
    const here = this.groups.some((group) => group.joint === joint);
    for (const group of this.groups) {
      const chosen = here && group.joint === joint;
      group.root.classList.toggle("large", chosen);
      group.root.classList.toggle("dim", here && !chosen);
      if (chosen && "open" in group.root) group.root.open = true;
      for (const { subject, title } of group.panels) if (subject.joint) title.setAttribute("aria-pressed", String(chosen));
    }
    this.redraw();
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
    this.density = on ? 2 : 1;
    this.host.classList.toggle("for-print", on);
    this.papers?.remove();
    if (on) {
      this.papers = Gaitcal.curvePapers(this.panels);
      this.grid.before(this.papers);
    } else for (const group of this.groups) group.cells.append(...group.panels.map(({ root }) => root));
    this.refresh();
    if (on) this.draw(this.panels);
  }

  // What the lines of the curves are, and of how many strides; above and below the grid.
  tell() {
    const { strides, state } = this;
    const { percent, counts, sheet, one } = strides;
    const options = (name) => document.getElementById(`switch-${name}`)?.options ?? [];
    const choices = [[options("axis")[0], one === "stride" ? "% gait cycle" : "% repetition"],
      [options("spread")[0], `mean of ${one}s`], [options("spread")[1], `every ${one}`]];
    for (const [choice, text] of choices) if (choice) choice.textContent = text;
    const many = Math.max(...counts) > 1;
    const means = percent && state.spread === "mean" && many;
    const has = (part) => sheet.trials.some(({ packed }) => packed.curves.some((curve) => curve[part] && curve.joint));
    const shown = {
      none: !percent,
      sd: means && !(state.errors && has("se")),
      se: state.errors && has("se"),
      thin: percent && many,
      nominal: state.nominal && has("nominal"),
      truth: state.truth && has("truth"),
      norm: state.norm && percent && strides.ofWalks && sheet.bands.length > 0,
      now: percent,
      off: percent && this.offs.length > 0,
      stance: !percent,
      window: state.window !== null,
    };
    const words = {
      se: means ? "± standard error of the mean" : "± standard error",
      window: `replayed part${percent ? `, of the ${Gaitcal.LEGS[this.looped]} ${one}` : ""}`,
      thin: `other ${one}s`,
      now: one === "stride" ? "now, each leg in its stride" : "now",
    };
    for (const item of this.legend.children) {
      const { key } = item.dataset;
      item.hidden = shown[key] === false;
      if (key in words) item.lastElementChild.textContent = words[key];
    }
    this.notes.replaceChildren(...this.sentences(percent, counts).map((text) => html("p", text)));
  }

  sentences(percent, [right, left]) {
    const { strides, state } = this;
    const relative = strides.trial.relative ? ["Joint angles are counted from the static trial."] : [];
    if (!percent) {
      const why = state.axis === "percent" ? ", which holds no complete stride or repetition" : "";
      return [`Against the time of ${strides.trial.name}${why}.`, ...relative];
    }
    const on = (side) => strides.on(side);
    const turning = on("r").turning.length + on("l").turning.length;
    const [turns, takes] = turning === 1 ? ["turns", "takes"] : ["turn", "take"];
    const without = ["r", "l"].filter((side) => !strides.near(side, state.seconds));
    const sources = new Set(state.norm && strides.ofWalks ? strides.sheet.bands.map(({ source }) => source) : []);
    return [
      strides.trial.repeats
        ? `0 to 100 % of ${Gaitcal.count(right, "repetition")} of ${strides.trial.name}, from rest to rest of the pelvis.`
        : `0 to 100 % of the stride of each leg, from strike to next strike: right ${right}, left ${left}.`,
      ...(turning ? [`${Gaitcal.count(turning, "stride")} ${turns} and ${takes} no part in means.`] : []),
      ...without.map((side) => `The ${Gaitcal.LEGS[side]} leg makes no complete stride in ${strides.trial.name}.`),
      ...[...sources].map((source) => `Healthy people: ${source}.`),
      ...relative,
    ];
  }
};

// The rows of the sheet, from top to bottom.
Gaitcal.ROWS = ["pelvis", "hip", "knee", "ankle", "trunk", "arm"];

// The curves of one joint: a row of angles in columns 1 to 3 (flexion, adduction, rotation), moments in 4 and 5, power in 6.
// A moment about the third axis, a fourth angle, and powers by axis, stand there when the row is enlarged.
Gaitcal.jointGroup = ({ joint, title, power, rows }, has) => {
  const total = [{ base: power, kind: "power", joint, column: 6 }].filter(has);
  const known = rows.filter((base) => ["angle", "moment"].some((kind) => has({ base, kind })));
  const own = known.flatMap((base, i) =>
    [{ base, kind: "angle", joint, column: i + 1 }, { base, kind: "moment", joint, column: i + 4 }].filter(has));
  const last = ({ kind }) => (kind === "angle" ? 3 : 6 - total.length);
  const third = (subject) => subject.column > last(subject);
  const details = rows.filter((base) => base !== power).map((base) => ({ base, kind: "power", joint, detail: true }));
  const beyond = own.filter(third).map((subject) => ({ ...subject, column: subject.kind === "angle" ? 3 : 6, third: true }));
  return { joint, title, subjects: [...own.filter((one) => !third(one)), ...total, ...beyond, ...details.filter(has)] };
};

Gaitcal.groundGroup = (has) => {
  const bases = ["vertical", "forward", "sideways"].map((way, i) =>
    ({ base: `ground_reaction_${way}`, kind: "force", joint: null, column: i + 4 }));
  return { joint: "ground", title: "Ground reactions", subjects: bases.filter(has) };
};

// Ground reactions beside the pelvis, where there is one: the first row of both sheets.
Gaitcal.besidePelvis = (groups, ground) => {
  const [first] = groups;
  if (first?.joint !== "pelvis" || !first.subjects.length) return [...groups, ground];
  const subjects = [...first.subjects, ...ground.subjects];
  return [{ ...first, title: ground.subjects.length ? "Pelvis, ground" : first.title, subjects }, ...groups.slice(1)];
};

Gaitcal.curveGroup = ({ joint, title, subjects }, curves) => {
  const folded = joint === "arm";
  const panels = subjects.map((subject) => new Gaitcal.Panel(subject, curves));
  const cells = html("div.curve-cells", panels.map((panel) => panel.root));
  const heading = html("h3", title);
  const root = html(folded ? "details.curve-group" : "section.curve-group", { "data-joint": joint },
    folded ? html("summary", heading) : heading, cells);
  return { joint, root, cells, panels };
};

// Panels of curves as they stand on paper: kinematics on one page, kinetics on the other, what is not in the sheet last.
Gaitcal.curvePapers = (panels) => {
  const whole = panels.filter(({ subject }) => !subject.detail && subject.joint !== "arm");
  const sheet = whole.sort((a, b) => Boolean(a.subject.third) - Boolean(b.subject.third));
  const paper = (title, angles) =>
    html(`section.curve-paper.${title.toLowerCase()}`, html("h2", title), html("div.curve-cells",
      sheet.filter(({ subject }) => (subject.kind === "angle") === angles).map(({ root }) => root)));
  return html("div.curve-papers", paper("Kinematics", true), paper("Kinetics", false));
};
