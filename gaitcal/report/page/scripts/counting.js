// Which strides count: on which plate, whether moments count throughout it, in words why not. What is ticked takes part in
// curves and means. The reasons are those of gaitcal/results/stride_uses.py.
Gaitcal.counting = (host, { result: { sheet }, state }) => {
  const boxes = [];
  const tick = (key, words, more = {}) => {
    const turn = (on) => {
      const off = new Set(state.off);
      if (on) off.delete(key);
      else off.add(key);
      state.set({ off });
    };
    const label = Gaitcal.tick(words, turn, { id: `part-${key.replaceAll("/", "-")}`, ...more });
    if (!more.disabled) boxes.push({ key, box: label.control });
    return label;
  };
  const ofStride = (key, { side, number, turns, plate, reason }) => {
    const why = [turns && "turns: in no mean", reason].filter(Boolean).join("; ");
    return html("tr",
      html("th", { scope: "row", class: `side-${side}` },
        tick(`${key}/${side}/${number}`, `${Gaitcal.LEGS[side]} ${number}`, { disabled: turns })),
      html("td", Gaitcal.visible(plate || "–")),
      html("td.text", why ? Gaitcal.visible(why) : Gaitcal.tag("whole", "good")));
  };
  const ofTrial = (key, trial) => [
    html("tr.of", html("th", { scope: "rowgroup", colspan: 3 }, tick(key, trial.name))),
    trial.strides.map((stride) => ofStride(key, stride)),
  ];
  const trials = sheet.trials.map((trial, t) => trial.strides.length > 0 && ofTrial(`${t}`, trial)).filter(Boolean);
  const repeat = sheet.trials.every(({ strides, repeats }) => repeats || !strides.length);
  const mixed = sheet.trials.some(({ repeats }) => repeats);
  const one = repeat ? "Repetition" : "Stride";
  const head = [`${one} in means`, "Plate", "Moments"].map((words) => html("th", { scope: "col", class: "text" }, words));
  const count = html("p.soft");
  Gaitcal.built(host, "", [html("h2", `Which ${one.toLowerCase()}s count`), count,
    html("table", { "aria-label": "Strides" }, html("thead", html("tr", head)), html("tbody", trials))]);
  const write = () => {
    for (const { key, box } of boxes) box.checked = !state.off.has(key);
    const strides = boxes.map(({ key }) => key.split("/")).filter((parts) => parts.length === 3);
    const told = ["r", "l"].map((leg) => {
      const all = strides.filter(([, side]) => side === leg);
      const on = all.filter(([trial, side, number]) => Gaitcal.isOn(state, trial, { side, number }));
      return `${on.length} of ${all.length} ${Gaitcal.LEGS[leg]}`;
    });
    count.textContent = `In means: ${told.join(", ")} ${repeat ? "repetitions" : mixed ? "straight strides and repetitions" : "straight strides"}.`;
    host.hidden = state.preset !== "clinician" || !trials.length;
  };
  state.on(["off", "preset"], write);
  write();
};
