// Pictures of intervals: lanes below each other over one axis, as SVG in percent of the width, so that
// they fit any screen and paper in the page's own colours. Each stands before a table of the same numbers, unseen.

// Values to percent of the width.
Gaitcal.Axis = class {
  constructor(values, { unit = "", zero = false }) {
    const known = values.filter(Number.isFinite);
    if (zero || !known.length) known.push(0);
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const pad = 0.05 * (high - low || Math.abs(high) || 1);
    this.unit = Gaitcal.visible(unit);
    this.low = zero && low === 0 ? 0 : low - pad;
    this.high = high + pad;
    this.ticks = Gaitcal.roundTicks(this.low, this.high);
    this.digits = Math.max(1, ...this.ticks.map(({ digits }) => digits + 1)); // of values that lie between ticks
  }

  share(value) { return Math.min(1, Math.max(0, (value - this.low) / (this.high - this.low))); }

  at(value) { return `${(100 * this.share(value)).toFixed(3)}%`; }

  width(from, to) { return `${(100 * (this.share(to) - this.share(from))).toFixed(3)}%`; }

  line(kind, from, to, y1, y2) { return svg(`line.${kind}`, { x1: this.at(from), x2: this.at(to), y1, y2 }); }

  // One lane: grid lines, then what `marks` are.
  lane(height, ...marks) {
    const grid = this.ticks.map(({ at }) => this.line(at === 0 ? "zero" : "grid", at, at, 0, "100%"));
    return svg("svg.lane", { height }, grid, marks);
  }

  foot(title = this.unit) {
    const anchor = (share) => (share < 0.06 ? "start" : share > 0.94 ? "end" : "middle");
    return svg("svg.lane", { height: title ? 32 : 18 },
      this.ticks.map(({ at, digits }) =>
        svg("text", { x: this.at(at), y: 13, "text-anchor": anchor(this.share(at)) }, Gaitcal.numeral(at, digits))),
      svg("text", { x: "50%", y: 28, "text-anchor": "middle" }, title),
    );
  }
};

// A picture: [label, lane] rows, the axis below, and the table that says the same.
Gaitcal.picture = (title, rows, foot, key, table) =>
  html("figure.picture",
    key.length > 0 && html("figcaption.key", { "aria-hidden": "true" }, key),
    html("div.lanes", { "aria-hidden": "true" },
      rows.map(([label, lane]) => [html("span.lane-label", label), lane]), html("span"), foot),
    html("div.unseen", Gaitcal.table(table, title)),
  );

Gaitcal.keyOf = (mark, words) => html("span", svg("svg.swatch", { width: 26, height: 14 }, mark), words);

// "right", "left"; "middle" of what has no side.
Gaitcal.sideClass = (side) => Gaitcal.LEGS[side] ?? "middle";

// The right side round and solid, the left side square and dashed, what has no side a rhomb.
Gaitcal.dot = (side, x, y) => {
  const kind = `dot.${Gaitcal.sideClass(side)}`;
  if (side === "r") return svg(`circle.${kind}`, { cx: x, cy: y, r: 4 });
  const half = side === "l" ? 3.6 : 3.4;
  const shape = { x: -half, y: -half, width: 2 * half, height: 2 * half, transform: side !== "l" && "rotate(45)" };
  return svg("svg", { x, y, overflow: "visible" }, svg(`rect.${kind}`, shape));
};

Gaitcal.sideKeys = (rows) => {
  const sides = ["r", "l", ""].filter((side) => rows.some((row) => (row.side ?? "") === side));
  const line = (side) => svg(`line.whisker.${Gaitcal.sideClass(side)}`, { x1: 1, x2: 25, y1: 7, y2: 7 });
  return sides
    .filter((side) => side || sides.length > 1)
    .map((side) => Gaitcal.keyOf([line(side), Gaitcal.dot(side, 13, 7)], Gaitcal.LEGS[side] ?? "neither side"));
};

Gaitcal.titled = (row) => [Gaitcal.LEGS[row.side], Gaitcal.visible(row.label)].filter(Boolean).join(" ");

// Fitted minus nominal, with ±1 standard error, the truth and the bounds where they are known.
Gaitcal.BLOCKS.intervals = ({ unit, rows }, blocks) => {
  const there = (value) => value !== null && value !== undefined;
  const known = rows
    .filter(({ fitted }) => there(fitted))
    .map((row) => {
      const from = (value) => (there(value) ? value - (row.nominal ?? 0) : null);
      const bounds = (row.bounds ?? []).filter(there).map(from);
      return { ...row, change: from(row.fitted), error: row.se ?? 0, true: from(row.truth), bounds };
    });
  if (!known.length) return null;
  const axis = new Gaitcal.Axis(known.flatMap((row) => [row.change - row.error, row.change + row.error, row.true ?? 0]), {
    unit, zero: true,
  });
  // Bounds are drawn as far as the picture reaches.
  const bounds = (row) => row.bounds.filter((bound) => bound >= axis.low && bound <= axis.high);
  const marks = (row, y) => [
    bounds(row).map((at) => axis.line("bound", at, at, y - 7, y + 7)),
    row.error > 0 &&
      axis.line(`whisker.${Gaitcal.sideClass(row.side)}`, row.change - row.error, row.change + row.error, y, y),
    Gaitcal.dot(row.side, axis.at(row.change), y),
    there(row.true) && svg("circle.truth", { cx: axis.at(row.true), cy: y, r: 6.5 }),
  ];
  // Rows of the same label share a lane: right above left.
  const lanes = [...Gaitcal.grouped(known, (row) => Gaitcal.visible(row.label))].map(([label, of]) => [
    label,
    axis.lane(16 * of.length + 8, of.map((row, k) => marks(row, 12 + 16 * k))),
  ]);
  const [errors, truths] = [known.some((row) => there(row.se)), known.some((row) => there(row.truth))];
  const columns = { nominal: "Nominal", fitted: "Fitted", ...(errors && { se: "Standard error" }), ...(truths && { truth: "Truth" }) };
  const key = [
    ...Gaitcal.sideKeys(known),
    truths && Gaitcal.keyOf(svg("circle.truth", { cx: 13, cy: 7, r: 5.5 }), "truth"),
    known.some((row) => bounds(row).length) &&
      Gaitcal.keyOf(svg("line.bound", { x1: 13, x2: 13, y1: 0, y2: 14 }), "bound"),
  ].filter(Boolean);
  const foot = axis.foot(`change from nominal, ${axis.unit}${errors ? " (± standard error)" : ""}`);
  return Gaitcal.picture(blocks.subject, lanes, foot, key, {
    head: ["Parameter", ...Object.values(columns)],
    rows: known.map((row) => [
      { t: Gaitcal.titled(row), unit },
      ...Object.keys(columns).map((field) => Gaitcal.numeral(row[field], axis.digits)),
    ]),
  });
};
