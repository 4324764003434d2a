"use strict";
// The table of steps and phases. Which strides count, and how means are formed, is gaitcal/gait/spatiotemporal.py.

Gaitcal.OF_BOTH_LEGS = ["step_width"];
Gaitcal.OF_BOTH_FEET = ["step", "first_double", "second_double", "double", "single"];

// Whether a measure of a leg may be used where the verdict refuses the legs `refused`.
Gaitcal.measureCounts = (name, side, refused) =>
  !refused.includes(side) && !(refused.length && Gaitcal.OF_BOTH_FEET.some((begin) => name.startsWith(begin)));

// { n, mean, sd } of one leg, each stride counting the same; sd null of one alone; null of none.
Gaitcal.average = (values) => {
  const n = values.length;
  if (!n) return null;
  const mean = values.reduce((sum, value) => sum + value, 0) / n;
  const squares = values.reduce((sum, value) => sum + (value - mean) ** 2, 0);
  return { n, mean, sd: n > 1 ? Math.sqrt(squares / (n - 1)) : null };
};

// Of all trials together; isOn(trial index, side, stride number) tells which take part.
Gaitcal.stepRows = (sheet, isOn) => {
  const known = sheet.trials.flatMap((trial, index) =>
    trial.measures
      .filter((stride) => !stride.turns && isOn(index, stride.side, stride.number))
      .map(({ side, values }) => ({ side, values, refused: trial.refused })),
  );
  const of = (name, leg) =>
    Gaitcal.average(
      known
        .filter(
          ({ side, values, refused }) =>
            side === leg && Object.hasOwn(values, name) && Gaitcal.measureCounts(name, side, refused),
        )
        .map(({ values }) => values[name]),
    );
  return sheet.measures
    .map((measure) => {
      const [right, left] = [of(measure.name, "r"), of(measure.name, "l")];
      const sum = (right?.mean ?? 0) + (left?.mean ?? 0);
      const both = right && left && sum !== 0 && !Gaitcal.OF_BOTH_LEGS.includes(measure.name);
      return { ...measure, right, left, symmetry: both ? (200 * (right.mean - left.mean)) / sum : null };
    })
    .filter(({ right, left }) => right || left);
};

Gaitcal.stepsTable = (rows) => {
  const number = (value, digits) => Gaitcal.numeral(value, digits);
  const told = (average, digits) =>
    average ? number(average.mean, digits) + (average.sd === null ? "" : ` ± ${number(average.sd, digits)}`) : "–";
  const table = {
    head: ["Over strides", { t: "Right", side: "r" }, "n", { t: "Left", side: "l" }, "n", "Symmetry, %"],
    rows: rows.map(({ title, unit, digits, right, left, symmetry }) => [
      { t: `${title},`, unit: unit === "%" ? "% of stride" : unit },
      told(right, digits),
      String(right?.n ?? 0),
      told(left, digits),
      String(left?.n ?? 0),
      Gaitcal.numeral(symmetry, 1, true),
    ]),
  };
  return Gaitcal.scroller(Gaitcal.table(table, "Steps and phases"), "Steps and phases");
};

Gaitcal.STEP_WORDS =
  "Mean ± SD over the strides of all walks that are on, each counting the same, also those of which a recording shows " +
  "a part; n strides. Strides that turn are left out, and legs that are refused, with steps and supports beside them. " +
  "Lengths are between heels at strikes along the line of the stride, the width across it; the step is the one that " +
  "ends with the named foot. Symmetry: 100 (right − left) / mean of both; the width is one of both feet.";

// Of a result of the page, with what is switched on.
Gaitcal.stepsOf = ({ results, state }, result) =>
  Gaitcal.stepRows(
    results[result].sheet,
    (trial, side, number) =>
      !state.off.has(`${result}/${trial}`) && !state.off.has(`${result}/${trial}/${side}/${number}`),
  );

// With its heading: of the chosen result, and of the second one beside it.
Gaitcal.stepsParts = (page) => {
  const { results, state } = page;
  const shown = results
    .map((result, index) => ({ result, index }))
    .filter(({ result, index }) => result.sheet && (index === state.result || state.second))
    .map(({ result, index }) => ({ result, rows: Gaitcal.stepsOf(page, index) }))
    .filter(({ rows }) => rows.length);
  if (!shown.length) return [];
  const tables = shown.flatMap(({ result, rows }) => [
    ...(results.length > 1 ? [Gaitcal.make("h3", {}, Gaitcal.named(result.name))] : []),
    Gaitcal.stepsTable(rows),
  ]);
  return [
    Gaitcal.make("h2", {}, "Steps and phases"),
    ...tables,
    Gaitcal.make("p", { class: "soft" }, Gaitcal.STEP_WORDS),
  ];
};

Gaitcal.Steps = class {
  constructor(host, page) {
    Object.assign(this, { host, page });
    page.state.on(["off", "result", "second", "preset"], () => this.draw());
    this.draw();
  }

  draw() {
    this.host.replaceChildren(...Gaitcal.stepsParts(this.page));
    this.host.hidden = this.page.state.preset !== "clinician" || !this.host.hasChildNodes();
  }
};
