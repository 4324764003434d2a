"use strict";
// The camera starts on the person and goes along; pointing at a marker or joint tells its name.
Gaitcal.WIDE = 32;
Gaitcal.FLIGHT = 300; // ms
Gaitcal.NARROW = 10; // degrees: from near by a wide angle would show the near condyle much larger than the far one

Gaitcal.Camera = class {
  constructor(viewer, pane, height) {
    const THREE = MeshCat.THREE;
    this.viewer = viewer;
    this.pane = pane;
    this.height = height;
    this.tall = height; // of what is seen of the person
    this.last = new THREE.Vector3();
    viewer.set_camera(new THREE.PerspectiveCamera(Gaitcal.WIDE, 1, 0.05, 80));
    viewer.controls.maxDistance = 25;
    viewer.controls.minDistance = 0.15;
    this.resize();
    window.onload = null;
    // A canvas of another size is empty until it is drawn.
    const resized = new ResizeObserver(() => {
      this.resize();
      viewer.render();
    });
    resized.observe(pane);
  }

  resize() {
    this.viewer.set_3d_pane_size(this.pane.clientWidth, Math.max(1, this.pane.clientHeight));
  }

  // From a direction (in the laboratory: x forward, y up, z right) the whole person in the picture.
  look(person, direction, flying) {
    const THREE = MeshCat.THREE;
    const up = Math.tan((Math.PI / 180) * (Gaitcal.WIDE / 2));
    const room = Math.max(0.66 * this.tall, (0.36 * this.height) / this.viewer.camera.aspect);
    const target = new THREE.Vector3(person.x, 0.5 * this.tall, person.z);
    const from = new THREE.Vector3(...direction).normalize().multiplyScalar((1.02 * room) / up);
    this.last.copy(person);
    this.go({ target, position: target.clone().add(from), angle: Gaitcal.WIDE }, flying);
  }

  // A joint from near by; the direction is in its segment's axes: x forward, y up, z to the right.
  lookAt(joint, direction, flying) {
    const THREE = MeshCat.THREE;
    const room = 0.085 * this.height * Math.max(1, 1 / this.viewer.camera.aspect);
    const from = new THREE.Vector3(...direction).normalize().applyQuaternion(joint.turn);
    from.multiplyScalar(room / Math.tan((Math.PI / 180) * (Gaitcal.NARROW / 2)));
    this.last.copy(joint.place);
    this.go({ target: joint.place.clone(), position: joint.place.clone().add(from), angle: Gaitcal.NARROW }, flying);
  }

  go(goal, flying) {
    this.flight = null;
    if (!flying || window.matchMedia("(prefers-reduced-motion: reduce)").matches) {
      this.put(goal);
      return;
    }
    const { camera, controls } = this.viewer;
    const here = { target: controls.target.clone(), position: camera.position.clone(), angle: camera.fov };
    this.flight = { here, goal, begin: performance.now(), moved: new MeshCat.THREE.Vector3() };
    requestAnimationFrame(() => this.fly(this.flight));
  }

  fly(flight) {
    if (!flight || flight !== this.flight) return;
    const part = Math.min(1, (performance.now() - flight.begin) / Gaitcal.FLIGHT);
    const { here, goal, moved } = flight;
    const share = part * part * (3 - 2 * part);
    const mix = (from, to) => from.clone().lerp(to, share).add(moved);
    const angle = here.angle + (goal.angle - here.angle) * share;
    this.put({ target: mix(here.target, goal.target), position: mix(here.position, goal.position), angle });
    if (part === 1) this.flight = null;
    else requestAnimationFrame(() => this.fly(flight));
  }

  put({ target, position, angle }) {
    const { camera, controls } = this.viewer;
    camera.fov = angle;
    camera.updateProjectionMatrix();
    controls.target.copy(target);
    camera.position.copy(position);
    controls.update();
    this.viewer.set_dirty();
  }

  // On the floor with the person, in space with a joint.
  goAlong(person, on, inSpace) {
    if (on) {
      const step = person.clone().sub(this.last);
      if (!inSpace) step.setY(0);
      this.viewer.camera.position.add(step);
      this.viewer.controls.target.add(step);
      this.flight?.moved.add(step);
    }
    this.last.copy(person);
  }

  // The target ([place, text, joint]) nearest to a place in the pane, within `reach` pixels; null where there is none.
  pointed(x, y, targets, reach) {
    const [w, h] = [this.pane.clientWidth, this.pane.clientHeight];
    const at = new MeshCat.THREE.Vector3();
    let best = null;
    let least = reach;
    this.viewer.camera.updateMatrixWorld();
    for (const target of targets) {
      at.copy(target[0]).project(this.viewer.camera);
      if (at.z > 1) continue;
      const distance = Math.hypot(((at.x + 1) / 2) * w - x, ((1 - at.y) / 2) * h - y);
      if (distance < least) [best, least] = [target, distance];
    }
    return best;
  }
};

Gaitcal.Tip = class {
  // `targets()` lists what may be pointed at now; `chosen(joint)` is called after a click on a joint.
  constructor(element, camera, { targets, chosen }) {
    const { pane } = camera;
    const found = (event, reach, among) => {
      const box = pane.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left, event.clientY - box.top];
      return [camera.pointed(x, y, among, reach), x, y, box];
    };
    const show = (event, reach) => {
      const [target, x, y, box] = found(event, reach, targets());
      element.hidden = target === null || Boolean(event.buttons && event.pointerType === "mouse");
      pane.classList.toggle("joint", Boolean(target?.[2]));
      if (element.hidden) return;
      element.textContent = target[1];
      element.style.left = `${Math.max(4, Math.min(x + 14, box.width - element.offsetWidth - 4))}px`;
      element.style.top = `${Math.max(4, Math.min(y + 14, box.height - element.offsetHeight - 4))}px`;
    };
    let down = null;
    pane.addEventListener("pointermove", (event) => event.pointerType === "mouse" && show(event, 14));
    pane.addEventListener("pointerdown", (event) => {
      down = [event.clientX, event.clientY];
      if (event.pointerType !== "mouse") show(event, 26);
    });
    // The controls of MeshCat keep the pointer: its release is told to the window.
    window.addEventListener("pointerup", (event) => {
      const still = down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 5;
      down = null;
      if (!still || event.button > 0) return;
      const [target] = found(event, event.pointerType === "mouse" ? 18 : 28, targets().filter(([, , joint]) => joint));
      if (target) chosen(target[2]);
    });
    pane.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") element.hidden = true;
    });
  }
};
