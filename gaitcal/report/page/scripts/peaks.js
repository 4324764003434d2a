// The peaks of the curves as tables: what the eye reads off the panels, for those who read or hear. Windows, means and
// errors are of gaitcal/gait/peaks.py, over all straight strides, or repetitions, of the chosen trial's activity.
Gaitcal.PEAK_TABLES = { angle: "Angles", moment: "Moments", power: "Powers", force: "Ground reactions" };
Gaitcal.PEAK_WORDS =
  "Peaks of each stride in the named part of its stance or swing; mean ± standard error over all straight strides of all walks. " +
  "Highest and lowest are given only if the curve turns within that part. Position: % of the stride.";
Gaitcal.PHASE_WORDS = (one) =>
  `Peaks of each ${one} in the named phase; mean ± standard error over all ${one}s. ` +
  `Phases with invalid frames, as on a seat, are left out. Position: % of the ${one}.`;

Gaitcal.Peaks = class {
  constructor(root, curves) { Object.assign(this, { root, curves }); }

  get convention() { return this.curves.convention; }

  title({ title, external }) { return this.curves.state.acting === "external" ? external : title; }

  // "0.77 ± 0.13" and "at 50 %; SD 0.05 of 3 strides"; which strides do not have it.
  cell({ base, kind, apart, ...legs }, side) {
    const of = legs[side];
    if (!of) return ["–", ""];
    const factor = this.convention.factor(base, kind, side);
    const digits = this.convention.digits(kind);
    const scale = Math.abs(factor);
    const where = of.percent === null ? [] : [`at ${Gaitcal.numeral(of.percent, 0)} %`];
    const all = Gaitcal.count(of.strides, this.curves.strides.one);
    const count = of.n < of.strides ? `${of.n} of ${all}` : all;
    const spread = of.sd === null ? count : `SD ${Gaitcal.numeral(scale * of.sd, digits)} of ${count}`;
    const error = of.se === null ? NaN : scale * of.se;
    return [Gaitcal.plusMinus((apart ? scale : factor) * of.mean, error, digits), [...where, spread].join("; ")];
  }

  // In one line, for who cannot see the panel.
  summary({ base, kind }) {
    const rows = this.curves.strides.peaks.filter((row) => row.base === base && row.kind === kind);
    const legs = (row) => ["r", "l"].filter((side) => row[side]).map((side) => `${Gaitcal.LEGS[side]} ${this.cell(row, side)[0]}`);
    return rows.map((row) => `${this.title(row)}: ${legs(row).join(", ")}`).join("; ");
  }

  write() {
    const { peaks, one, ofWalks } = this.curves.strides;
    const tables = Object.keys(Gaitcal.PEAK_TABLES).map((kind) => this.table(kind, peaks.filter((row) => row.kind === kind)));
    const parts = [html("h3", "Peaks"), html("p", ofWalks ? Gaitcal.PEAK_WORDS : Gaitcal.PHASE_WORDS(one)), ...tables.filter(Boolean)];
    this.root.replaceChildren(...(peaks.length ? parts : []));
  }

  table(kind, rows) {
    if (!rows.length) return null;
    const leg = (row, side) => {
      const [t, note] = this.cell(row, side);
      return { t, note };
    };
    const table = {
      caption: `${Gaitcal.PEAK_TABLES[kind]}, ${this.convention.unit(kind)}`,
      head: ["", { t: "right", side: "r" }, { t: "left", side: "l" }],
      rows: rows.map((row) => [
        { t: this.title(row), note: [`+ ${this.convention.positive(row.base, kind, "r")}`, row.window].join("; ") },
        leg(row, "r"),
        leg(row, "l"),
      ]),
    };
    return Gaitcal.scroller(Gaitcal.table(table), `Peaks: ${Gaitcal.PEAK_TABLES[kind]}`);
  }
};
