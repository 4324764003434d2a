"use strict";
// The peaks of the curves as tables: what the eye reads off the panels, for those who read or hear.
Gaitcal.PEAK_TABLES = [
  ["angle", "Angles"], ["moment", "Moments"], ["power", "Powers"], ["force", "Ground reactions"],
];

// % of the cycle: peaks of strides that lie so near each other are at one place.
Gaitcal.ONE_PLACE = 10;

// Highest and lowest valid value of one laid curve: {high: {value, se, at}, low, range}, and the part that is valid;
// null without any.
Gaitcal.extremes = ({ x, value, se, valid }, factor) => {
  let [high, low, seen] = [-1, -1, 0];
  for (let i = 0; i < x.length; i++) {
    if (valid[i] && !Number.isNaN(value[i])) {
      seen++;
      if (high < 0 || factor * value[i] > factor * value[high]) high = i;
      if (low < 0 || factor * value[i] < factor * value[low]) low = i;
    }
  }
  if (high < 0) return null;
  const at = (i) => ({ value: factor * value[i], se: se ? Math.abs(factor) * se[i] : NaN, at: x[i] });
  const range = { value: Math.abs(value[high] - value[low]), se: NaN, at: NaN };
  return { high: at(high), low: at(low), range: { ...range, value: Math.abs(factor) * range.value }, seen: seen / x.length };
};

// Where in the cycle the peaks of strides are: one place, the mean round the cycle, or from where to where.
Gaitcal.within = (percents) => {
  const sorted = percents.map((percent) => percent % 100).sort((a, b) => a - b);
  const gaps = sorted.map((percent, i) => (sorted[i + 1] ?? sorted[0] + 100) - percent);
  const last = gaps.indexOf(Math.max(...gaps));
  if (100 - gaps[last] > Gaitcal.ONE_PLACE) return [Math.min(...percents), Math.max(...percents)];
  const round = sorted.map((percent, i) => percent + (i > last ? 0 : 100));
  const mean = round.reduce((a, b) => a + b, 0) / round.length;
  return [percents.every((percent) => percent === percents[0]) ? percents[0] : Math.round(mean) % 100];
};

