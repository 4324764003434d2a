// Play, trials and legend: the controls that are always there. `legend(open)` opens and closes the layers.
Gaitcal.controls = (page) => {
  const { state } = page;
  const { get } = Gaitcal;
  const legend = (open) => {
    get("main").classList.toggle("open", open);
    get("open").setAttribute("aria-expanded", String(open));
  };
  const playing = () => {
    get("play").textContent = state.playing ? "\u275a\u275a" : "\u25b6";
    get("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  };
  get("trial").append(...page.trials.map(({ name }, i) => new Option(name, i)));
  get("play").addEventListener("click", () => page.clock.play());
  get("open").addEventListener("click", () => legend(!get("main").classList.contains("open")));
  state.on(["playing"], playing);
  playing();

  // The body fills what header and footer leave of the window; how high these are follows from what is in them, and the
  // header leaves when the page is scrolled.
  let there = true;
  const measure = () => {
    const { style } = document.documentElement;
    style.setProperty("--above", `${there ? get("top").offsetHeight : 0}px`);
    style.setProperty("--below", `${get("controls").offsetHeight}px`);
  };
  const heights = new ResizeObserver(measure);
  for (const id of ["top", "controls"]) heights.observe(get(id));
  const scrolled = ([entry]) => {
    there = entry.isIntersecting;
    measure();
  };
  new IntersectionObserver(scrolled).observe(get("top"));
  return { legend };
};

// The presets as tabs.
Gaitcal.presets = (host, { state }) => {
  const names = Object.keys(Gaitcal.PRESETS);
  const tabs = [...host.children];
  // Arrow keys go from tab to tab, and around.
  const moved = (event) => {
    const here = tabs.indexOf(event.target);
    const there = { ArrowRight: here + 1, ArrowLeft: here - 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (there === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    const tab = tabs.at(there % tabs.length);
    tab.focus();
    tab.click();
  };
  const write = () => {
    const { preset } = state;
    for (const [k, tab] of tabs.entries()) {
      tab.setAttribute("aria-selected", String(names[k] === preset));
      tab.tabIndex = names[k] === preset ? 0 : -1;
    }
    Gaitcal.get("panel").setAttribute("aria-labelledby", `preset-${preset}`);
    Gaitcal.get("main").dataset.preset = preset;
    for (const id of ["switches", "curves"]) Gaitcal.get(id).hidden = preset !== "clinician";
  };
  for (const [k, tab] of tabs.entries()) tab.addEventListener("click", () => state.set({ preset: names[k] }));
  host.addEventListener("keydown", moved);
  state.on(["preset"], write);
  write();
};
