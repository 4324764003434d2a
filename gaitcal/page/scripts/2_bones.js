"use strict";
// The bones inside the body, which hide what lies behind them. Their outlines stand on landmarks that somebody palpated,
// not on the fitted axes; see gaitcal/page/bones/person_landmarks.py.
Gaitcal.Bones = class {
  constructor(scene, body) {
    const THREE = MeshCat.THREE;
    this.why = scene.bones.why;
    this.knees = scene.bones.knees ?? [];
    this.source = scene.bones.source ?? "";
    this.meshes = [];
    const bone = new THREE.MeshPhongMaterial({
      color: Gaitcal.COLOURS.bone, shininess: 8, specular: 0x1a1a1a, side: THREE.DoubleSide,
    });
    // Once more into the depth buffer, which the joints begin anew: so bones hide, or veil, the axes behind them.
    const depth = new THREE.MeshBasicMaterial({ colorWrite: false, transparent: true, side: THREE.DoubleSide });
    const shapes = {};
    for (const [name, packed] of Object.entries(scene.bones.meshes ?? {})) shapes[name] = Gaitcal.shape(packed);
    for (const placed of scene.bones.placed ?? []) {
      for (const [material, order] of [[bone, 0], [depth, Gaitcal.ORDER.bones]]) {
        const mesh = new THREE.Mesh(shapes[placed.mesh], material);
        mesh.matrixAutoUpdate = false;
        mesh.matrix.set(...placed.place, 0, 0, 0, 1);
        mesh.renderOrder = order;
        mesh.castShadow = order === 0;
        mesh.frustumCulled = false;
        body.groups[placed.segment].add(mesh);
        this.meshes.push({ mesh, segment: placed.segment });
      }
    }
  }

  show(on, trial) {
    for (const { mesh, segment } of this.meshes) mesh.visible = on && trial.tracked[segment];
  }

  // What is said of each knee, under the legend.
  write(host) {
    host.hidden = this.knees.length === 0;
    for (const knee of this.knees) {
      const title = document.createElement("h3");
      title.textContent = knee.title;
      host.append(title);
      for (const text of [...knee.axes, knee.stands]) {
        const line = document.createElement("p");
        line.textContent = text;
        host.append(line);
      }
    }
  }
};
