// Joint centres and axes, nominal and fitted, with what is known of their uncertainty. They are fixed in the segments
// and drawn after everything else on a fresh depth buffer, so that they are seen inside the body.
Gaitcal.Joints = class {
  constructor(scene, body, root) {
    const half = 0.056 * scene.height;
    const CONFIDENCE = 1.96;
    Object.assign(this, { body, marks: scene.joints, parts: { nominal: [], fitted: [], uncertainty: [] } });
    const vector = (values) => new THREE.Vector3().fromArray(values);
    const solid = (color) => new THREE.MeshPhongMaterial({ color, transparent: true, shininess: 20, specular: 0x222222 });
    const both = (colour) => [solid(colour), Object.assign(solid(colour), Gaitcal.VEIL)];
    const cloud = new THREE.MeshBasicMaterial({
      color: Gaitcal.COLOURS.fitted, transparent: true, opacity: 0.28, depthWrite: false, side: THREE.DoubleSide,
    });
    const ball = new THREE.SphereGeometry(1, 24, 16);
    const cube = new THREE.BoxGeometry(1.7, 1.7, 1.7);
    const rod = new THREE.CylinderGeometry(1, 1, 1, 12);
    // Told apart without colour: the fitted joint is round and solid, the nominal one square, thin and dashed.
    const STYLE = {
      fitted: { head: ball, centre: 0.0085, ends: 0.0075, thick: 0.0034, dashes: 1, dash: 1, materials: both(Gaitcal.COLOURS.fitted) },
      nominal: { head: cube, centre: 0.006, ends: 0.0055, thick: 0.0017, dashes: 9, dash: 0.6, materials: both(Gaitcal.COLOURS.nominal) },
    };
    const nothing = Gaitcal.geometry(new Float32Array(9));
    const fresh = Gaitcal.mesh(root, nothing, new THREE.MeshBasicMaterial({ transparent: true }), Gaitcal.ORDER.fresh);
    fresh.onBeforeRender = (renderer) => renderer.clearDepth();

    const keep = (kind, { segment, joint, parent }, mesh) => this.parts[kind].push({ mesh, segment, joint, parent });
    // One part of a mark, stretched by `scale` and turned from y to a direction.
    const part = (kind, mark, geometry, place, direction, scale) => {
      for (const mesh of Gaitcal.veiled(body.groups[mark.segment], geometry, STYLE[kind].materials)) {
        mesh.position.copy(place);
        if (direction) mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), direction);
        mesh.scale.set(...scale);
        keep(kind, mark, mesh);
      }
    };
    const centre = (kind, mark, place) =>
      part(kind, mark, STYLE[kind].head, vector(place), null, Array(3).fill(STYLE[kind].centre));
    const axis = (kind, mark, place, along) => {
      const { head, ends, thick, dashes, dash } = STYLE[kind];
      const direction = vector(along);
      const at = (s) => vector(place).addScaledVector(direction, s);
      for (const end of [-half, half]) part(kind, mark, head, at(end), direction, Array(3).fill(ends));
      for (let k = 0; k < dashes; k++) {
        const length = ((2 * half) / dashes) * dash;
        part(kind, mark, rod, at(half * ((2 * k + 1) / dashes - 1)), direction, [thick, length, thick]);
      }
    };
    const uncertain = (mark, geometry) => {
      const mesh = Gaitcal.mesh(body.groups[mark.segment], geometry, cloud, Gaitcal.ORDER.clouds);
      keep("uncertainty", mark, mesh);
      return mesh;
    };

    const fitted = new Set(this.marks.filter((mark) => mark.fitted).map((mark) => mark.joint));
    const [above, done] = [new Set(), new Set()];
    for (const mark of this.marks) {
      mark.parent = !above.has(mark.joint);
      mark.place = new THREE.Vector3();
      above.add(mark.joint);
      centre("nominal", mark, mark.nominalCentre);
      if (mark.nominalAxis) axis("nominal", mark, mark.nominalCentre, mark.nominalAxis);
      if (!fitted.has(mark.joint)) continue;
      // Both segments see the fitted joint in one place; a second axis (the shoulder's) is drawn as well.
      const first = !done.has(mark.joint);
      done.add(mark.joint);
      if (first) centre("fitted", mark, mark.fittedCentre);
      if (mark.fittedAxis && (first || mark.joint.startsWith("shoulder"))) {
        axis("fitted", mark, mark.fittedCentre, mark.fittedAxis);
      }
      if (mark.centreSpread) {
        const mesh = uncertain(mark, ball);
        const [c, s] = [mark.fittedCentre, mark.centreSpread.map((x) => CONFIDENCE * x)];
        mesh.matrixAutoUpdate = false;
        mesh.matrix.set(s[0], s[1], s[2], c[0], s[3], s[4], s[5], c[1], s[6], s[7], s[8], c[2], 0, 0, 0, 1);
      }
      if (mark.axisSpread && mark.fittedAxis) uncertain(mark, Gaitcal.cones(mark, 1.25 * half, CONFIDENCE));
    }
  }

  // `near`: the one joint that is looked at, as its upper segment has it; null: all, in both their segments.
  show(kind, on, trial, near) {
    for (const { mesh, segment, joint, parent } of this.parts[kind]) {
      const here = near === null || (near === Gaitcal.jointNamed(joint) && parent);
      mesh.visible = on && trial.tracked[segment] && here;
    }
  }

  of(joint) { return this.marks.filter((mark) => Gaitcal.jointNamed(mark.joint) === joint); }

  // The segments that meet in a joint; null of none.
  segments(joint) {
    const marks = this.of(joint);
    return marks.length ? new Set(marks.map(({ segment }) => segment)) : null;
  }

  // The joint's centre in the laboratory and the axes of its segment, now; null where it has no mark.
  pose(joint) {
    const [mark] = this.of(joint);
    return mark ? { place: this.placed(mark).clone(), turn: this.body.groups[mark.segment].quaternion } : null;
  }

  placed({ place, fittedCentre, segment }) {
    return place.fromArray(fittedCentre).applyMatrix4(this.body.groups[segment].matrix);
  }

  // Joints may be pointed at and chosen even where they are not drawn.
  targets(trial, on) {
    const target = (mark) => [
      this.placed(mark),
      `${on ? mark.text : mark.title}\nclick: come near`,
      Gaitcal.jointNamed(mark.joint),
    ];
    return this.marks.filter(({ segment }) => trial.tracked[segment]).map(target);
  }
};

// Two cones from the joint centre that the axis stays within: half angles = confidence times standard errors.
Gaitcal.cones = (mark, length, confidence) => {
  const s = mark.axisSpread;
  const columns = [0, 1, 2].map((k) => new THREE.Vector3(s[k], s[3 + k], s[6 + k]));
  columns.sort((a, b) => b.length() - a.length());
  const [u, v] = columns.map((c) => c.multiplyScalar(confidence));
  const centre = new THREE.Vector3().fromArray(mark.fittedCentre);
  const axis = new THREE.Vector3().fromArray(mark.fittedAxis);
  const AROUND = 32;
  const points = [centre.toArray()];
  const triangles = [];
  for (const end of [1, -1]) {
    const first = points.length;
    for (let k = 0; k < AROUND; k++) {
      const angle = (2 * Math.PI * k) / AROUND;
      const tip = axis.clone().addScaledVector(u, Math.cos(angle)).addScaledVector(v, Math.sin(angle));
      points.push(centre.clone().addScaledVector(tip, end * length).toArray());
      triangles.push(0, first + k, first + ((k + 1) % AROUND));
    }
  }
  return Gaitcal.geometry(new Float32Array(points.flat()), triangles);
};
