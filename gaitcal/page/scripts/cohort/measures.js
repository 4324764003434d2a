"use strict";
// The columns that the table can show and distributions can be of: what a clinician asks for, and every other one.

// Those that are shown unless others are chosen; those without a value for anybody are passed over.
Gaitcal.USUAL_COLUMNS = [
  "person",
  "session",
  "group",
  "verdict",
  "first_cause",
  "mass",
  "height",
  "marker_rms",
  "residual",
  "speed",
  "cadence",
  "step_asymmetry",
  "knee_flexion_r",
  "knee_flexion_l",
  "hip_extension_r",
  "hip_extension_l",
  "plantarflexion_moment_r",
  "plantarflexion_moment_l",
  "ankle_power_r",
  "ankle_power_l",
  "adduction_moment_r",
  "adduction_moment_l",
];
Gaitcal.USUAL_MEASURES = ["speed", "step_asymmetry", "knee_flexion", "plantarflexion_moment"];
Gaitcal.TITLES = {
  person: "Person",
  session: "Session",
  group: "Group",
  verdict: "Verdict",
  first_cause: "First cause",
};

// Name -> {name, title, unit, meaning, text, digits, side, at(i), error(i)}, in the order of the chooser.
Gaitcal.tableColumns = (people) => {
  const out = new Map();
  const add = (column) => out.set(column.name, { side: null, error: null, ...column });
  for (const name of Object.keys(Gaitcal.TITLES)) {
    const raw = people.raw.get(name);
    if (raw) add({ ...raw, title: Gaitcal.TITLES[name] });
  }
  for (const measure of people.measures) for (const column of Gaitcal.measureColumns(measure, people)) add(column);
  for (const raw of people.raw.values())
    if (!out.has(raw.name)) add({ ...raw, title: raw.name, digits: Gaitcal.digitsOf(raw, people) });
  return out;
};

// One column where the measure has one number, else one for each leg.
Gaitcal.measureColumns = (measure, people) => {
  const sides = measure.column.includes("{}") && !measure.joined ? ["r", "l"] : [null];
  return sides.flatMap((side) => {
    const at = Gaitcal.measureAt(measure, people, side);
    if (!at) return [];
    const error = side && people.raw.get(measure.error.replace("{}", side));
    return [
      {
        name: side ? `${measure.name}_${side}` : measure.name,
        title: measure.title,
        unit: measure.unit,
        digits: measure.digits,
        text: false,
        side,
        at,
        error: error ? error.at : null,
        meaning: Gaitcal.measureWords(measure, side),
      },
    ];
  });
};

// A measure of one leg, of both (null: mean where each leg has its own); null where nobody has it.
Gaitcal.measureAt = (measure, people, side) => {
  const { sign } = measure;
  if (!measure.column.includes("{}")) return people.raw.get(measure.column)?.at ?? null;
  const [right, left] = ["r", "l"].map((leg) => people.raw.get(measure.column.replace("{}", leg))?.at ?? null);
  if (measure.joined === "asymmetry")
    return right && left && ((i) => (200 * (right(i) - left(i))) / (right(i) + left(i)));
  const one = { r: right, l: left }[side];
  if (side && !measure.joined) return one && ((i) => sign * one(i));
  if (!right || !left) return right || left ? (i) => sign * (right ?? left)(i) : null;
  return (i) => sign * Gaitcal.meanOf(right(i), left(i));
};

Gaitcal.meanOf = (a, b) => (Number.isNaN(a) ? b : Number.isNaN(b) ? a : (a + b) / 2);

Gaitcal.measureWords = ({ column, joined, sign, error }, side) => {
  if (joined === "asymmetry") return "200 % (right − left) / (right + left): positive where the right is longer";
  if (joined === "mean") return `mean of both legs' ${column.replace("_{}", "")}`;
  const source = column.replace("{}", side ?? "");
  const words = sign < 0 ? `${source} with the other sign` : source;
  return error ? `${words}: peak of the mean curve over the strides, not the mean of each stride's peak` : words;
};

// As many digits as tell people apart: about three that count.
Gaitcal.digitsOf = (raw, people) => {
  if (raw.text) return null;
  let most = 0;
  let whole = true;
  for (const i of people.all) {
    const value = raw.at(i);
    if (Number.isNaN(value)) continue;
    most = Math.max(most, Math.abs(value));
    whole &&= Number.isInteger(value);
  }
  return whole || most === 0 ? 0 : Math.min(4, Math.max(0, 2 - Math.floor(Math.log10(most))));
};

// What distributions can be of: named measures, over legs as they are chosen, then every column of numbers.
Gaitcal.distributed = (people, legs) => {
  const out = new Map();
  const side = legs === "both" ? null : legs;
  for (const measure of people.measures) {
    const at = Gaitcal.measureAt(measure, people, side);
    const legged = measure.column.includes("{}") && !measure.joined;
    if (at) out.set(measure.name, { ...measure, at, legged });
  }
  for (const column of people.columns.values())
    if (people.raw.has(column.name) && !column.text) out.set(column.name, column);
  return out;
};
