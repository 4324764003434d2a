// The keyboard, and the dialog that tells its keys.
Gaitcal.keys = (page) => {
  const { state, clock, timeline, controls } = page;
  const dialog = Gaitcal.get("keys");
  const single = Gaitcal.get("keys-on"); // who speaks to the computer may not want keys of one letter

  const step = (frames) => ({ shiftKey }) => clock.step(frames * (shiftKey ? 10 : 1));
  const end = (k) => () => state.set({ seconds: (state.window ?? [0, page.trial.duration])[k] });
  const faster = (by) => () => {
    const here = Gaitcal.SPEEDS.indexOf(state.speed) + by;
    state.set({ speed: Gaitcal.SPEEDS[Math.min(Gaitcal.SPEEDS.length - 1, Math.max(0, here))] });
  };
  // Hip, knee, ankle of the right leg, then of the left, then the whole body again.
  const nextJoint = () => {
    const all = ["r", "l"].flatMap((side) => ["hip", "knee", "ankle"].map((name) => `${name}_${side}`));
    const here = all.filter((joint) => page.stage?.figure.joints.of(joint).length);
    state.set({ joint: here[here.indexOf(state.joint) + 1] ?? null });
  };
  const turn = (field) => () => state.set({ [field]: !state[field] });
  // What each key does; those of curves only where there are curves.
  const always = {
    " ": () => clock.play(),
    ArrowRight: step(1), ArrowLeft: step(-1),
    Home: end(0), End: end(1),
    "[": timeline.begin, "]": timeline.end, "\\": () => state.set({ window: null }),
    "+": faster(1), "=": faster(1), "-": faster(-1),
    j: nextJoint, Escape: () => (state.joint !== null ? state.set({ joint: null }) : controls.legend(false)),
    "?": () => dialog.showModal(),
  };
  const gait = {
    ...Object.fromEntries(Object.keys(Gaitcal.PRESETS).map((preset, k) => [k + 1, () => state.set({ preset })])),
    p: () => state.set({ axis: state.axis === "time" ? "percent" : "time" }),
    n: turn("nominal"), b: turn("norm"), e: turn("errors"), t: turn("truth"),
  };
  const actions = new Map(Object.entries(page.bare ? always : { ...always, ...gait }));

  // Whether what has the focus needs the key itself. The time slider does not: its arrows step as everywhere.
  const taken = (target, key) => {
    if (key === "Escape" || !(target instanceof Element) || target.id === "time") return false;
    if (target.closest("select, textarea, input:not([type=checkbox]):not([type=radio])")) return true;
    if (target.closest("input, button, summary, a, [role=tab]")) return [" ", "Enter"].includes(key);
    const scrolls = target.closest("[tabindex]") !== null && target.scrollHeight > target.clientHeight + 1;
    return scrolls && ["Home", "End", " "].includes(key);
  };
  window.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.altKey || event.metaKey || dialog.open) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (taken(event.target, key) || (key.length === 1 && key !== " " && !single.checked)) return;
    if (!actions.has(key)) return;
    actions.get(key)(event);
    event.preventDefault();
  });
  Gaitcal.get("help").addEventListener("click", () => dialog.showModal());
  Gaitcal.get("keys-close").addEventListener("click", () => dialog.close());
};
