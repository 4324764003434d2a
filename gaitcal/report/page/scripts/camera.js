// The camera starts on the person and goes along; pointing at a marker or joint tells its name.
Gaitcal.WIDE = 32;
Gaitcal.NARROW = 10; // degrees: from near by a wide angle would show the near condyle much larger than the far one

Gaitcal.Camera = class {
  constructor(viewer, pane, height) {
    Object.assign(this, { viewer, pane, height, tall: height, last: new THREE.Vector3() }); // tall: what is seen of the person
    viewer.set_camera(new THREE.PerspectiveCamera(Gaitcal.WIDE, 1, 0.05, 80));
    viewer.controls.maxDistance = 25;
    viewer.controls.minDistance = 0.15;
    window.onload = null;
    this.resize();
    // A canvas of another size is empty until it is drawn.
    new ResizeObserver(() => {
      this.resize();
      viewer.render();
    }).observe(pane);
  }

  resize() { this.viewer.set_3d_pane_size(this.pane.clientWidth, Math.max(1, this.pane.clientHeight)); }

  // From a direction (in the laboratory: x forward, y up, z right) the whole person in the picture.
  look(person, direction) {
    const room = 1.02 * Math.max(0.66 * this.tall, (0.36 * this.height) / this.viewer.camera.aspect);
    this.last.copy(person);
    const target = new THREE.Vector3(person.x, 0.5 * this.tall, person.z);
    this.from(target, new THREE.Vector3(...direction), room, Gaitcal.WIDE);
  }

  // A joint from near by; the direction is in its segment's axes: x forward, y up, z to the right.
  lookAt({ place, turn }, direction) {
    const room = 0.085 * this.height * Math.max(1, 1 / this.viewer.camera.aspect);
    this.last.copy(place);
    this.from(place.clone(), new THREE.Vector3(...direction).applyQuaternion(turn), room, Gaitcal.NARROW);
  }

  // So far away in a direction that `room` m are seen on each side of the target.
  from(target, direction, room, angle) {
    const away = direction.normalize().multiplyScalar(room / Math.tan((Math.PI / 180) * (angle / 2)));
    const { camera, controls } = this.viewer;
    camera.fov = angle;
    camera.updateProjectionMatrix();
    controls.target.copy(target);
    camera.position.copy(target).add(away);
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
    }
    this.last.copy(person);
  }

  // The target ([place, text, joint]) nearest to a place in the pane, within `reach` pixels; null where there is none.
  pointed(x, y, targets, reach) {
    const [w, h] = [this.pane.clientWidth, this.pane.clientHeight];
    const at = new THREE.Vector3();
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

// What is pointed at. `targets()` lists what may be pointed at now; `chosen(joint)` is called after a click on a joint.
Gaitcal.tip = (element, camera, { targets, chosen }) => {
  const { pane } = camera;
  const at = ({ clientX, clientY }) => {
    const { left, top } = pane.getBoundingClientRect();
    return [clientX - left, clientY - top];
  };
  const show = (event, reach) => {
    const [x, y] = at(event);
    const target = camera.pointed(x, y, targets(), reach);
    element.hidden = target === null || Boolean(event.buttons && event.pointerType === "mouse");
    pane.classList.toggle("joint", Boolean(target?.[2]));
    if (element.hidden) return;
    element.textContent = target[1];
    const inside = (place, size, own) => `${Math.max(4, Math.min(place + 14, size - own - 4))}px`;
    element.style.left = inside(x, pane.clientWidth, element.offsetWidth);
    element.style.top = inside(y, pane.clientHeight, element.offsetHeight);
  };
  let down = null;
  const mouse = ({ pointerType }) => pointerType === "mouse";
  Gaitcal.dress(pane, {
    pointermove: (event) => mouse(event) && show(event, 14),
    pointerdown: (event) => {
      down = at(event);
      if (!mouse(event)) show(event, 26);
    },
    pointerleave: (event) => { if (mouse(event)) element.hidden = true; },
  });
  // The controls of MeshCat keep the pointer: its release is told to the window.
  window.addEventListener("pointerup", (event) => {
    const [x, y] = at(event);
    const still = down && Math.hypot(x - down[0], y - down[1]) < Gaitcal.DRAGGED;
    down = null;
    if (!still || event.button > 0) return;
    const target = camera.pointed(x, y, targets().filter(([, , joint]) => joint), mouse(event) ? 18 : 28);
    if (target) chosen(target[2]);
  });
};