Gaitcal.Peaks = class {
  constructor(curves) {
    this.curves = curves;
    this.root = Gaitcal.curvePart("div", "curve-peaks");
  }

  // Peaks of a leg: {peaks, strides}, one record for each of so many strides that is valid enough to count; over time
  // one for the trial.
  of({ base, kind }, side) {
    const { strides, state, conventions } = this.curves;
    const found = (trial) => trial.curve(base, side, kind) ?? trial.curve(base, "", kind);
    const factor = conventions[state.result].factor(base, kind, strides.percent ? side : "");
    const laid = (
      strides.percent
        ? strides.on(state.result, side).straight.map(({ trial, stride }) => found(trial)?.over(stride))
        : [strides.trial.curve(base, side, kind)?.whole()]
    ).filter(Boolean);
    const peaks = laid.map((one) => Gaitcal.extremes(one, factor)).filter(Boolean);
    const least = strides.percent ? strides.sheet.leastValid : 0;
    return { peaks: peaks.filter(({ seen }) => seen >= least), strides: laid.length };
  }

  // "58.2 ± 1.1" and "at 71 %; 4 of 5 strides": of one stride with its standard error, of several mean and SD of their
  // peaks.
  cell({ peaks, strides: all }, part, digits) {
    if (!peaks.length) return ["\u2013", part === "range" ? "" : this.why(all)];
    const values = peaks.map((peak) => peak[part].value);
    const mean = values.reduce((a, b) => a + b, 0) / values.length;
    const sd = Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / (values.length - 1));
    const error = peaks.length > 1 ? sd : peaks[0][part].se;
    const text = `${Gaitcal.number(mean, digits)}${Number.isFinite(error) ? ` \u00b1 ${Gaitcal.number(error, digits)}` : ""}`;
    const star = peaks.every(({ seen }) => seen === 1) ? "" : " *";
    return [`${text}${star}`, part === "range" ? "" : this.where(peaks.map((peak) => peak[part].at), all)];
  }

  where(places, all) {
    if (!this.curves.strides.percent) return `at ${Gaitcal.number(places[0], 2)} s`;
    const at = Gaitcal.within(places).map((place) => Gaitcal.number(place, 0));
    return `at ${at.join(" to ")} %${places.length < all ? `; ${places.length} of ${all} strides` : ""}`;
  }

  // Why there is no peak.
  why(all) {
    const { strides } = this.curves;
    if (!strides.percent) return "nowhere valid";
    return all ? `none of ${all} valid to ${this.least} %` : "no straight stride";
  }

  get least() {
    return Gaitcal.number(100 * this.curves.strides.sheet.leastValid, 0);
  }

  // In one line, for who cannot see the panel.
  summary(subject) {
    const { state, conventions, strides } = this.curves;
    const digits = conventions[state.result].digits(subject.kind);
    const sides = strides.percent ? ["r", "l"] : ["r", "l", ""];
    const told = sides.flatMap((side) => {
      const of = this.of(subject, side);
      if (!of.peaks.length) return [];
      const [low, high] = ["low", "high"].map((part) => this.cell(of, part, digits).join(" ").replace(" *", ""));
      return [`${Gaitcal.LEGS[side] ?? ""} from ${low} to ${high}`.trim()];
    });
    return told.join("; ") || "no valid values";
  }

  write(subjects) {
    const tables = Gaitcal.PEAK_TABLES.map(([kind, title]) => this.table(title, subjects.filter((subject) => subject.kind === kind)));
    const shown = tables.filter(Boolean);
    const heading = Gaitcal.curvePart("h3", "", "Peaks");
    const { strides, state } = this.curves;
    const counts = ["r", "l"].map((side) => strides.on(state.result, side).straight.length);
    const which = `mean \u00b1 SD of the peaks of all straight strides that are on (right ${counts[0]}, left ${counts[1]}) and valid to ${this.least} %`;
    const words = strides.percent
      ? `Highest and lowest values: ${which}; of a single stride with its standard error. Where not all count, it is said how many do. Where peaks lie more than ${Gaitcal.ONE_PLACE} % of the cycle apart, it is said from where to where.`
      : "With standard errors.";
    const star = "* Some of the curve is not valid: the peak may lie there.";
    this.root.replaceChildren(heading, Gaitcal.curvePart("p", "", `${words} ${star}`), ...shown);
  }

  table(title, subjects) {
    const { state, conventions, strides } = this.curves;
    const convention = conventions[state.result];
    const told = subjects
      .map((subject) => [subject, this.of(subject, "r"), this.of(subject, "l"), strides.percent ? [] : this.of(subject, "")])
      .filter(([, ...peaks]) => peaks.some((of) => of.strides));
    if (!told.length) return null;
    const element = Gaitcal.curvePart;
    const { kind } = subjects[0];
    const parts = kind === "angle" ? ["high", "low", "range"] : ["high", "low"];
    const words = { high: "highest", low: "lowest", range: "range" };
    const columns = [1, 2, 3].filter((i) => told.some((row) => row[i].strides));
    const table = element("table", "curve-table");
    table.append(element("caption", "", `${title}, ${convention.unit(kind)}`));
    const heads = element("tr");
    heads.append(element("td"));
    for (const i of columns)
      for (const part of parts) {
        const head = element("th", i < 3 ? `side-${"rl"[i - 1]}` : "", `${["", "right", "left", "both"][i]} ${words[part]}`.trim());
        head.scope = "col";
        heads.append(head);
      }
    const [top, body] = [element("thead"), element("tbody")];
    top.append(heads);
    for (const row of told) {
      const line = element("tr");
      const head = element("th", "", convention.title(row[0].base, kind));
      head.scope = "row";
      head.append(element("small", "", ` + ${convention.positive(row[0].base, kind, strides.percent ? "r" : "")}`));
      line.append(head);
      for (const i of columns) for (const part of parts) line.append(this.filled(row[i], part, convention.digits(kind)));
      body.append(line);
    }
    table.append(top, body);
    const scroller = element("div", "curve-scroller");
    scroller.tabIndex = 0;
    scroller.setAttribute("role", "region");
    scroller.setAttribute("aria-label", `Peaks: ${title}`);
    scroller.append(table);
    return scroller;
  }

  filled(of, part, digits) {
    const [text, where] = this.cell(of, part, digits);
    const cell = Gaitcal.curvePart("td", "", text);
    if (where) cell.append(Gaitcal.curvePart("small", "", ` ${where}`));
    return cell;
  }
};
