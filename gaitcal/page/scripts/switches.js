// The controls of what is shown of the curves and in which convention; those without a meaning here are not shown. The
// usual ones stand in a row, the others behind a button that says which of them are not as they were at first.
Gaitcal.switches = (host, { state, results }) => {
  const sheets = results.map(({ sheet }) => sheet).filter(Boolean);
  const trials = sheets.flatMap((sheet) => sheet.trials);
  const curves = trials.flatMap((trial) => trial.curves);
  const strides = trials.some((trial) => trial.strides.length > 0);
  const moments = curves.some(({ kind }) => kind === "moment");
  const has = (field) => curves.some((curve) => curve[field] !== null);
  const meant = {
    axis: strides, spread: strides, unit: moments, signs: moments, acting: moments,
    errors: has("se"), nominal: has("nominal"), truth: has("truth"),
    norm: sheets.some(({ bands }) => bands.length), second: results.length > 1,
  };
  for (const [field, on] of Object.entries(meant)) if (!on) Gaitcal.get(`switch-${field}`).closest("label").remove();
  const [others, more] = [Gaitcal.get("switches-others"), Gaitcal.get("switches-more")];
  const [told, parts] = [host.querySelector(".told"), others.querySelector(".parts")];

  // Which trials and strides take part in curves and means.
  const boxes = [];
  const part = (key, title) => {
    const turn = (on) => {
      const off = new Set(state.off);
      if (on) off.delete(key);
      else off.add(key);
      state.set({ off });
    };
    const label = Gaitcal.tick(title, turn, { id: `part-${key.replaceAll("/", "-")}` });
    boxes.push({ key, box: label.control });
    return label;
  };
  const ofTrial = (key, trial) => {
    const title = ({ side, number, turns }) => `${Gaitcal.LEGS[side]} ${number}${turns ? " (turns)" : ""}`;
    const each = trial.strides.map((stride) => part(`${key}/${stride.side}/${stride.number}`, title(stride)));
    return html("li", part(key, trial.name), each);
  };
  const ofResult = ({ name, sheet }, r) => [
    results.length > 1 && html("p", name),
    html("ul", sheet.trials.map((trial, t) => trial.strides.length > 0 && ofTrial(`${r}/${t}`, trial))),
  ];
  if (trials.length > 1 || trials.some((trial) => trial.strides.length > 1)) {
    Gaitcal.built(parts, "", results.map((result, r) => result.sheet && ofResult(result, r)));
  } else parts.remove();

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
  const keys = results.flatMap(Gaitcal.parts).filter((key) => key.split("/").length === 4);
  const write = () => {
    const controls = [...others.querySelectorAll("[data-field]")];
    const set = controls.filter(({ dataset: { field } }) => state[field] !== state.usual[field]).map(words);
    if (state.off.size) set.push("strides left out");
    more.textContent = set.length ? `More: ${set.join(", ")}` : "More";
    // Whose moments, and which of their signs, without opening anything.
    told.textContent = `${state.acting}, ${state.signs === "clinical" ? "clinical signs" : "OpenSim’s signs"}`;
    const on = keys.filter((key) => !state.off.has(key) && !state.off.has(key.split("/").slice(0, 2).join("/"))).length;
    const count = on === keys.length ? `all ${on}` : `${on} of ${keys.length} strides`;
    parts.firstElementChild.textContent = `Trials and strides: ${count}`;
    for (const { key, box } of boxes) box.checked = !state.off.has(key);
  };
  state.on([...Object.keys(meant), "off"], write);
  write();
};
