// The controls of what is shown of the curves and in which convention; those without a meaning here are not shown. The
// usual ones stand in a row, the others behind a button that says which of them are not as they were at first.
Gaitcal.switches = (host, { state, result: { sheet } }) => {
  const curves = sheet.trials.flatMap((trial) => trial.curves);
  const strides = sheet.trials.some((trial) => trial.strides.length > 0);
  const moments = curves.some(({ kind }) => kind === "moment");
  const has = (field) => curves.some((curve) => curve[field] !== null);
  const meant = {
    axis: strides, spread: strides, unit: moments, signs: moments, acting: moments,
    errors: has("se"), nominal: has("nominal"), truth: has("truth"),
    norm: sheet.bands.length > 0,
  };
  for (const [field, on] of Object.entries(meant)) if (!on) Gaitcal.get(`switch-${field}`).closest("label").remove();
  const [others, more] = [Gaitcal.get("switches-others"), Gaitcal.get("switches-more")];
  const told = host.querySelector(".told");

  told.hidden = !moments;
  more.hidden = others.children.length === 0;
  more.addEventListener("click", () => {
    others.hidden = !others.hidden;
    more.setAttribute("aria-expanded", String(!others.hidden));
  });
  // A choice in words: "external", "no truth".
  const words = ({ dataset, labels }) => {
    const value = state[dataset.field];
    if (typeof value !== "boolean") return value;
    return value ? labels[0].textContent : `no ${labels[0].textContent}`;
  };
  const write = () => {
    const controls = [...others.querySelectorAll("[data-field]")];
    const set = controls.filter(({ dataset: { field } }) => state[field] !== state.usual[field]).map(words);
    more.textContent = set.length ? `More: ${set.join(", ")}` : "More";
    // Whose moments, and which of their signs, without opening anything.
    told.textContent = `${state.acting}, ${state.signs === "clinical" ? "clinical signs" : "OpenSim’s signs"}`;
  };
  state.on(Object.keys(meant), write);
  write();
};
