// The body in motion: figure, layers and camera, as the state has them.
Gaitcal.Stage = class {
  constructor(page) {
    const { get } = Gaitcal;
    this.page = page;
    this.state = page.state;
    const software = Gaitcal.software();
    const renderer = new THREE.WebGLRenderer({ antialias: !software, alpha: true });
    Object.assign(renderer.shadowMap, { enabled: true, type: THREE.PCFSoftShadowMap });
    get("pane").append(renderer.domElement);
    this.viewer = new MeshCat.Viewer(get("pane"), true, renderer);
    this.viewer.gui.domElement.remove();
    for (const path of [["Grid"], ["Axes"], ["Lights"]]) this.viewer.set_property(path, "visible", false);
    this.viewer.scene.fog = new THREE.Fog(0xffffff, 7, 20);
    renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    // MeshCat's scene has z up; everything below has y up, as the recordings.
    const root = new THREE.Group();
    root.rotation.x = Math.PI / 2;
    this.viewer.set_object(["gaitcal"], root);
    this.upright = new THREE.Group();
    root.add(this.upright);
    this.floor = new Gaitcal.Floor(this.upright);
    this.figure = new Gaitcal.Figure(page.result, this.upright);
    this.camera = new Gaitcal.Camera(this.viewer, get("pane"), page.result.scene.height);
    this.legend = Gaitcal.legend(get("toggles"), page);
    Gaitcal.tip(get("tip"), this.camera, {
      targets: () => this.figure.targets((layer) => this.on(layer)),
      chosen: (joint) => this.state.set({ joint }),
    });
    this.eased = false;
    if (software) this.ease();
    this.painted();
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.painted());
    get("views").addEventListener("click", ({ target: { dataset } }) => {
      if (dataset.from) this.look(...dataset.from.split(" ").map(Number));
    });
    get("near").addEventListener("click", ({ target: { dataset } }) => {
      if (dataset.joint !== undefined) this.state.set({ joint: dataset.joint || null });
    });
    get("follow").addEventListener("change", () => this.refresh());
    this.open();
    this.state.on(["trial", "joint", "layers", "preset", "seconds"], (changed) => this.changed(changed));
  }

  changed(changed) {
    const any = (...fields) => fields.some((field) => changed.has(field));
    if (any("trial")) this.open();
    else if (any("layers", "joint", "preset")) this.refresh();
    else this.pose();
    if (changed.has("joint")) this.look(...this.front());
  }

  // Colours of the page's scheme.
  painted() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => new THREE.Color(style.getPropertyValue(name).trim());
    const ground = colour("--ground");
    for (const end of ["top_color", "bottom_color"]) this.viewer.set_property(["Background"], end, ground.toArray());
    this.viewer.scene.fog.color.copy(ground);
    this.floor.paint(style.getPropertyValue("--tile").trim(), style.getPropertyValue("--seam").trim());
    this.viewer.set_dirty();
  }

  // The trial of the state, from where the camera first sees the person.
  open() {
    this.figure.open(this.page.trial);
    this.camera.tall = this.figure.tall;
    this.legend.open(this.figure);
    this.refresh();
    this.look(...this.front());
  }

  // What is looked at from near by: null where the chosen joint has no mark here.
  get near() {
    const { joint } = this.state;
    return joint !== null && this.figure.joints.of(joint).length ? joint : null;
  }

  front() { return this.near ? [1, 0.06, 0] : [0.75, 0.3, 0.85]; }

  on(layer) { return this.state.layers.has(layer) && this.figure.lack(layer) === null; }

  // The whole person, or the joint that is looked at, from a direction.
  look(x, y, z) {
    const joint = this.near && this.figure.joints.pose(this.near);
    if (joint) this.camera.lookAt(joint, [x, y, this.near.endsWith("_l") ? -z : z]);
    else this.camera.look(this.figure.place, [x, y, z]);
  }

  refresh() {
    const { near } = this;
    this.figure.show((layer) => this.on(layer), near, !this.eased);
    const words = this.on("bones") ? this.figure.bones.words(near) : null;
    Gaitcal.get("about").textContent = words ?? this.page.trial.about;
    Gaitcal.get("heading").classList.toggle("near", words !== null);
    this.pose();
  }

  pose() {
    const { figure, near } = this;
    figure.pose(this.state.seconds, near, this.legend.times());
    this.floor.follow(figure.place);
    const joint = near && figure.joints.pose(near);
    this.camera.goAlong(joint ? joint.place : figure.place, Gaitcal.get("follow").checked, Boolean(joint));
    this.viewer.set_dirty();
  }

  // Without a graphics card shadows and fine pixels go: of a frame in software rendering the
  // shadows are more than half.
  ease() {
    this.eased = true;
    this.floor.sun.castShadow = this.floor.shade.visible = false;
    this.viewer.renderer.setPixelRatio(0.7);
    this.camera.resize();
  }
};

// Whether the processor draws, not a graphics card.
Gaitcal.software = () => {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) throw new Error("no context");
  const about = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(about?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
};
