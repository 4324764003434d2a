"use strict";
// Joint centres and axes, nominal and fitted, with what is known of their uncertainty. They are fixed in the segments
// and drawn after everything else on a fresh depth buffer, so that they are seen inside the body.
Gaitcal.Joints = class {
  constructor(scene, body, root) {
    const THREE = MeshCat.THREE;
    const colours = Gaitcal.COLOURS;
    const half = 0.056 * scene.height;
    const CONFIDENCE = 1.96;
    const { ORDER } = Gaitcal;
    this.marks = [];
    this.parts = { nominal: [], fitted: [], uncertainty: [] };
    const solid = (colour, more) =>
      new THREE.MeshPhongMaterial({ color: colour, transparent: true, shininess: 20, specular: 0x222222, ...more });
    const materials = {};
    for (const kind of ["nominal", "fitted"]) materials[kind] = [solid(colours[kind], {}), solid(colours[kind], Gaitcal.VEIL)];
    const cloud = new THREE.MeshBasicMaterial({
      color: colours.fitted, transparent: true, opacity: 0.28, depthWrite: false, side: THREE.DoubleSide,
    });
    const ball = new THREE.SphereGeometry(1, 24, 16);
    const cube = new THREE.BoxGeometry(1.7, 1.7, 1.7);
    const rod = new THREE.CylinderGeometry(1, 1, 1, 12);
    const fresh = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshBasicMaterial({ transparent: true }));
    fresh.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(9), 3));
    fresh.renderOrder = ORDER.fresh;
    fresh.frustumCulled = false;
    fresh.onBeforeRender = (renderer) => renderer.clearDepth();
    root.add(fresh);

    const add = (kind, mark, mesh, order) => {
      mesh.renderOrder = order;
      mesh.frustumCulled = false;
      body.groups[mark.segment].add(mesh);
      this.parts[kind].push({ mesh, segment: mark.segment, joint: mark.joint, parent: mark.parent });
    };
    // One part of a mark, stretched by `scale` and turned from y to a direction.
    const part = (kind, mark, geometry, place, direction, scale) => {
      for (const [material, order] of [[materials[kind][0], ORDER.marks], [materials[kind][1], ORDER.veiled]]) {
        const mesh = new THREE.Mesh(geometry, material);
        mesh.position.copy(place);
        if (direction) mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), direction);
        mesh.scale.set(...scale);
        add(kind, mark, mesh, order);
      }
    };
    // Told apart without colour: the fitted joint is round and solid, the nominal one square, thin and dashed.
    const STYLE = {
      fitted: { head: ball, centre: 0.0085, ends: 0.0075, thick: 0.0034, dashes: 1, dash: 1 },
      nominal: { head: cube, centre: 0.006, ends: 0.0055, thick: 0.0017, dashes: 9, dash: 0.6 },
    };
    const centre = (kind, mark, place) =>
      part(kind, mark, STYLE[kind].head, new THREE.Vector3().fromArray(place), null, Array(3).fill(STYLE[kind].centre));
    const axis = (kind, mark, place, along) => {
      const { head, ends, thick, dashes, dash } = STYLE[kind];
      const [middle, direction] = [place, along].map((v) => new THREE.Vector3().fromArray(v));
      const at = (s) => middle.clone().addScaledVector(direction, s);
      for (const end of [-half, half]) part(kind, mark, head, at(end), direction, Array(3).fill(ends));
      for (let k = 0; k < dashes; k++) {
        const place = at(half * ((2 * k + 1) / dashes - 1));
        part(kind, mark, rod, place, direction, [thick, ((2 * half) / dashes) * dash, thick]);
      }
    };

    const fitted = new Set(scene.joints.filter((mark) => mark.fitted).map((mark) => mark.joint));
    const done = new Set();
    const seen = new Set();
    for (const mark of scene.joints) {
      this.marks.push(mark);
      mark.parent = !seen.has(mark.joint);
      seen.add(mark.joint);
      centre("nominal", mark, mark.nominalCentre);
      if (mark.nominalAxis) axis("nominal", mark, mark.nominalCentre, mark.nominalAxis);
      if (!fitted.has(mark.joint)) continue;
      // Both segments see the fitted joint in one place; a second axis (the shoulder's) is drawn as well.
      if (!done.has(mark.joint)) centre("fitted", mark, mark.fittedCentre);
      if (mark.fittedAxis && (!done.has(mark.joint) || mark.joint.startsWith("shoulder"))) {
        axis("fitted", mark, mark.fittedCentre, mark.fittedAxis);
      }
      done.add(mark.joint);
      if (mark.centreSpread) {
        const mesh = new THREE.Mesh(ball, cloud);
        mesh.matrixAutoUpdate = false;
        const s = mark.centreSpread.map((x) => CONFIDENCE * x);
        const c = mark.fittedCentre;
        mesh.matrix.set(s[0], s[1], s[2], c[0], s[3], s[4], s[5], c[1], s[6], s[7], s[8], c[2], 0, 0, 0, 1);
        add("uncertainty", mark, mesh, ORDER.clouds);
      }
      if (mark.axisSpread && mark.fittedAxis) {
        add("uncertainty", mark, new THREE.Mesh(Gaitcal.cones(mark, 1.25 * half, CONFIDENCE), cloud), ORDER.clouds);
      }
    }
    this.places = this.marks.map(() => new THREE.Vector3());
    this.body = body;
  }

  get known() {
    return this.parts.uncertainty.length > 0;
  }

  // `near`: the one joint that is looked at, as its upper segment has it; null: all, in both their segments.
  show(kind, on, trial, near) {
    for (const { mesh, segment, joint, parent } of this.parts[kind]) {
      const here = near === null || (near === Gaitcal.jointNamed(joint) && parent);
      mesh.visible = on && trial.tracked[segment] && here;
    }
  }

  has(joint) {
    return this.marks.some((one) => Gaitcal.jointNamed(one.joint) === joint);
  }

  // The segments that meet in a joint; null of none.
  segments(joint) {
    const marks = this.marks.filter((one) => Gaitcal.jointNamed(one.joint) === joint);
    return marks.length ? new Set(marks.map(({ segment }) => segment)) : null;
  }

  // The joint's centre in the laboratory and the axes of its segment, now; null where it has no mark.
  pose(joint) {
    const mark = this.marks.find((one) => Gaitcal.jointNamed(one.joint) === joint);
    if (!mark) return null;
    const group = this.body.groups[mark.segment];
    const place = new MeshCat.THREE.Vector3().fromArray(mark.fittedCentre).applyMatrix4(group.matrix);
    return { place, turn: group.quaternion };
  }

  // Joints may be pointed at and chosen even where they are not drawn.
  targets(trial, on) {
    const near = (mark) => {
      const group = this.body.groups[mark.segment];
      const place = this.places[this.marks.indexOf(mark)].fromArray(mark.fittedCentre).applyMatrix4(group.matrix);
      const text = on ? Gaitcal.jointText(mark) : Gaitcal.jointTitle(mark);
      return [place, `${text}\nclick: come near`, Gaitcal.jointNamed(mark.joint)];
    };
    return this.marks.filter(({ segment }) => trial.tracked[segment]).map(near);
  }
};

