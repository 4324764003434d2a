// Measured markers, model markers, and a bar from one to the other.
Gaitcal.Markers = class {
  constructor(scene, root) {
    const colours = Gaitcal.COLOURS;
    this.labels = scene.markers.labels;
    this.segments = scene.markers.segments;
    this.sides = this.segments.map((segment) => scene.segments[segment]);
    const places = Gaitcal.floats(scene.markers.places);
    const count = this.labels.length;
    this.local = this.labels.map((_, i) => new THREE.Vector3().fromArray(places, 3 * i));
    this.atMeasured = this.labels.map(() => new THREE.Vector3());
    this.atModel = this.labels.map(() => new THREE.Vector3());
    this.seen = new Array(count).fill(false);
    this.carried = new Array(count).fill(false);
    const many = (geometry, colour) => {
      const material = new THREE.MeshPhongMaterial({ color: colour, shininess: 30, specular: 0x333333 });
      const mesh = new THREE.InstancedMesh(geometry, material, Math.max(1, count));
      mesh.count = count;
      mesh.frustumCulled = false;
      root.add(mesh);
      return mesh;
    };
    this.measured = many(new THREE.SphereGeometry(0.0105, 14, 10), colours.measured);
    this.model = many(new THREE.SphereGeometry(0.0086, 14, 10), colours.model);
    this.bars = many(new THREE.CylinderGeometry(0.0026, 0.0026, 1, 8), colours.error);
    this.bars.material.emissive.setHex(0x500010);
    // Drawn over body and markers, as joints are: most are shorter than a marker is wide.
    this.bars.material.transparent = true;
    this.bars.renderOrder = 4;
  }

  // `near`: the joint that is looked at from near by, where markers are small and those of the other side are hidden;
  // `times`: how often as long as they are the errors are drawn.
  pose(trial, at, body, { near, times }) {
    const matrix = new THREE.Matrix4();
    const none = new THREE.Matrix4().makeScale(0, 0, 0);
    const along = new THREE.Vector3();
    const up = new THREE.Vector3(0, 1, 0);
    const turn = new THREE.Quaternion();
    const size = near === null ? 1 : 0.6;
    const ball = (place) => matrix.makeScale(size, size, size).setPosition(place);
    for (let i = 0; i < this.labels.length; i++) {
      const group = body.groups[this.segments[i]];
      this.seen[i] = trial.marker(at, i, this.atMeasured[i]);
      this.carried[i] = trial.tracked[this.segments[i]];
      this.atModel[i].copy(this.local[i]).applyMatrix4(group.matrix);
      const beside = Gaitcal.beside(this.sides[i], near);
      const put = (mesh, shown, m) => mesh.setMatrixAt(i, shown && beside ? m : none);
      put(this.measured, this.seen[i], ball(this.atMeasured[i]));
      put(this.model, this.carried[i], ball(this.atModel[i]));
      along.subVectors(this.atMeasured[i], this.atModel[i]);
      const length = times * along.length();
      if (length > 0) turn.setFromUnitVectors(up, along.normalize());
      const middle = this.atModel[i].clone().addScaledVector(along, length / 2);
      matrix.compose(middle, turn, new THREE.Vector3(size, length, size));
      put(this.bars, this.seen[i] && this.carried[i] && length > 0, matrix);
    }
    for (const mesh of [this.measured, this.model, this.bars]) mesh.instanceMatrix.needsUpdate = true;
  }

  error(i) { return this.atMeasured[i].distanceTo(this.atModel[i]); }

  // What may be pointed at: [place, text] of every marker that is drawn.
  targets() {
    const out = [];
    this.labels.forEach((label, i) => {
      const both = this.seen[i] && this.carried[i];
      const text = both ? `${label}\n${(1000 * this.error(i)).toFixed(1)} mm from the model's marker` : label;
      if (this.measured.visible && this.seen[i]) out.push([this.atMeasured[i], text]);
      else if (this.model.visible && this.carried[i]) out.push([this.atModel[i], text]);
    });
    return out;
  }
};

// Ground reactions as arrows from the centre of pressure, drawn over the body as joints are; force plates.
Gaitcal.Forces = class {
  constructor(root) {
    this.METRES_PER_NEWTON = 0.001;
    this.group = new THREE.Group();
    this.plates = new THREE.Group();
    this.group.add(this.plates);
    root.add(this.group);
    const material = new THREE.MeshPhongMaterial({ color: Gaitcal.COLOURS.force, emissive: 0x002a1e, transparent: true });
    this.arrows = [0, 1].map(() => {
      const arrow = new THREE.Group();
      const shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.011, 0.011, 1, 16).translate(0, 0.5, 0), material);
      const head = new THREE.Mesh(new THREE.ConeGeometry(0.032, 0.09, 20).translate(0, -0.045, 0), material);
      arrow.add(shaft, head);
      shaft.renderOrder = head.renderOrder = 4;
      this.group.add(arrow);
      return { arrow, shaft, head, newtons: 0 };
    });
  }

  open(trial) {
    this.plates.clear();
    const fill = new THREE.MeshBasicMaterial({
      color: Gaitcal.COLOURS.plate, transparent: true, opacity: 0.28, side: THREE.DoubleSide, depthWrite: false,
    });
    const line = new THREE.LineBasicMaterial({ color: Gaitcal.COLOURS.plate });
    for (let p = 0; p < trial.plates.length; p += 12) {
      const corners = trial.plates.slice(p, p + 12);
      const plate = new THREE.Group();
      plate.position.y = 0.002;
      const area = Gaitcal.geometry(corners, [0, 1, 2, 0, 2, 3]);
      plate.add(new THREE.Mesh(area, fill), new THREE.LineLoop(Gaitcal.geometry(corners), line));
      this.plates.add(plate);
    }
  }

  pose(trial, at) {
    const force = new THREE.Vector3();
    const up = new THREE.Vector3(0, 1, 0);
    this.arrows.forEach((a, foot) => {
      a.arrow.visible = trial.force(at, foot, force, a.arrow.position);
      a.newtons = a.arrow.visible ? force.length() : 0;
      if (!a.arrow.visible) return;
      const length = Math.max(0.02, a.newtons * this.METRES_PER_NEWTON);
      a.arrow.quaternion.setFromUnitVectors(up, force.normalize());
      const tip = Math.min(1, length / 0.12);
      a.shaft.scale.set(1, Math.max(0.001, length - 0.08 * tip), 1);
      a.head.scale.setScalar(tip);
      a.head.position.y = length;
    });
  }

  // Two points of every arrow, with its size in newtons and in body weights (N).
  targets(weight) {
    if (!this.group.visible) return [];
    return this.arrows.flatMap((a, foot) => {
      const size = `${Math.round(a.newtons)} N, ${(a.newtons / weight).toFixed(2)} body weights`;
      const text = `ground reaction on the ${["right", "left"][foot]} foot\n${size}`;
      const point = (share) => a.head.position.clone().multiplyScalar(share).applyMatrix4(a.arrow.matrix);
      return a.newtons > 0 ? [[point(1), text], [point(0.5), text]] : [];
    });
  }
};
