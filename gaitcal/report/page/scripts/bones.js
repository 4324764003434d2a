// Behind a bone a mark is veiled, not hidden: where it enters and leaves the bone is to be seen.
Gaitcal.VEIL = { opacity: 0.38, depthFunc: THREE.GreaterDepth, depthWrite: false };

// A mark before the bones, and once more, veiled, behind them. `materials`: of both.
Gaitcal.veiled = (group, geometry, [plain, veil]) => [
  Gaitcal.mesh(group, geometry, plain, Gaitcal.ORDER.marks),
  Gaitcal.mesh(group, geometry, veil, Gaitcal.ORDER.veiled),
];

// Whether a segment or joint is to be seen when a joint is looked at from near by: none of the other side is.
Gaitcal.beside = (name, near) => {
  const [side, other] = [name, near ?? ""].map((text) => /_([rl])$/.exec(text)?.[1]);
  return !side || !other || side === other;
};

// The bones inside the body, which hide what lies behind them. Their outlines stand on landmarks that somebody palpated,
// not on the fitted axes; see gaitcal/report/page/bone_landmarks.py.
Gaitcal.Bones = class {
  constructor(scene, body) {
    this.segments = scene.segments;
    this.why = scene.bones.why;
    this.knees = scene.bones.knees ?? [];
    this.source = scene.bones.source ?? "";
    this.meshes = [];
    const bone = new THREE.MeshPhongMaterial({
      color: Gaitcal.COLOURS.bone, shininess: 8, specular: 0x1a1a1a, side: THREE.DoubleSide,
    });
    this.bone = bone;
    this.dim = bone.clone();
    Object.assign(this.dim, { transparent: true, opacity: 0.22, depthWrite: false });
    // Once more into the depth buffer, which the joints begin anew: so bones hide, or veil, the axes behind them.
    const depth = new THREE.MeshBasicMaterial({ colorWrite: false, transparent: true, side: THREE.DoubleSide });
    const layers = [[bone, 0], [depth, Gaitcal.ORDER.bones]];
    const { meshes = {}, placed = [] } = scene.bones;
    for (const { mesh, segment, order } of Gaitcal.meshes(meshes, placed, body.groups, layers)) {
      mesh.castShadow = order === 0;
      this.meshes.push({ mesh, segment, part: order === 0 ? "bone" : "depth" });
    }
    for (const knee of this.knees) this.circles(knee, body);
  }

  // The circle and centre of each condyle, and the line through both centres: what the axes are measured against.
  circles({ segment, across, centres, radii }, body) {
    const vector = (values) => new THREE.Vector3().fromArray(values);
    const material = new THREE.MeshBasicMaterial({ color: Gaitcal.COLOURS.condyles, transparent: true });
    const materials = [material, Object.assign(material.clone(), Gaitcal.VEIL)];
    const add = (geometry, place, from, to) => {
      for (const mesh of Gaitcal.veiled(body.groups[segment], geometry, materials)) {
        mesh.position.copy(place);
        mesh.quaternion.setFromUnitVectors(from, to);
        this.meshes.push({ mesh, segment, near: true });
      }
    };
    const [y, z] = [new THREE.Vector3(0, 1, 0), new THREE.Vector3(0, 0, 1)];
    const [one, other] = centres.map(vector);
    for (const [k, centre] of [one, other].entries()) {
      add(new THREE.TorusGeometry(radii[k], 0.0007, 8, 64), centre, z, vector(across));
      add(new THREE.SphereGeometry(0.0022, 16, 12), centre, z, vector(across));
    }
    const line = other.clone().sub(one);
    const rod = new THREE.CylinderGeometry(0.0007, 0.0007, line.length(), 8);
    add(rod, one.clone().lerp(other, 0.5), y, line.normalize());
  }

  // `near`: the joint that is looked at from near by, whose leg alone is shown, and of that brightly only what is beside
  // the joint (`beside`: its segments); null: the whole person.
  // `joints`: whether marks are drawn that bones hide.
  show(on, trial, { near, beside, joints }) {
    for (const { mesh, segment, part, near: only } of this.meshes) {
      const dim = beside !== null && !beside.has(segment);
      if (part === "bone") mesh.material = dim ? this.dim : this.bone;
      const shown = on && trial.tracked[segment] && Gaitcal.beside(this.segments[segment], near);
      mesh.visible = shown && (!only || near !== null) && !(part === "depth" && (dim || !joints));
    }
  }

  // What is said of the knee that is looked at, beside it; null where there is nothing to say.
  words(near) {
    const knee = this.knees.find((one) => one.joint === near);
    return knee ? [knee.title, ...knee.words].join("\n") : null;
  }
};
