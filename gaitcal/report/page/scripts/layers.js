// The legend, which is also where each part is shown or hidden.
Gaitcal.legend = (host, page) => {
  const { state } = page;
  const { get } = Gaitcal;
  let figure = null;
  for (const [name, colour] of Object.entries(Gaitcal.COLOURS)) {
    document.documentElement.style.setProperty(`--layer-${name}`, Gaitcal.css(colour));
  }
  const rows = [...host.querySelectorAll("label")].map((label) => {
    const small = label.querySelector("small");
    return { label, small, name: label.control.dataset.layer, about: small.textContent };
  });
  // How often as long as they are the errors of markers are drawn: most are shorter than a marker is wide.
  const times = () => (page.result.sheet && state.preset === "fit" ? 5 : 1);
  const write = () => {
    for (const { name, about, label, small } of rows) {
      const why = figure.lack(name);
      label.control.checked = state.layers.has(name);
      label.control.disabled = why !== null;
      label.classList.toggle("absent", why !== null);
      const long = name === "errors" && times() > 1 ? `${about}, drawn ${times()} times as long` : about;
      small.textContent = why ?? long;
    }
  };
  // Of another trial: which layers are empty in it, and what else is to be known of its picture.
  const open = (shown) => {
    figure = shown;
    const { scene, trial, bones } = figure;
    write();
    get("bones").textContent = bones.source ? `Bones: ${bones.source}.` : "";
    const untracked = scene.segments.filter((_, s) => !trial.tracked[s]).join(", ").replaceAll("_", " ");
    const sentences = (...words) => words.filter(Boolean).join(" ");
    get("missing").textContent = sentences(
      untracked && `Hidden, no marker in this trial: ${untracked}.`,
      scene.capsules.length > 0 && "Plain shapes stand for body meshes that were not installed.",
    );
    get("scale").textContent = sentences(
      "Floor lines every 0.5 m.",
      trial.hasForces && "Arrows: 1 m is 1000 N.",
      page.sheet?.events.length && "On the timeline: a bar is stance, a tick a foot strike, a ring a toe-off.",
      trial.hasForces && "Line below a leg's row: its torques are valid.",
    );
  };
  host.addEventListener("change", ({ target: { dataset, checked } }) => {
    const layers = new Set(state.layers);
    if (checked) layers.add(dataset.layer);
    else layers.delete(dataset.layer);
    state.set({ layers });
  });
  state.on(["layers", "preset"], write);
  return { open, times };
};
