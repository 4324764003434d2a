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

Gaitcal.swatch = (name) => {
  const canvas = document.createElement("canvas");
  canvas.width = 60;
  canvas.height = 44;
  const pen = canvas.getContext("2d");
  const c = Object.fromEntries(Object.entries(Gaitcal.COLOURS).map(([part, colour]) => [part, Gaitcal.css(colour)]));
  const dot = (x, y, r, fill) => {
    pen.fillStyle = fill;
    pen.beginPath();
    pen.arc(x, y, r, 0, 7);
    pen.fill();
  };
  const line = (x0, y0, x1, y1, width, stroke) => {
    pen.strokeStyle = stroke;
    pen.lineWidth = width;
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  };
  const polygon = (corners, fill) => {
    pen.fillStyle = fill;
    pen.beginPath();
    for (const [x, y] of corners) pen.lineTo(x, y);
    pen.fill();
  };
  const ellipse = (x, y, a, b, fill) => {
    pen.fillStyle = fill;
    pen.beginPath();
    pen.ellipse(x, y, a, b, 0, 0, 7);
    pen.fill();
  };
  const square = (x, y, r, fill) => {
    pen.fillStyle = fill;
    pen.fillRect(x - r, y - r, 2 * r, 2 * r);
  };
  const draw = {
    body: () => ellipse(30, 22, 12, 20, c.body),
    measured: () => dot(30, 22, 11, c.measured),
    model: () => dot(30, 22, 10, c.model),
    errors: () => {
      line(16, 30, 44, 14, 6, c.error);
      dot(14, 31, 8, c.model);
      dot(46, 13, 9, c.measured);
    },
    forces: () => {
      pen.fillStyle = `${c.plate}60`;
      pen.fillRect(6, 34, 48, 8);
      line(30, 38, 30, 14, 7, c.force);
      polygon([[30, 0], [42, 18], [18, 18]], c.force);
    },
    bones: () => {
      line(14, 34, 46, 10, 9, c.bone);
      for (const [x, y] of [[9, 33], [15, 38], [45, 5], [51, 11]]) dot(x, y, 6, c.bone);
    },
    fitted: () => {
      line(10, 35, 50, 9, 6, c.fitted);
      for (const [x, y, r] of [[10, 35, 7], [30, 22, 9], [50, 9, 7]]) dot(x, y, r, c.fitted);
    },
    nominal: () => {
      pen.setLineDash([6, 5]);
      line(10, 35, 50, 9, 4, c.nominal);
      pen.setLineDash([]);
      for (const [x, y, r] of [[10, 35, 6], [30, 22, 7], [50, 9, 6]]) square(x, y, r, c.nominal);
    },
    uncertainty: () => {
      polygon([[2, 8], [30, 22], [2, 36]], `${c.fitted}55`);
      polygon([[58, 8], [30, 22], [58, 36]], `${c.fitted}55`);
      ellipse(30, 22, 14, 10, `${c.fitted}55`);
    },
  };
  draw[name]();
  return canvas;
};

Gaitcal.Legend = class {
  constructor(host, page) {
    this.page = page;
    this.state = page.state;
    this.boxes = {};
    for (const [name, title, about] of Gaitcal.LAYERS) {
      const label = document.createElement("label");
      const box = document.createElement("input");
      box.type = "checkbox";
      box.id = `show-${name}`;
      box.addEventListener("change", () => this.turn(name, box.checked));
      const text = document.createElement("span");
      text.textContent = title;
      const small = document.createElement("small");
      text.append(small);
      label.append(box, Gaitcal.swatch(name), text);
      host.append(label);
      this.boxes[name] = { box, label, small, about };
    }
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
    const get = (id) => document.getElementById(id);
    this.figure = figure;
    this.write();
    figure.bones.write(get("knees"));
    get("bones").textContent = figure.bones.source ? `Bones: ${figure.bones.source}.` : "";
    const untracked = scene.segments.filter((_, s) => !trial.tracked[s]);
    const hidden = untracked.length ? [`Hidden, no marker in this trial: ${untracked.join(", ").replaceAll("_", " ")}.`] : [];
    const plain = scene.capsules.length ? ["Plain shapes stand for body meshes that were not installed."] : [];
    get("missing").textContent = [...hidden, ...plain].join(" ");
    const events = this.page.sheet?.events.length;
    get("scale").textContent = [
      "Floor lines every 0.5 m.",
      trial.hasForces ? "Arrows: 1 m is 1000 N." : "",
      events ? "On the timeline: a bar is stance, a tick a foot strike, a ring a toe-off." : "",
      trial.hasForces ? "Line below a leg's row: its torques are valid." : "",
    ].join(" ");
  }

  write() {
    for (const [name, { box, label, small, about }] of Object.entries(this.boxes)) {
      const why = this.figure.lack(name);
      box.checked = this.state.layers.has(name);
      box.disabled = why !== null;
      label.classList.toggle("absent", why !== null);
      small.textContent = why ?? (name === "errors" && this.times > 1 ? `${about}, drawn ${this.times} times as long` : about);
    }
  }
};
