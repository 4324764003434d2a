"use strict";
// One variable over the stride: each group's mean with its standard deviation, people who are shown over it, normal
// people behind it. Drawn when it is seen.
// Steps between the values that an axis tells: 1, 2 or 5 of something, which few digits can tell.
Gaitcal.ROUND = [-3, -2, -1, 0, 1, 2, 3].flatMap((power) => [1, 2, 5].map((digit) => Number(`${digit}e${power}`)));
Gaitcal.DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3], [4, 2], [12, 5]];

// The colours of the page as it is now, light or dark.
Gaitcal.groupColours = () => {
  const style = window.getComputedStyle(document.documentElement);
  const names = [
    "ink",
    "soft",
    "line",
    "paper",
    "norm",
    ...Array.from({ length: Gaitcal.GROUP_COLOURS }, (_, k) => `group${k}`),
  ];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim() || "#000"]));
};

Gaitcal.MeanPanel = class {
  constructor(owner, variable) {
    Object.assign(this, { owner, variable, people: owner.people, choices: owner.choices });
    this.about = this.people.curves[variable];
    const { title, unit, senses, kind } = this.about;
    this.reading = Gaitcal.make("p", { class: "reading" });
    this.place = Gaitcal.make("div", { class: "mean-plot" });
    const words = Gaitcal.make("span", { class: "soft" }, ` ${unit}, + ${senses[0]}`);
    this.root = Gaitcal.make(
      "div",
      { class: "mean-panel", "data-kind": kind, tabindex: "0", role: "group" },
      Gaitcal.make("p", { class: "caption" }, Gaitcal.make("strong", {}, title), words),
      this.place,
      this.reading,
    );
    this.root.addEventListener("keydown", (event) => this.pressed(event));
    this.percents = Float64Array.from({ length: this.people.points }, (_, k) => k * this.people.every);
  }

  // What is drawn: groups in the order of the page, each with its colour and dashes.
  collect() {
    const means = Gaitcal.groupMeans(this.people, this.choices, this.variable);
    this.groups = this.people.groups.flatMap((name, k) =>
      means.has(name) && k < Gaitcal.GROUP_COLOURS ? [{ name, k, ...means.get(name) }] : [],
    );
    this.singles = this.choices.shown.flatMap((i) => {
      const curve = Gaitcal.personCurve(this.people, { legs: this.choices.legs, doubtful: true }, i, this.variable);
      return curve ? [{ i, curve }] : [];
    });
    const { normal } = this.about;
    this.normal = normal ? { mean: normal.mean.map((v) => v ?? NaN), sd: normal.sd.map((v) => v ?? NaN) } : null;
    const all = [];
    for (const { mean, sd } of [...this.groups, this.normal].filter(Boolean)) {
      for (const sign of [1, -1]) all.push(...mean.map((value, k) => value + sign * (sd[k] || 0)));
    }
    for (const { curve } of this.singles) all.push(...curve);
    const known = all.filter(Number.isFinite);
    const [low, high] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
    const room = 0.06 * (high - low) || 1;
    this.range = [low - room, high + room];
  }

  draw() {
    this.collect();
    const told = this.groups.map(
      ({ name, people, mean }) => `${Gaitcal.visible(name)}: ${people} people, ${this.ends(mean)}`,
    );
    const title = `${this.about.title}, ${this.about.unit}, over the stride`;
    this.root.setAttribute("aria-label", `${title}. ${told.join("; ") || "No curve"}. Arrow keys read the means.`);
    this.place.classList.toggle("empty", !this.groups.length && !this.singles.length);
    const [width, height] = [this.place.clientWidth, this.place.clientHeight];
    if (!width || !height) return;
    const data = [this.percents, this.percents];
    if (this.plot && this.plot.width === width) this.plot.setData(data);
    else this.create(width, height, data);
    this.read(this.at ?? null);
  }

  ends(mean) {
    const known = [...mean].filter(Number.isFinite);
    return known.length ? `from ${this.text(Math.min(...known))} to ${this.text(Math.max(...known))}` : "nothing known";
  }

  text(value) {
    return Gaitcal.numeral(value, this.about.kind === "angle" ? 1 : 2);
  }

  create(width, height, data) {
    this.plot?.destroy();
    const stroke = () => this.owner.colours.soft;
    const line = { stroke: () => this.owner.colours.line, width: 0.6 };
    const axis = { font: "11px system-ui, sans-serif", stroke, grid: line, ticks: { ...line, size: 3 }, gap: 2 };
    const values = (_plot, splits) => {
      const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
      return splits.map((value) =>
        Gaitcal.number(value, Math.min(3, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))),
      );
    };
    this.plot = new uPlot(
      {
        width,
        height,
        legend: { show: false },
        padding: [4, 12, 0, 0],
        cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
        scales: { x: { time: false, range: () => [0, 100] }, y: { range: () => this.range } },
        axes: [
          { ...axis, size: 18, values, incrs: [25, 50] },
          { ...axis, size: 38, incrs: Gaitcal.ROUND, space: 24, values },
        ],
        series: [{}, { paths: () => null, points: { show: false } }],
        hooks: { drawAxes: [(plot) => this.paint(plot)], setCursor: [({ cursor }) => this.read(cursor.idx ?? null)] },
      },
      data,
      this.place,
    );
  }

  paint(plot) {
    const pen = new Gaitcal.Pen(plot, this.owner.colours, uPlot.pxRatio);
    const all = new Uint8Array(this.percents.length).fill(1);
    const line = (value) => ({ x: this.percents, value, valid: all, side: "" });
    pen.pen.save();
    pen.pen.beginPath();
    pen.pen.rect(pen.box.left, pen.box.top, pen.box.width, pen.box.height);
    pen.pen.clip();
    if (this.normal) {
      const { mean, sd } = this.normal;
      pen.fill(this.percents, mean, sd, () => true, this.owner.colours.norm, 0.25);
      for (const sign of [1, -1])
        pen.stroke(
          line(null),
          mean.map((value, k) => value + sign * sd[k]),
          { width: 1, colour: "norm", dash: [1, 2.5] },
        );
    }
    for (const { mean, sd, k } of this.groups)
      pen.fill(this.percents, mean, sd, () => true, this.owner.colours[`group${k}`], 0.14);
    pen.zero();
    for (const { mean, k } of this.groups)
      pen.stroke(line(mean), mean, { width: 2.2, colour: `group${k}`, dash: Gaitcal.DASHES[k] });
    this.singles.forEach(({ curve }, n) => {
      pen.stroke(line(curve), curve, { width: 1.4, colour: "ink", dash: Gaitcal.DASHES[n] });
      this.marks(pen, curve, n);
    });
    pen.pen.restore();
  }

  // The number by which the legend knows a person.
  marks({ pen, x, y, scale }, curve, n) {
    const at = Math.round((0.15 + 0.2 * n) * (curve.length - 1));
    if (Number.isNaN(curve[at])) return;
    pen.font = `700 ${11 * scale}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillStyle = this.owner.colours.paper;
    pen.beginPath();
    pen.arc(x(this.percents[at]), y(curve[at]), 7 * scale, 0, 2 * Math.PI);
    pen.fill();
    pen.fillStyle = this.owner.colours.ink;
    pen.fillText(String(n + 1), x(this.percents[at]), y(curve[at]));
  }

  // The means at a percent, below the curves; without one how many people they are of.
  read(k) {
    const parts = this.groups.map(({ name, mean, sd, count, people }) => {
      if (k === null) return `${Gaitcal.visible(name)} n ${people}`;
      const spread = Number.isNaN(sd[k]) ? "" : ` ± ${this.text(sd[k])}`;
      return `${Gaitcal.visible(name)} ${this.text(mean[k])}${spread} (n ${count[k]})`;
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
