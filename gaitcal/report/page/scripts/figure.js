// The body of one result, with its bones, markers, forces and joints.
Gaitcal.Figure = class {
  constructor(result, root) {
    const { scene } = result;
    this.scene = scene;
    this.group = new THREE.Group();
    root.add(this.group);
    this.body = new Gaitcal.Body(scene, this.group);
    this.bones = new Gaitcal.Bones(scene, this.body);
    this.markers = new Gaitcal.Markers(scene, this.group);
    this.forces = new Gaitcal.Forces(this.group);
    this.joints = new Gaitcal.Joints(scene, this.body, this.group);
    this.trial = null;
  }

  open(trial) {
    this.trial = trial.open();
    this.forces.open(trial);
  }

  // `near`: the joint that is looked at from near by; `times`: how often as long the marker errors are drawn.
  pose(seconds, near, times) {
    const at = this.trial.frame(seconds);
    this.body.pose(this.trial, at);
    this.markers.pose(this.trial, at, this.body, { near, times });
    this.forces.pose(this.trial, at);
  }

  // `on(layer)`: whether a layer is shown; `layered`: whether the body is drawn twice, so that one layer of it is seen.
  show(on, near, layered) {
    const { trial } = this;
    const beside = this.joints.segments(near);
    this.body.show(on("body"), trial, { bones: on("bones"), near, beside, layered });
    const kinds = ["nominal", "fitted", "uncertainty"];
    this.bones.show(on("bones"), trial, { near, beside, joints: kinds.some(on) });
    this.markers.measured.visible = on("measured");
    this.markers.model.visible = on("model");
    this.markers.bars.visible = on("errors");
    this.forces.group.visible = on("forces") && near === null;
    for (const kind of kinds) this.joints.show(kind, on(kind), trial, near);
  }

  // Where the person is: the pelvis.
  get place() { return this.body.groups[0].position; }

  // m: what is seen of the person, whose trunk may carry no marker; the pelvis ends at 0.62 of the body's height.
  get tall() {
    const trunk = this.scene.segments.indexOf("head_trunk");
    return (trunk < 0 || this.trial.tracked[trunk] ? 1 : 0.66) * this.scene.height;
  }

  // Why a layer is empty in this trial; null: it is not.
  lack(layer) {
    const { trial } = this;
    if (layer === "bones") return this.bones.why;
    if (layer === "forces") return trial.hasForces || trial.plates.length ? null : "no force plates in this trial";
    if (layer === "uncertainty") return this.joints.parts.uncertainty.length ? null : "not estimated";
    if (layer === "fitted") return this.joints.parts.fitted.length ? null : "no joint was fitted";
    return null;
  }

  // What may be pointed at: [place, text, joint or nothing].
  targets(on) {
    const joints = this.joints.targets(this.trial, on("fitted") || on("nominal"));
    return [...this.markers.targets(), ...joints, ...this.forces.targets(9.81 * this.scene.mass)];
  }
};
