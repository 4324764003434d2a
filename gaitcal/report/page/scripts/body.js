// The segments as moving groups, and the body meshes that are fixed in them.
const { THREE } = MeshCat;

Gaitcal.COLOURS = {
  body: 0xd3c4b0, measured: 0x0072b2, model: 0xe69f00, error: 0xb00020, force: 0x009e73, plate: 0x56738c,
  nominal: 0x7d6608, fitted: 0x8a3ffc, bone: 0xe3d7bf, condyles: 0x1d2733,
};

// What is drawn after the body, in this order: a fresh depth buffer, the bones in it, what they veil, what is before them.
Gaitcal.ORDER = { fresh: 3, bones: 3.2, veiled: 3.4, marks: 4, clouds: 5 };

// As a style sheet writes it: "#0072b2".
Gaitcal.css = (colour) => `#${colour.toString(16).padStart(6, "0")}`;

Gaitcal.Body = class {
  constructor(scene, root) {
    this.segments = scene.segments;
    this.groups = scene.segments.map(() => new THREE.Group());
    for (const group of this.groups) root.add(group);
    this.meshes = [];
    // Drawn twice: first only into the depth buffer, so that one layer of the translucent body is seen, not three.
    const depth = new THREE.MeshBasicMaterial({ colorWrite: false, transparent: true });
    const skin = new THREE.MeshPhongMaterial({
      color: Gaitcal.COLOURS.body, transparent: true, opacity: 0.66, shininess: 12, specular: 0x222222,
    });
    this.skin = skin;
    this.veil = skin.clone();
    for (const { mesh, segment, order } of Gaitcal.meshes(scene.meshes, scene.body, this.groups, [[depth, 1], [skin, 2]])) {
      mesh.castShadow = order === 2;
      this.meshes.push({ mesh, segment, skin: order === 2 });
    }
  }

  pose(trial, at) {
    this.groups.forEach((group, s) => {
      trial.origin(at, s, group.position);
      trial.turn(at, s, group.quaternion);
      group.updateMatrix();
    });
  }

  // With bones inside, the body is a thin skin; away from the joint that is looked at (`beside`: its segments), a veil.
  show(on, trial, { bones, near, beside, layered }) {
    this.skin.opacity = bones ? 0.2 : 0.66;
    this.veil.opacity = bones ? 0.07 : 0.2;
    for (const { mesh, segment, skin } of this.meshes) {
      if (skin) mesh.material = beside && !beside.has(segment) ? this.veil : this.skin;
      mesh.visible = on && (skin || layered) && trial.tracked[segment] && Gaitcal.beside(this.segments[segment], near);
    }
  }
};

// A mesh in a group, drawn in an order; of none it is asked whether the camera sees it.
Gaitcal.mesh = (root, geometry, material, order = 0) => {
  const mesh = new THREE.Mesh(geometry, material);
  Object.assign(mesh, { renderOrder: order, frustumCulled: false });
  root.add(mesh);
  return mesh;
};

// The meshes of each segment as one, once for each pair of material and order of drawing: what moves together is drawn
// together.
Gaitcal.meshes = (packed, places, groups, layers) => {
  const merged = (parts) => {
    const [points, triangles] = [[], []];
    for (const { mesh, place } of parts) {
      const begin = points.length / 3;
      const there = new THREE.Matrix4().set(...place, 0, 0, 0, 1);
      const shape = Gaitcal.geometry(new Gaitcal.Lengths(packed[mesh].vertices).all()).applyMatrix4(there);
      for (const value of shape.attributes.position.array) points.push(value);
      const corners = new Uint16Array(Gaitcal.bytes(packed[mesh].triangles));
      // Of a mirror image the outside would be the inside.
      if (there.determinant() < 0) corners.reverse();
      for (const corner of corners) triangles.push(begin + corner);
    }
    const geometry = Gaitcal.geometry(new Float32Array(points), triangles);
    geometry.computeVertexNormals();
    return geometry;
  };
  return [...Gaitcal.grouped(places, ({ segment }) => segment)].flatMap(([segment, parts]) => {
    const geometry = merged(parts);
    return layers.map(([material, order]) => ({ mesh: Gaitcal.mesh(groups[segment], geometry, material, order), segment, order }));
  });
};

Gaitcal.geometry = (points, index = null) => {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
  if (index) geometry.setIndex(index);
  return geometry;
};

Gaitcal.FLOOR = 48;

// A texture of floor tiles half a metre wide, in two colours: lines that pass behind the camera are lost in software.
Gaitcal.tiles = (tile, seam) => {
  const canvas = html("canvas", { width: 256, height: 256 });
  const pen = canvas.getContext("2d");
  Object.assign(pen, { fillStyle: tile, strokeStyle: seam, lineWidth: 6 });
  pen.fillRect(0, 0, 256, 256);
  pen.strokeRect(0, 0, 256, 256);
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.repeat.set(2 * Gaitcal.FLOOR, 2 * Gaitcal.FLOOR);
  return Object.assign(texture, { anisotropy: 4 });
};

// Light from above with a shadow that goes along with the person, and a floor with lines every half metre.
Gaitcal.Floor = class {
  constructor(root) {
    root.add(new THREE.HemisphereLight(0xffffff, 0xb8b2a8, 0.72));
    this.sun = new THREE.DirectionalLight(0xffffff, 0.5);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    Object.assign(this.sun.shadow.camera, { left: -1.6, right: 1.6, top: 1.6, bottom: -1.6, near: 0.5, far: 8 });
    this.sun.shadow.bias = -0.0015;
    this.sun.shadow.radius = 3;
    root.add(this.sun, this.sun.target);
    const plane = (size, y, material) => {
      const mesh = Gaitcal.mesh(root, new THREE.PlaneGeometry(size, size).rotateX(-Math.PI / 2), material);
      mesh.position.y = y;
      return mesh;
    };
    this.floor = plane(Gaitcal.FLOOR, -0.004, new THREE.MeshBasicMaterial());
    this.shade = plane(6, -0.002, new THREE.ShadowMaterial({ opacity: 0.2, depthWrite: false }));
    this.shade.receiveShadow = true;
  }

  paint(tile, seam) {
    this.floor.material.map?.dispose();
    Object.assign(this.floor.material, { map: Gaitcal.tiles(tile, seam), needsUpdate: true });
  }

  follow(point) {
    this.sun.position.set(point.x + 0.8, 4.2, point.z + 1.3);
    this.sun.target.position.set(point.x, 0.6, point.z);
    this.floor.position.set(Math.round(point.x), this.floor.position.y, Math.round(point.z));
    this.shade.position.set(point.x, this.shade.position.y, point.z);
  }
};
