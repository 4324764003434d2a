"use strict";
// Mean curves of groups, their legend, and who lies far from the mean. Legs that are refused take no part.
Gaitcal.DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3], [4, 2], [12, 5]];

Gaitcal.MeanCurves = class {
  constructor(host, people, choices) {
    Object.assign(this, { people, choices, dirty: new Set(), visible: new Set() });
    this.colours = Gaitcal.pageColours();
    const doubtful = Gaitcal.tick("doubtful legs take part", (on) => choices.set({ doubtful: on }));
    this.tick = doubtful.control;
    this.legend = html("ul.mean-legend", { "aria-label": "Legend" });
    this.far = html("div.far");
    this.panels = people.curves.map((_, k) => new Gaitcal.MeanPanel(this, k));
    host.append(
      html("div.bar", Gaitcal.legsChoice(choices), doubtful),
      this.legend,
      html("div.mean-grid", this.panels.map(({ root }) => root)),
      this.far,
    );
    // What is drawn in each part of the page, when it is seen.
    this.parts = new Map(this.panels.map((panel) => [panel.root, () => panel.draw()]));
    this.parts.set(this.far, () => this.farthest());
    const watch = new IntersectionObserver((entries) => this.came(entries), { rootMargin: "200px" });
    for (const part of this.parts.keys()) watch.observe(part);
    choices.on([...Gaitcal.NARROWING, "legs", "doubtful"], () => this.stale());
    choices.on(["shown"], () => this.stale(false));
    new ResizeObserver(() => this.stale(false)).observe(host);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.stale(false));
    window.addEventListener("beforeprint", () => this.paper(true));
    window.addEventListener("afterprint", () => this.paper(false));
    this.stale();
  }

  // What is drawn again when it is next seen. `people`: whether other people take part.
  stale(people = true) {
    this.colours = Gaitcal.pageColours();
    this.tick.checked = this.choices.doubtful;
    this.label();
    for (const part of this.parts.keys()) if (people || part !== this.far) this.dirty.add(part);
    this.later ??= requestAnimationFrame(() => {
      this.later = null;
      this.refresh();
    });
  }

  came(entries) {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) this.visible.add(target);
      else this.visible.delete(target);
    }
    this.refresh();
  }

  refresh(all = false) {
    for (const part of [...this.dirty].filter((one) => all || this.visible.has(one))) {
      this.dirty.delete(part);
      this.parts.get(part)();
    }
  }

  paper(on) {
    document.documentElement.classList.toggle("on-paper", on);
    this.stale(false);
    this.refresh(on);
  }

  label() {
    const { people, choices } = this;
    const inside = new Set(choices.filtered().map((i) => people.groupOf[i]));
    const key = (colour, dash) =>
      svg(`svg.curve-key.of-${colour}`, { width: 34, height: 14, "aria-hidden": "true" },
        colour !== "ink" && svg("rect", { y: 1, width: 34, height: 12 }),
        svg("line", { x1: 0, x2: 34, y1: 7, y2: 7, "stroke-dasharray": dash.join(" ") || null }),
      );
    const { groups } = people;
    const drawn = groups.slice(0, Gaitcal.GROUP_COLOURS);
    const normal = people.curves.find((curve) => curve.normal)?.normal;
    const single = (i, n) => {
      const words = `No longer draw ${Gaitcal.visible(people.name(i))}`;
      const off = Gaitcal.button("✕", () => choices.show(i, false), { class: "off", "aria-label": words });
      return html("li", key("ink", Gaitcal.DASHES[n]), html("strong", String(n + 1)), people.linked(i), off);
    };
    this.legend.replaceChildren();
    Gaitcal.built(this.legend, "", [
      drawn.map((name, k) => inside.has(name) && html("li", key(`group${k}`, Gaitcal.DASHES[k]), Gaitcal.named(name))),
      normal && html("li", key("norm", [1, 2.5]), html("span", { title: normal.source }, "normal band, mean ± SD")),
      choices.shown.map(single),
      groups.length > drawn.length &&
        html("li", html("span"), `only the first ${drawn.length} of ${groups.length} groups are drawn`),
    ]);
  }

  farthest() {
    const button = ({ i, distance }) => {
      const words = [Gaitcal.named(this.people.name(i)), html("span.soft", ` ${Gaitcal.numeral(distance, 1)} SD`)];
      return html("li", Gaitcal.button(words, () => this.choices.show(i)));
    };
    const items = this.people.farthest(this.choices).map(button);
    const words = "Root mean square over all curves, in standard deviations between people. Press to draw over the means.";
    const parts = [html("h3", "Farthest from the mean of their group"), html("p.hint", words), html("ul.chips", items)];
    this.far.replaceChildren(...(items.length ? parts : []));
  }
};

