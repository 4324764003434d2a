// A trial's own curves over its time, with the clock's cursor: pelvis residuals, marker errors.

// The figure of one curve of a trial of a sheet; what moves its line to a time goes to `cursors`.
// `wide`: px of the paper that it is drawn for.
Gaitcal.trialCurve = (trial, curve, { cursors, page, wide }) => {
  const time = Gaitcal.floats(trial.time);
  const value = new Gaitcal.Lengths(curve.value).all();
  const nominal = curve.nominal && new Gaitcal.Lengths(curve.nominal).all();
  const valid = new Uint8Array(Gaitcal.bytes(trial.masks[curve.valid]));
  const unit = Gaitcal.UNITS[curve.unit] ?? Gaitcal.visible(curve.unit);
  const title = Gaitcal.TRIAL_CURVES[curve.kind] ?? Gaitcal.visible(curve.kind);
  const duration = time.at(-1) || 1;
  const counted = value.map((one, i) => (valid[i] ? one : NaN));
  const highest = (values) => values.filter(Number.isFinite).reduce((a, b) => Math.max(a, b), 0);

  // What the picture says, for who does not see it.
  const words = () => {
    const known = counted.filter(Number.isFinite);
    if (!known.length) return `${title}: no valid frame.`;
    return `Peak ${Gaitcal.numeral(highest(known))} ${unit} in the valid frames.`;
  };
  const drawing = (density) => {
    const colours = Gaitcal.pageColours();
    const { accent } = colours;
    const lines = [
      nominal && { x: time, y: nominal, colour: colours.nominal, width: 1, dash: [6, 2] },
      { x: time, y: value, colour: accent, width: 0.9, alpha: 0.55 },
      { x: time, y: counted, colour: accent, width: 1.8 },
    ].filter(Boolean);
    const top = 1.06 * (highest(lines.flatMap(({ y }) => [...y])) || 1);
    return { x: [0, duration], y: [0, top], lines, colours, density, font: 11, unit: " s" };
  };
  const line = html("div.cursor");
  const now = html("span.now");
  const place = html("div.plot", { role: "img", "aria-label": `${title} over time. ${words()}` });
  let plot = null;
  const draw = (width, density = 1) => {
    plot?.destroy();
    plot = Gaitcal.plot(place, [width, Gaitcal.TRIAL_HEIGHT], drawing(density));
    plot.over.append(line);
    plot.over.addEventListener("click", ({ offsetX, currentTarget }) => {
      const share = Math.min(1, Math.max(0, offsetX / currentTarget.clientWidth));
      page.state.set({ seconds: share * duration, playing: false });
    });
  };
  const fit = () => place.clientWidth && place.clientWidth !== plot?.width && draw(place.clientWidth);
  if (wide) draw(wide, 2);
  else new ResizeObserver(fit).observe(place);
  cursors.push((seconds, still) => {
    if (!plot) fit();
    line.style.transform = `translateX(${(100 * Math.min(1, seconds / duration)).toFixed(3)}%)`;
    const here = value[time.findIndex((t) => t >= seconds - 1e-6)];
    if (still) now.textContent = ` At ${seconds.toFixed(2)} s: ${Gaitcal.numeral(here)} ${unit}.`;
  });
  return html("figure.traced", html("figcaption", html("strong", `${title}, ${unit}`), " ", words(), now), place);
};

Gaitcal.TRIAL_HEIGHT = 148; // px

Gaitcal.BLOCKS.curves = ({ kinds }, { scope }) => {
  const { trial } = scope;
  const curves = kinds.flatMap((kind) => (trial?.curves ?? []).filter((curve) => curve.kind === kind));
  if (!curves.length) return null;
  const key = (kind, words) => Gaitcal.keyOf(svg(`line.${kind}`, { x1: 1, x2: 25, y1: 7, y2: 7 }), words);
  const figures = curves.map((curve) => Gaitcal.trialCurve(trial, curve, scope));
  return html("div.traces",
    html("p.key", { "aria-hidden": "true" },
      key("counted", "calibrated model"),
      key("unsure", "the same, in frames that do not count"),
      curves.some((curve) => curve.nominal) && key("nominal", "before calibration"),
    ),
    figures,
  );
};
