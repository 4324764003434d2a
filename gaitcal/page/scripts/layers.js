"use strict";
// The legend, which is also where each part is shown or hidden.
Gaitcal.LAYERS = [
  ["body", "Body", "fitted model, pose of each frame"],
  ["bones", "Bones", "on the static trial's landmarks, not on the axes"],
  ["measured", "Measured markers", "as recorded"],
  ["model", "Model markers", "where the fitted model has them"],
  ["errors", "Marker errors", "from model to measured"],
  ["forces", "Ground reactions", "arrow from the centre of pressure; force plates"],
  ["fitted", "Fitted joints", "solid, round: centre and axis in this person"],
  ["nominal", "Nominal joints", "dashed, square: before calibration"],
  ["uncertainty", "Uncertainty", "95 %: cloud of the centre, cones of the axis"],
];

// A small picture of each layer, 60 x 44.
Gaitcal.swatch = (name) => {
  const c = Object.fromEntries(Object.entries(Gaitcal.COLOURS).map(([part, colour]) => [part, Gaitcal.css(colour)]));
  const dot = (cx, cy, r, fill) => svg("circle", { cx, cy, r, fill });
  const square = (x, y, r, fill) => svg("rect", { x: x - r, y: y - r, width: 2 * r, height: 2 * r, fill });
  const line = (points, width, stroke, dash = null) =>
    svg("path", { d: `M${points}`, "stroke-width": width, stroke, "stroke-dasharray": dash });
  const shape = (points, fill) => svg("path", { d: `M${points}Z`, fill });
  const cloud = (x) => shape(`${x} 8L30 22L${x} 36`, `${c.fitted}55`);
  const along = [[10, 35], [30, 22], [50, 9]];
  const pictures = {
    body: [svg("ellipse", { cx: 30, cy: 22, rx: 12, ry: 20, fill: c.body })],
    measured: [dot(30, 22, 11, c.measured)],
    model: [dot(30, 22, 10, c.model)],
    errors: [line("16 30L44 14", 6, c.error), dot(14, 31, 8, c.model), dot(46, 13, 9, c.measured)],
    forces: [shape("6 34H54V42H6", `${c.plate}60`), line("30 38V14", 7, c.force), shape("30 0L42 18H18", c.force)],
    bones: [line("14 34L46 10", 9, c.bone), [[9, 33], [15, 38], [45, 5], [51, 11]].map(([x, y]) => dot(x, y, 6, c.bone))],
    fitted: [line("10 35L50 9", 6, c.fitted), along.map(([x, y]) => dot(x, y, x === 30 ? 9 : 7, c.fitted))],
    nominal: [line("10 35L50 9", 4, c.nominal, "6 5"), along.map(([x, y]) => square(x, y, x === 30 ? 7 : 6, c.nominal))],
    uncertainty: [cloud(2), cloud(58), svg("ellipse", { cx: 30, cy: 22, rx: 14, ry: 10, fill: `${c.fitted}55` })],
  };
  return svg("svg", { viewBox: "0 0 60 44", "aria-hidden": "true" }, pictures[name]);
};

Gaitcal.Legend = class {
  constructor(host, page) {
    this.page = page;
    this.state = page.state;
    this.rows = Gaitcal.LAYERS.map(([name, title, about]) => {
      const small = html("small");
      const label = Gaitcal.tick(html("span", title, small), (on) => this.turn(name, on), { id: `show-${name}` });
      label.classList.remove("tick");
      label.control.after(Gaitcal.swatch(name));
      return { name, about, label, small };
    });
    host.append(...this.rows.map(({ label }) => label));
    this.state.on(["layers", "preset"], () => this.write());
  }

  turn(name, on) {
    const layers = new Set(this.state.layers);
    if (on) layers.add(name);
    else layers.delete(name);
    this.state.set({ layers });
  }

  // How often as long as they are the errors of markers are drawn: most are shorter than a marker is wide.
  get times() {
    return this.page.result.sheet && this.state.preset === "fit" ? 5 : 1;
  }

  // Of another trial: which layers are empty in it, and what else is to be known of its picture.
  open(figure) {
    const { scene, trial } = figure;
    const { get } = Gaitcal;
    this.figure = figure;
    this.write();
    figure.bones.write(get("knees"));
    get("bones").textContent = figure.bones.source ? `Bones: ${figure.bones.source}.` : "";
    const untracked = scene.segments.filter((_, s) => !trial.tracked[s]).join(", ").replaceAll("_", " ");
    get("missing").textContent = [
      untracked && `Hidden, no marker in this trial: ${untracked}.`,
      scene.capsules.length > 0 && "Plain shapes stand for body meshes that were not installed.",
    ].filter(Boolean).join(" ");
    get("scale").textContent = [
      "Floor lines every 0.5 m.",
      trial.hasForces && "Arrows: 1 m is 1000 N.",
      this.page.sheet?.events.length && "On the timeline: a bar is stance, a tick a foot strike, a ring a toe-off.",
      trial.hasForces && "Line below a leg's row: its torques are valid.",
    ].filter(Boolean).join(" ");
  }

  write() {
    for (const { name, about, label, small } of this.rows) {
      const why = this.figure.lack(name);
      label.control.checked = this.state.layers.has(name);
      label.control.disabled = why !== null;
      label.classList.toggle("absent", why !== null);
      const long = name === "errors" && this.times > 1 ? `${about}, drawn ${this.times} times as long` : about;
      small.textContent = why ?? long;
    }
  }
};