// One variable over the stride: each group's mean with its standard deviation, people who are shown over it, normal
// people behind it.
Gaitcal.MeanPanel = class {
  constructor(owner, variable) {
    Object.assign(this, { owner, variable, people: owner.people, choices: owner.choices });
    this.about = this.people.curves[variable];
    const { title, unit, senses, kind } = this.about;
    this.reading = html("p.reading");
    this.place = html("div.mean-plot");
    this.root = html("div.mean-panel",
      { "data-kind": kind, tabindex: "0", role: "group", keydown: (event) => this.pressed(event) },
      html("p.caption", html("strong", title), html("span.soft", ` ${unit}, + ${senses[0]}`)),
      this.place,
      this.reading,
    );
    this.percents = Array.from({ length: this.people.points }, (_, k) => k * this.people.every);
  }

  draw() {
    const { people, choices, variable } = this;
    const means = people.means(choices, variable);
    const drawn = people.groups.slice(0, Gaitcal.GROUP_COLOURS);
    this.groups = drawn.flatMap((name, k) => (means.has(name) ? [{ name, k, ...means.get(name) }] : []));
    this.singles = choices.shown.flatMap((i, n) => {
      const curve = people.curve(i, variable, { legs: choices.legs, doubtful: true });
      return curve ? [{ n, curve }] : [];
    });
    const told = this.groups.map(
      (group) => `${Gaitcal.visible(group.name)}: ${group.people} people, ${this.ends(group.mean)}`,
    );
    const title = `${this.about.title}, ${this.about.unit}, over the stride`;
    this.root.setAttribute("aria-label", `${title}. ${told.join("; ") || "No curve"}. Arrow keys read the means.`);
    this.place.classList.toggle("empty", !this.groups.length && !this.singles.length);
    const size = [this.place.clientWidth, this.place.clientHeight];
    if (size.includes(0)) return;
    this.plot?.destroy();
    this.plot = Gaitcal.plot(this.place, size, this.drawing());
    this.read(this.at ?? null);
  }

  drawing() {
    const { percents, groups, singles, owner: { colours }, about: { normal } } = this;
    const around = (mean, sd, colour, alpha) => ({
      x: percents, low: mean.map((value, k) => value - sd[k]), high: mean.map((value, k) => value + sd[k]), colour, alpha,
    });
    const known = (values) => values.map((value) => value ?? NaN);
    const norms = normal ? [around(known(normal.mean), known(normal.sd), colours.norm, 0.25)] : [];
    const bands = [...norms, ...groups.map(({ mean, sd, k }) => around(mean, sd, colours[`group${k}`], 0.14))];
    const line = (y, colour, width, dash) => ({ x: percents, y, colour, width, dash });
    const lines = [
      ...norms.flatMap(({ low, high }) => [low, high].map((y) => line(y, colours.norm, 1, [1, 2.5]))),
      ...groups.map(({ mean, k }) => line(mean, colours[`group${k}`], 2.2, Gaitcal.DASHES[k])),
      ...singles.map(({ curve, n }) => line(curve, colours.ink, 1.4, Gaitcal.DASHES[n])),
    ];
    const all = [...bands.flatMap(({ low, high }) => [low, high]), ...lines.map(({ y }) => y)].flat().filter(Number.isFinite);
    const [low, high] = all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
    const room = 0.06 * (high - low) || 1;
    return {
      x: [0, 100], y: [low - room, high + room], lines, bands, colours, font: 11, incrs: [25, 50],
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
      hooks: { setCursor: [({ cursor }) => this.read(cursor.idx ?? null)], draw: [(plot) => this.number(plot)] },
    };
  }

  ends(mean) {
    const known = mean.filter(Number.isFinite);
    return known.length ? `from ${this.text(Math.min(...known))} to ${this.text(Math.max(...known))}` : "nothing known";
  }

  get digits() {
    return this.about.kind === "angle" ? 1 : 2;
  }

  text(value) {
    return Gaitcal.numeral(value, this.digits);
  }

  // The numbers by which the legend knows people.
  number({ ctx: pen, valToPos }) {
    const { paper, ink } = this.owner.colours;
    const scale = uPlot.pxRatio;
    Object.assign(pen, { font: `700 ${11 * scale}px system-ui, sans-serif`, textAlign: "center", textBaseline: "middle" });
    for (const { n, curve } of this.singles) {
      const at = Math.round((0.15 + 0.2 * n) * (curve.length - 1));
      if (Number.isNaN(curve[at])) continue;
      const [x, y] = [valToPos(this.percents[at], "x", true), valToPos(curve[at], "y", true)];
      pen.fillStyle = paper;
      pen.beginPath();
      pen.arc(x, y, 7 * scale, 0, 2 * Math.PI);
      pen.fill();
      pen.fillStyle = ink;
      pen.fillText(String(n + 1), x, y);
    }
  }

  // The means at a percent, below the curves; without one how many people they are of.
  read(k) {
    const parts = this.groups.map(({ name, mean, sd, n, people }) => {
      const shown = Gaitcal.visible(name);
      return k === null ? `${shown} n ${people}` : `${shown} ${Gaitcal.plusMinus(mean[k], sd[k], this.digits)} (n ${n[k]})`;
    });
    const words = `${k === null ? "" : `${this.percents[k]} %: `}${parts.join("; ")}`;
    if (this.reading.textContent !== words) this.reading.textContent = words;
  }

  pressed(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step || !this.groups) return;
    this.at = Math.min(this.percents.length - 1, Math.max(0, (this.at ?? (step > 0 ? -1 : 1)) + step));
    this.reading.setAttribute("role", "status");
    this.read(this.at);
    event.preventDefault();
  }
};
