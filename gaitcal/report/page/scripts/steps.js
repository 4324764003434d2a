// The table of steps and phases: means over what is switched on. What of a stride counts is said in gaitcal/gait/spatiotemporal.py.

Gaitcal.stepsOf = ({ result, state }) => {
  const { trials, measures } = result.sheet;
  const { activity } = trials[state.trial] ?? trials[0];
  const counting = (trial, t) => trial.activity === activity && trial.measures.filter((stride) => Gaitcal.isOn(state, t, stride));
  const known = trials.flatMap((trial, t) => counting(trial, t) || []);
  const of = (name, leg) => {
    const average = Gaitcal.average(known.filter(({ side }) => side === leg).map(({ values }) => values[name]));
    return average.n ? average : null;
  };
  return measures
    .map((measure) => {
      const [right, left] = [of(measure.name, "r"), of(measure.name, "l")];
      const sum = (right?.mean ?? 0) + (left?.mean ?? 0);
      const both = right && left && sum !== 0 && measure.compared;
      if (!both) return { ...measure, right, left, symmetry: null };
      const [se, other] = [right, left].map(({ sd, n }) => Math.max(sd || 0, measure.least) / Math.sqrt(n));
      const error = (400 * Math.hypot(left.mean * se, right.mean * other)) / sum ** 2;
      return { ...measure, right, left, symmetry: (200 * (right.mean - left.mean)) / sum, error };
    })
    .filter(({ right, left }) => right || left);
};

Gaitcal.stepsTable = (rows) => {
  // How many strides the first measure has stands above, of others that differ beside them.
  const leg = (average, digits, usual) =>
    average
      ? { t: Gaitcal.plusMinus(average.mean, average.sd, digits), note: average.n !== usual && `(${average.n})` }
      : "–";
  const [n, m] = [rows[0]?.right?.n ?? 0, rows[0]?.left?.n ?? 0];
  const known = rows.some(({ norm }) => norm?.length);
  const ofNorm = ({ norm, digits }) => (known ? [norm?.length ? Gaitcal.plusMinus(...norm, digits) : "–"] : []);
  const table = {
    head: ["Mean ± SD (strides)", { t: `Right (${n})`, side: "r" }, { t: `Left (${m})`, side: "l" }, ...(known ? ["Norm"] : []), "R − L, %"],
    rows: rows.map(({ title, unit, digits, right, left, norm, symmetry, error }) => [
      { t: `${title},`, unit },
      leg(right, digits, n),
      leg(left, digits, m),
      ...ofNorm({ norm, digits }),
      symmetry === null ? "–" : Gaitcal.plusMinus(symmetry, error, 0),
    ]),
  };
  return Gaitcal.scroller(Gaitcal.table(table, "Steps and phases"), "Steps and phases");
};

Gaitcal.STEP_WORDS =
  "Mean ± SD over the strides of all walks that are on, each counting the same, also those of which a recording shows " +
  "a part; n strides. Strides that turn are left out, and legs that are refused, with steps and supports beside them. " +
  "Lengths are between heels at strikes along the line of the stride, the width across it; the step is the one that " +
  "ends with the named foot. R − L: asymmetry, 100 (right − left) / mean of both ± its standard error, with strikes known " +
  "to a frame at best; the width is one of both feet.";

// With its heading.
Gaitcal.stepsParts = (page) => {
  const rows = Gaitcal.stepsOf(page);
  const words = Gaitcal.fold("Which strides, and what is measured", html("p.soft", Gaitcal.STEP_WORDS));
  return rows.length ? [html("h2", "Steps and phases"), Gaitcal.stepsTable(rows), words] : [];
};

Gaitcal.steps = (host, page) => {
  const draw = () => {
    host.replaceChildren(...Gaitcal.stepsParts(page));
    host.hidden = page.state.preset !== "clinician" || !host.hasChildNodes();
  };
  page.state.on(["off", "preset"], draw);
  draw();
};
