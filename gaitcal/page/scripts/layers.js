"use strict";
// The legend, which is also where each part is shown or hidden.
Gaitcal.Legend = class {
  constructor(host, page) {
    this.page = page;
    this.state = page.state;
    for (const [name, colour] of Object.entries(Gaitcal.COLOURS)) {
      document.documentElement.style.setProperty(`--layer-${name}`, Gaitcal.css(colour));
    }
    this.rows = [...host.querySelectorAll("label")].map((label) => {
      const small = label.querySelector("small");
      return { label, small, name: label.control.dataset.layer, about: small.textContent };
    });
    host.addEventListener("change", ({ target }) => this.turn(target.dataset.layer, target.checked));
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
