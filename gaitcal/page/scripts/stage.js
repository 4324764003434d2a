"use strict";
// Everything together: one trial at one time, and the controls that change them.
Gaitcal.Player = class {
  constructor(scene) {
    const THREE = MeshCat.THREE;
    const get = (id) => document.getElementById(id);
    this.get = get;
    this.scene = scene;
    this.trials = scene.trials.map((packed) => new Gaitcal.Trial(packed, scene));
    this.viewer = new MeshCat.Viewer(get("pane"));
    this.viewer.gui.domElement.remove();
    for (const path of [["Grid"], ["Axes"], ["Lights"]]) this.viewer.set_property(path, "visible", false);
    const shade = [0xee / 255, 0xf2 / 255, 0xf5 / 255];
    this.viewer.set_property(["Background"], "top_color", shade);
    this.viewer.set_property(["Background"], "bottom_color", shade);
    this.viewer.scene.fog = new THREE.Fog(Gaitcal.COLOURS.background, 7, 20);
    this.viewer.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    // MeshCat's scene has z up; everything below has y up, as the recordings.
    const root = new THREE.Group();
    root.rotation.x = Math.PI / 2;
    this.viewer.set_object(["gaitcal"], root);
    const upright = new THREE.Group();
    root.add(upright);

    this.stage = new Gaitcal.Stage(upright);
    this.body = new Gaitcal.Body(scene, upright);
    this.bones = new Gaitcal.Bones(scene, this.body);
    this.markers = new Gaitcal.Markers(scene, upright);
    this.forces = new Gaitcal.Forces(upright);
    this.joints = new Gaitcal.Joints(scene, this.body, upright);
    this.camera = new Gaitcal.Camera(this.viewer, get("pane"), scene.height);
    this.legend = new Gaitcal.Legend(get("toggles"), () => this.refresh());
    this.tip = new Gaitcal.Tip(get("tip"), this.camera, () => this.targets());
    this.person = new THREE.Vector3();
    // The joint that is looked at from near by: view.html#knee_r opens there.
    this.near = scene.joints.find(({ joint }) => `#${joint}` === window.location.hash)?.joint ?? null;
    this.bones.write(get("knees"));
    get("bones").textContent = this.bones.source ? `Bones: ${this.bones.source}.` : "";
    this.playing = false;
    this.seconds = 0;
    this.speed = 1;
    this.slow = 0;
    this.eased = false;
    this.controls();
    this.open(Math.max(0, this.trials.findIndex((trial) => trial.role === "gait")));
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.play(!still && this.near === null);
    this.before = null;
    requestAnimationFrame((now) => this.tick(now));
  }

  controls() {
    const { get } = this;
    for (const [i, trial] of this.trials.entries()) get("trial").add(new Option(trial.name, String(i)));
    get("trial").addEventListener("change", () => this.open(Number(get("trial").value)));
    get("speed").addEventListener("change", () => (this.speed = Number(get("speed").value)));
    get("play").addEventListener("click", () => this.play(!this.playing));
    get("time").addEventListener("input", () => this.seek(Number(get("time").value)));
    get("follow").addEventListener("change", () => this.refresh());
    get("open").addEventListener("click", () => {
      const open = document.querySelector("main").classList.toggle("open");
      get("open").setAttribute("aria-expanded", String(open));
    });
    for (const [title, x, y, z] of [["oblique", 0.75, 0.3, 0.85], ["side", 0, 0.06, 1], ["front", 1, 0.06, 0], ["back", -1, 0.06, 0]]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = title;
      button.addEventListener("click", () => this.look(x, y, z));
      get("views").append(button);
    }
    for (const [title, joint] of [["whole body", null], ["right knee", "knee_r"], ["left knee", "knee_l"]]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = title;
      button.addEventListener("click", () => {
        this.near = joint;
        if (joint) this.play(false);
        this.refresh();
        this.look(...(joint ? [1, 0.06, 0] : [0.75, 0.3, 0.85]));
      });
      get("near").append(button);
    }
    window.addEventListener("keydown", (event) => {
      if (event.target.closest("input, select, button, summary") && event.key !== "Escape") return;
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (event.key === " ") this.play(!this.playing);
      else if (step) this.step(step);
      else return;
      event.preventDefault();
    });
    window.addEventListener("resize", () => this.strip());
  }

  open(index) {
    const { get, scene } = this;
    this.trial = this.trials[index].open();
    get("trial").value = String(index);
    get("time").max = String(this.trial.duration);
    this.seconds = 0;
    const rate = ((this.trial.time.length - 1) / this.trial.duration) * this.trial.stride;
    const frames = `${Gaitcal.group(this.trial.recorded)} frame${this.trial.recorded === 1 ? "" : "s"}`;
    document.title = `${scene.subject} \u00b7 ${this.trial.name}`;
    get("subject").textContent = scene.subject;
    const lines = [
      `${this.trial.name} \u00b7 ${frames}${Number.isFinite(rate) ? ` at ${Math.round(rate)} Hz` : ""}`,
      `${scene.mass.toFixed(1)} kg, ${scene.height.toFixed(2)} m`,
    ];
    if (this.trial.stride > 1) {
      lines.push(`every ${Gaitcal.ordinal(this.trial.stride)} frame is in this page; poses between are interpolated`);
    }
    this.about = lines.join("\n");
    this.legend.reason("bones", this.bones.why);
    this.forces.open(this.trial);
    this.legend.reason("forces", this.trial.hasForces || this.trial.plates.length ? null : "no force plates in this trial");
    this.legend.reason("uncertainty", this.joints.known ? null : "not estimated");
    this.legend.reason("fitted", this.joints.parts.fitted.length ? null : "no joint was fitted");
    const untracked = scene.segments.filter((_, s) => !this.trial.tracked[s]);
    const hidden = untracked.length ? [`Hidden, no marker in this trial: ${untracked.join(", ").replaceAll("_", " ")}.`] : [];
    const plain = scene.capsules.length ? ["Plain shapes stand for body meshes that were not installed."] : [];
    get("missing").textContent = [...hidden, ...plain].join(" ");
    get("scale").textContent =
      "Floor lines every 0.5 m." +
      (this.trial.hasForces ? " Arrows: 1 m is 1000 N. Green on the timeline: torques are valid of the right leg (above), of the left leg (below)." : "");
    this.strip();
    this.refresh();
    this.look(...(this.near ? [1, 0.06, 0] : [0.75, 0.3, 0.85]));
  }

  // The whole person, or the joint that is looked at, from a direction.
  look(x, y, z) {
    const joint = this.near && this.joints.pose(this.near);
    if (joint) this.camera.lookAt(joint, x, y, this.near.endsWith("_l") ? -z : z);
    else this.camera.look(this.person, x, y, z);
  }

  // When the ground reaction on a foot is known, above the time slider: right over left.
  strip() {
    const canvas = this.get("strip");
    canvas.hidden = !this.trial.hasForces;
    canvas.width = Math.max(1, canvas.clientWidth);
    const pen = canvas.getContext("2d");
    const { time, validLegs, duration } = this.trial;
    pen.fillStyle = Gaitcal.css(Gaitcal.COLOURS.force);
    for (let i = 0; i + 1 < time.length; i++) {
      const [a, b] = [time[i], time[i + 1]].map((t) => (t / duration) * canvas.width);
      for (const leg of [0, 1])
        if (validLegs[2 * i + leg]) pen.fillRect(a, (leg * canvas.height) / 2, Math.max(1, b - a + 0.5), canvas.height / 2);
    }
  }

  play(on) {
    this.playing = on;
    this.get("play").textContent = on ? "\u275a\u275a" : "\u25b6";
    this.get("play").setAttribute("aria-label", on ? "Pause" : "Play");
  }

  step(frames) {
    this.play(false);
    const at = this.trial.frame(this.seconds);
    const here = at.part > 0.5 ? at.high : at.low;
    this.seek(this.trial.time[Math.min(this.trial.time.length - 1, Math.max(0, here + frames))]);
  }

  seek(seconds) {
    this.seconds = seconds;
    this.refresh();
  }

  tick(now) {
    if (this.playing && this.before !== null) {
      this.ease(now - this.before);
      const elapsed = Math.min(0.25, (now - this.before) / 1000);
      this.seconds += elapsed * this.speed;
      if (this.seconds > this.trial.duration) this.seconds = this.trial.duration > 0 ? this.seconds % this.trial.duration : 0;
      this.refresh();
    }
    this.before = now;
    requestAnimationFrame((later) => this.tick(later));
  }

  // Where drawing is slow, as without a graphics card, shadows and fine pixels go.
  ease(milliseconds) {
    this.slow = milliseconds > 90 ? this.slow + 1 : Math.max(0, this.slow - 1);
    if (this.slow < 8 || this.eased) return;
    this.eased = true;
    this.stage.sun.castShadow = false;
    this.viewer.renderer.setPixelRatio(0.75);
    this.camera.resize();
  }

  refresh() {
    const { trial, legend } = this;
    const at = trial.frame(this.seconds);
    this.body.pose(trial, at);
    this.markers.pose(trial, at, this.body, this.near);
    this.forces.pose(trial, at);
    const bones = legend.on("bones");
    const words = bones ? this.bones.words(this.near) : null;
    this.get("about").textContent = words ?? this.about;
    this.get("heading").classList.toggle("near", words !== null);
    this.body.show(legend.on("body"), trial, bones && this.bones.why === null, this.near);
    this.bones.show(bones, trial, this.near);
    this.markers.measured.visible = legend.on("measured");
    this.markers.model.visible = legend.on("model");
    this.markers.bars.visible = legend.on("errors");
    this.forces.group.visible = legend.on("forces") && this.near === null;
    for (const kind of ["nominal", "fitted", "uncertainty"]) this.joints.show(kind, legend.on(kind), trial, this.near);
    this.person.copy(this.body.groups[0].position);
    this.stage.follow(this.person);
    const joint = this.near && this.joints.pose(this.near);
    this.camera.goAlong(joint ? joint.place : this.person, this.get("follow").checked, Boolean(joint));
    this.get("time").value = String(this.seconds);
    this.get("clock").textContent = `${(trial.start + this.seconds).toFixed(2)} s`;
    this.viewer.set_dirty();
  }

  targets() {
    const joints = this.joints.targets(this.trial, this.legend.on("fitted") || this.legend.on("nominal"));
    return [...this.markers.targets(), ...joints, ...this.forces.targets(9.81 * this.scene.mass)];
  }
};

Gaitcal.group = (n) => String(n).replace(/\B(?=(\d{3})+$)/g, "\u202f");

Gaitcal.ordinal = (n) => {
  const last = n % 100;
  const ending = last > 10 && last < 14 ? "th" : { 1: "st", 2: "nd", 3: "rd" }[n % 10] ?? "th";
  return n === 2 ? "second" : n === 3 ? "third" : `${n}${ending}`;
};
