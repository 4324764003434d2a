// Which strides count: on which plate, whether moments count throughout it, in words why not. What is ticked takes part in
// curves and means. The reasons are gaitcal/page/stride_use.py.
Gaitcal.counting = (host, { results, state }) => {
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
  const ofResult = ({ name, sheet }, r) => {
    const trials = (sheet?.trials ?? []).map((trial, t) => trial.strides.length > 0 && ofTrial(`${r}/${t}`, trial));
    const head = ["Stride in means", "Plate", "Moments"].map((words) => html("th", { scope: "col", class: "text" }, words));
    const title = results.length > 1 ? `Strides of ${Gaitcal.visible(name)}` : "Strides";
    return trials.some(Boolean) &&
      html("table", { "aria-label": title }, results.length > 1 && html("caption", Gaitcal.named(name)),
        html("thead", html("tr", head)), html("tbody", trials));
  };
  const count = html("p.soft");
  const tables = results.map(ofResult);
  Gaitcal.built(host, "", [html("h2", "Which strides count"), count, tables]);
  const write = () => {
    for (const { key, box } of boxes) box.checked = !state.off.has(key);
    const strides = boxes.map(({ key }) => key.split("/")).filter((parts) => parts.length === 4);
    const told = ["r", "l"].map((leg) => {
      const all = strides.filter(([result, , side]) => side === leg && Number(result) === state.result);
      const on = all.filter(([result, trial, side, number]) => Gaitcal.isOn(state, result, trial, { side, number }));
      return `${on.length} of ${all.length} ${Gaitcal.LEGS[leg]}`;
    });
    count.textContent = `In means: ${told.join(", ")} straight strides.`;
    host.hidden = state.preset !== "clinician" || !tables.some(Boolean);
  };
  state.on(["off", "preset", "result"], write);
  write();
};