Gaitcal.jointTitle = (mark) => {
  const [name, side] = mark.joint.split("_");
  return side in Gaitcal.LEGS ? `${Gaitcal.LEGS[side]} ${name} joint` : `${name} joint`;
};

Gaitcal.jointText = (mark) => {
  const title = Gaitcal.jointTitle(mark);
  if (!mark.fitted) return `${title}\nnot fitted: nominal`;
  const norm = (v) => Math.hypot(...v);
  const moved = norm(mark.fittedCentre.map((x, k) => x - mark.nominalCentre[k]));
  let text = `${title}\ncentre moved ${(1000 * moved).toFixed(1)} mm`;
  if (mark.nominalAxis && mark.fittedAxis) {
    const cosine = mark.fittedAxis.reduce((sum, x, k) => sum + x * mark.nominalAxis[k], 0);
    text += `, axis turned ${((180 / Math.PI) * Math.acos(Math.min(1, cosine))).toFixed(1)}\u00b0`;
  }
  if (mark.centreSpread) text += `\nstandard error of the centre ${(1000 * norm(mark.centreSpread)).toFixed(1)} mm`;
  return text;
};

// Two cones from the joint centre that the axis stays within: half angles = confidence times standard errors.
Gaitcal.cones = (mark, length, confidence) => {
  const THREE = MeshCat.THREE;
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
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points.flat()), 3));
  geometry.setIndex(triangles);
  return geometry;
};
