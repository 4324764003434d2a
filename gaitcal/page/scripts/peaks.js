// The peaks of the curves as tables: what the eye reads off the panels, for those who read or hear.
Gaitcal.PEAK_TABLES = { angle: "Angles", moment: "Moments", power: "Powers", force: "Ground reactions" };

// % of the cycle: peaks of strides that lie so near each other are at one place.
Gaitcal.ONE_PLACE = 10;

// Highest and lowest valid value of one laid curve: {high: {value, se, at}, low, range}, and the part that is valid;
// null without any.
Gaitcal.extremes = ({ x, value, se, valid }, factor) => {
  const known = Array.from(x.keys()).filter((i) => valid[i] && !Number.isNaN(value[i]));
  if (!known.length) return null;
  const of = (i) => ({ value: factor * value[i], se: se ? Math.abs(factor) * se[i] : NaN, at: x[i] });
  const high = of(known.reduce((a, b) => (factor * value[b] > factor * value[a] ? b : a)));
  const low = of(known.reduce((a, b) => (factor * value[b] < factor * value[a] ? b : a)));
  return { high, low, range: { value: high.value - low.value, se: NaN, at: NaN }, seen: known.length / x.length };
};

// Where in the cycle the peaks of strides are: one place, the mean round the cycle, or from where to where.
Gaitcal.within = (percents) => {
  const sorted = percents.map((percent) => percent % 100).sort((a, b) => a - b);
  const gaps = sorted.map((percent, i) => (sorted[i + 1] ?? sorted[0] + 100) - percent);
  const last = gaps.indexOf(Math.max(...gaps));
  if (100 - gaps[last] > Gaitcal.ONE_PLACE) return [Math.min(...percents), Math.max(...percents)];
  if (percents.every((percent) => percent === percents[0])) return [percents[0]];
  const round = sorted.map((percent, i) => percent + (i > last ? 0 : 100));
  return [Math.round(Gaitcal.average(round).mean) % 100];
};

Gaitcal.Peaks = class {
  constructor(root, curves) {
    Object.assign(this, { root, curves });
  }

  // Peaks of a leg: {peaks, strides}, one record for each of so many strides that is valid enough to count; over time
  // one for the trial.
  of({ base, kind }, side) {
    const { strides, state, conventions } = this.curves;
    const { percent } = strides;
    const factor = conventions[state.result].factor(base, kind, side);
    const whole = percent ? null : strides.trial.curve(base, side, kind)?.whole();
    const laid = percent ? strides.laid(state.result, side, { base, kind }) : [whole].filter(Boolean);
    const peaks = laid.map((one) => Gaitcal.extremes(one, factor)).filter(Boolean);
    const least = percent ? strides.sheet.leastValid : 0;
    return { peaks: peaks.filter(({ seen }) => seen >= least), strides: laid.length };
  }

  // "58.2 ± 1.1" and "at 71 %; 4 of 5 strides": of one stride with its standard error, of several mean and SD of their
  // peaks.
  cell({ peaks, strides: all }, part, digits) {
    if (!peaks.length) return ["–", part === "range" ? "" : this.why(all)];
    const { mean, sd } = Gaitcal.average(peaks.map((peak) => peak[part].value));
    const text = Gaitcal.plusMinus(mean, peaks.length > 1 ? sd : peaks[0][part].se, digits);
    const star = peaks.every(({ seen }) => seen === 1) ? "" : " *";
    return [`${text}${star}`, part === "range" ? "" : this.where(peaks.map((peak) => peak[part].at), all)];
  }

  where(places, all) {
    if (!this.curves.strides.percent) return `at ${Gaitcal.numeral(places[0], 2)} s`;
    const at = Gaitcal.within(places).map((place) => Gaitcal.numeral(place, 0));
    return `at ${at.join(" to ")} %${places.length < all ? `; ${places.length} of ${all} strides` : ""}`;
  }

  // Why there is no peak.
  why(all) {
    if (!this.curves.strides.percent) return "nowhere valid";
    return all ? `none of ${all} valid to ${this.least} %` : "no straight stride";
  }

  get least() {
    return Gaitcal.numeral(100 * this.curves.strides.sheet.leastValid, 0);
  }

  // In one line, for who cannot see the panel.
  summary(subject) {
    const { state, conventions, strides } = this.curves;
    const digits = conventions[state.result].digits(subject.kind);
    const told = (strides.percent ? ["r", "l"] : ["r", "l", ""]).flatMap((side) => {
      const of = this.of(subject, side);
      if (!of.peaks.length) return [];
      const [low, high] = ["low", "high"].map((part) => this.cell(of, part, digits).join(" ").replace(" *", ""));
      return [`${Gaitcal.LEGS[side] ?? ""} from ${low} to ${high}`.trim()];
    });
    return told.join("; ") || "no valid values";
  }

  write(subjects) {
    const { strides } = this.curves;
    const tables = Object.keys(Gaitcal.PEAK_TABLES).map((kind) => this.table(kind, subjects.filter((one) => one.kind === kind)));
    const [right, left] = strides.counts;
    const which =
      `mean ± SD of the peaks of all straight strides that are on (right ${right}, left ${left}) and valid to ${this.least} %`;
    const words = strides.percent
      ? `Highest and lowest values: ${which}; of a single stride with its standard error. Where not all count, it is said ` +
        `how many do. Where peaks lie more than ${Gaitcal.ONE_PLACE} % of the cycle apart, it is said from where to where.`
      : "With standard errors.";
    const star = "* Some of the curve is not valid: the peak may lie there.";
    this.root.replaceChildren(html("h3", "Peaks"), html("p", `${words} ${star}`), ...tables.filter(Boolean));
  }

  table(kind, subjects) {
    const { state, conventions, strides } = this.curves;
    const convention = conventions[state.result];
    const none = { peaks: [], strides: 0 };
    const sides = ["r", "l", ""];
    const of = (base) => sides.map((side) => (strides.percent && !side ? none : this.of({ base, kind }, side)));
    const told = subjects
      .map(({ base }) => ({ base, of: of(base) }))
      .filter(({ of }) => of.some((one) => one.strides));
    if (!told.length) return null;
    const words = { high: "highest", low: "lowest", ...(kind === "angle" ? { range: "range" } : {}) };
    const columns = ["right", "left", "both"].flatMap((leg, k) =>
      told.some(({ of }) => of[k].strides) ? Object.keys(words).map((part) => ({ leg, k, part })) : [],
    );
    const title = `Peaks: ${Gaitcal.PEAK_TABLES[kind]}`;
    const table = {
      caption: `${Gaitcal.PEAK_TABLES[kind]}, ${convention.unit(kind)}`,
      head: ["", ...columns.map(({ leg, k, part }) => ({ t: `${leg} ${words[part]}`, side: ["r", "l"][k] }))],
      rows: told.map(({ base, of }) => [
        { t: convention.title(base, kind), note: `+ ${convention.positive(base, kind, strides.percent || kind === "force" ? "r" : "")}` },
        ...columns.map(({ k, part }) => {
          const [t, note] = this.cell(of[k], part, convention.digits(kind));
          return { t, note };
        }),
      ]),
    };
    return Gaitcal.scroller(Gaitcal.table(table), title);
  }
};
