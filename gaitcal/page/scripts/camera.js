"use strict";
// The camera starts on the person and goes along; pointing at a marker or joint tells its name.
Gaitcal.WIDE = 32;
Gaitcal.NARROW = 10; // degrees: from near by a wide angle would show the near condyle much larger than the far one

Gaitcal.Camera = class {
  constructor(viewer, pane, height) {
    const THREE = MeshCat.THREE;
    this.viewer = viewer;
    this.pane = pane;
    this.height = height;
    this.last = new THREE.Vector3();
    viewer.set_camera(new THREE.PerspectiveCamera(Gaitcal.WIDE, 1, 0.05, 80));
    viewer.controls.maxDistance = 25;
    viewer.controls.minDistance = 0.15;
    this.resize();
    window.onload = null;
    window.addEventListener("resize", () => this.resize());
    new ResizeObserver(() => this.resize()).observe(pane);
  }

  resize() {
    this.viewer.set_3d_pane_size(this.pane.clientWidth, Math.max(1, this.pane.clientHeight));
  }

  angle(degrees) {
    this.viewer.camera.fov = degrees;
    this.viewer.camera.updateProjectionMatrix();
  }

  // From a direction (in the laboratory: x forward, y up, z right) the whole person in the picture.
  look(person, x, y, z) {
    const THREE = MeshCat.THREE;
    const { camera, controls } = this.viewer;
    this.angle(Gaitcal.WIDE);
    const up = Math.tan((Math.PI / 180) * (camera.fov / 2));
    const room = Math.max(0.66 * this.height, (0.36 * this.height) / camera.aspect);
    const target = new THREE.Vector3(person.x, 0.5 * this.height, person.z);
    const from = new THREE.Vector3(x, y, z).normalize().multiplyScalar((1.02 * room) / up);
    controls.target.copy(target);
    camera.position.copy(target).add(from);
    controls.update();
    this.last.copy(person);
    this.viewer.set_dirty();
  }

  // A joint from near by; the direction is in its segment's axes: x forward, y up, z to the right.
  lookAt(joint, x, y, z) {
    const THREE = MeshCat.THREE;
    const { camera, controls } = this.viewer;
    this.angle(Gaitcal.NARROW);
    const room = 0.085 * this.height * Math.max(1, 1 / camera.aspect);
    const from = new THREE.Vector3(x, y, z).normalize().applyQuaternion(joint.turn);
    from.multiplyScalar(room / Math.tan((Math.PI / 180) * (camera.fov / 2)));
    controls.target.copy(joint.place);
    camera.position.copy(joint.place).add(from);
    controls.update();
    this.last.copy(joint.place);
    this.viewer.set_dirty();
  }

  // On the floor with the person, in space with a joint.
  goAlong(person, on, inSpace) {
    if (on) {
      const step = person.clone().sub(this.last);
      if (!inSpace) step.setY(0);
      this.viewer.camera.position.add(step);
      this.viewer.controls.target.add(step);
    }
    this.last.copy(person);
  }

  // The text of the target nearest to a place in the pane, within `reach` pixels; null where there is none.
  pointed(x, y, targets, reach) {
    const THREE = MeshCat.THREE;
    const [w, h] = [this.pane.clientWidth, this.pane.clientHeight];
    const at = new THREE.Vector3();
    let best = null;
    let least = reach;
    this.viewer.camera.updateMatrixWorld();
    for (const [place, text] of targets) {
      at.copy(place).project(this.viewer.camera);
      if (at.z > 1) continue;
      const distance = Math.hypot(((at.x + 1) / 2) * w - x, ((1 - at.y) / 2) * h - y);
      if (distance < least) [best, least] = [text, distance];
    }
    return best;
  }
};

Gaitcal.Tip = class {
  // targets() lists what may be pointed at now.
  constructor(element, camera, targets) {
    const pane = camera.pane;
    const show = (event, reach) => {
      const box = pane.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left, event.clientY - box.top];
      const text = event.buttons && event.pointerType === "mouse" ? null : camera.pointed(x, y, targets(), reach);
      element.hidden = text === null;
      if (text === null) return;
      element.textContent = text;
      element.style.left = `${Math.max(4, Math.min(x + 14, box.width - element.offsetWidth - 4))}px`;
      element.style.top = `${Math.max(4, Math.min(y + 14, box.height - element.offsetHeight - 4))}px`;
    };
    pane.addEventListener("pointermove", (event) => event.pointerType === "mouse" && show(event, 14));
    pane.addEventListener("pointerdown", (event) => event.pointerType !== "mouse" && show(event, 26));
    pane.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") element.hidden = true;
    });
  }
};
