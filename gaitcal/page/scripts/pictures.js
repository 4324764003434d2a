"use strict";
// Pictures of intervals, bars and boxes: lanes below each other over one axis, as SVG in percent of the width, so that
// they fit any screen and paper in the page's own colours. Each stands before a table of the same numbers, unseen.

Gaitcal.svg = (name, attributes = {}, ...children) =>
  Gaitcal.dress(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);

// Round numbers within [low, high], about as many as asked for.
Gaitcal.roundTicks = (low, high, count = 5) => {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5].find((factor) => factor * power >= raw) ?? 10);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push({ at: k * step, digits });
  return out;
};

// Values to percent of the width.
Gaitcal.Axis = class {
  constructor(values, { unit, zero = false }) {
    const known = values.filter(Number.isFinite);
    if (zero || !known.length) known.push(0);
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const pad = 0.05 * (high - low || 1);
    this.unit = Gaitcal.visible(unit);
    this.low = zero && low === 0 ? 0 : low - pad;
    this.high = high + pad;
    this.ticks = Gaitcal.roundTicks(this.low, this.high);
  }

  share(value) {
    return Math.min(1, Math.max(0, (value - this.low) / (this.high - this.low)));
  }

  at(value) {
    return `${(100 * this.share(value)).toFixed(3)}%`;
  }

  inside(value) {
    return value >= this.low && value <= this.high;
  }

  // One lane: grid lines, then what `marks` are.
  lane(height, ...marks) {
    const grid = this.ticks.map(({ at }) =>
      Gaitcal.svg("line", { class: at === 0 ? "zero" : "grid", x1: this.at(at), x2: this.at(at), y1: 0, y2: "100%" }),
    );
    return Gaitcal.svg("svg", { class: "lane", height }, ...grid, ...marks);
  }

  foot(title = this.unit) {
    const anchor = (share) => (share < 0.06 ? "start" : share > 0.94 ? "end" : "middle");
    const numbers = this.ticks.map(({ at, digits }) =>
      Gaitcal.svg(
        "text",
        { x: this.at(at), y: 13, "text-anchor": anchor(this.share(at)) },
        Gaitcal.numeral(at, digits),
      ),
    );
    const words = Gaitcal.svg("text", { x: "50%", y: 28, "text-anchor": "middle" }, title);
    return Gaitcal.svg("svg", { class: "lane", height: 32 }, ...numbers, words);
  }
};

// A picture: [label, lane] rows, the axis below, and the table that says the same.
Gaitcal.picture = (title, rows, foot, key, table) => {
  const cells = rows.flatMap(([label, lane]) => [Gaitcal.make("span", { class: "lane-label" }, label), lane]);
  return Gaitcal.make(
    "figure",
    { class: "picture" },
    key.length ? Gaitcal.make("figcaption", { class: "key", "aria-hidden": "true" }, ...key) : null,
    Gaitcal.make("div", { class: "lanes", "aria-hidden": "true" }, ...cells, Gaitcal.make("span"), foot),
    Gaitcal.make("div", { class: "unseen" }, Gaitcal.table(table, title)),
  );
};

Gaitcal.keyOf = (mark, words) =>
  Gaitcal.make("span", {}, Gaitcal.svg("svg", { class: "swatch", width: 26, height: 14 }, ...mark), words);

// The right side round and solid, the left side square and dashed, what has no side a rhomb.
Gaitcal.dot = (side, x, y) => {
  const kind = `dot ${Gaitcal.SIDE_WORDS[side] ?? "middle"}`;
  if (side === "r") return Gaitcal.svg("circle", { class: kind, cx: x, cy: y, r: 4 });
  const middle = Gaitcal.svg("svg", { x, y, overflow: "visible" });
  const shape =
    side === "l"
      ? { x: -3.6, y: -3.6, width: 7.2, height: 7.2 }
      : { x: -3.4, y: -3.4, width: 6.8, height: 6.8, transform: "rotate(45)" };
  middle.append(Gaitcal.svg("rect", { class: kind, ...shape }));
  return middle;
};

Gaitcal.sideKeys = (rows) => {
  const sides = ["r", "l", ""].filter((side) => rows.some((row) => (row.side ?? "") === side));
  return sides
    .filter((side) => side || sides.length > 1)
    .map((side) => {
      const line = Gaitcal.svg("line", {
        class: `whisker ${Gaitcal.SIDE_WORDS[side] ?? "middle"}`,
        x1: 1,
        x2: 25,
        y1: 7,
        y2: 7,
      });
      return Gaitcal.keyOf([line, Gaitcal.dot(side, 13, 7)], Gaitcal.SIDE_WORDS[side] ?? "neither side");
    });
};

// Rows of the same label share a lane: right above left.
Gaitcal.byLabel = (rows) => {
  const out = new Map();
  for (const row of rows) {
    const label = Gaitcal.visible(row.label);
    out.set(label, [...(out.get(label) ?? []), row]);
  }
  return [...out];
};

Gaitcal.titled = (row) => [Gaitcal.SIDE_WORDS[row.side], Gaitcal.visible(row.label)].filter(Boolean).join(" ");

// Fitted minus nominal, with ±1 standard error, the truth and the bounds where they are known.
Gaitcal.BLOCKS.intervals = ({ unit, rows }, blocks) => {
  const known = rows.filter(({ fitted }) => fitted !== null && fitted !== undefined);
  if (!known.length) return null;
  const from = (row) => row.nominal ?? 0;
  const ends = known.flatMap((row) => {
    const change = row.fitted - from(row);
    return [change - (row.se ?? 0), change + (row.se ?? 0), row.truth == null ? 0 : row.truth - from(row)];
  });
  const axis = new Gaitcal.Axis(ends, { unit, zero: true });
  // Where a row's bounds stand, as far as the picture reaches.
  const boundsOf = (row) =>
    (row.bounds ?? []).filter((bound) => bound !== null && axis.inside(bound - from(row))).map((bound) => bound - from(row));
  const marks = (row, y) => {
    const [change, side] = [row.fitted - from(row), Gaitcal.SIDE_WORDS[row.side] ?? "middle"];
    const out = [];
    for (const at of boundsOf(row))
      out.push(Gaitcal.svg("line", { class: "bound", x1: axis.at(at), x2: axis.at(at), y1: y - 7, y2: y + 7 }));
    if (row.se)
      out.push(
        Gaitcal.svg("line", {
          class: `whisker ${side}`,
          x1: axis.at(change - row.se),
          x2: axis.at(change + row.se),
          y1: y,
          y2: y,
        }),
      );
    out.push(Gaitcal.dot(row.side, axis.at(change), y));
    if (row.truth != null)
      out.push(Gaitcal.svg("circle", { class: "truth", cx: axis.at(row.truth - from(row)), cy: y, r: 6.5 }));
    return out;
  };
  const lanes = Gaitcal.byLabel(known).map(([label, of]) => [
    label,
    axis.lane(16 * of.length + 8, ...of.flatMap((row, k) => marks(row, 12 + 16 * k))),
  ]);
  const digits = Math.max(1, ...axis.ticks.map((tick) => tick.digits + 1));
  const [errors, truths] = [known.some((row) => row.se != null), known.some((row) => row.truth != null)];
  const told = (row) =>
    [row.nominal, row.fitted, ...(errors ? [row.se] : []), ...(truths ? [row.truth] : [])].map((v) =>
      Gaitcal.numeral(v, digits),
    );
  const key = Gaitcal.sideKeys(known);
  if (truths) key.push(Gaitcal.keyOf([Gaitcal.svg("circle", { class: "truth", cx: 13, cy: 7, r: 5.5 })], "truth"));
  if (known.some((row) => boundsOf(row).length))
    key.push(Gaitcal.keyOf([Gaitcal.svg("line", { class: "bound", x1: 13, x2: 13, y1: 0, y2: 14 })], "bound"));
  return Gaitcal.picture(
    blocks.subject,
    lanes,
    axis.foot(`change from nominal, ${axis.unit}${errors ? " (± standard error)" : ""}`),
    key,
    {
      head: ["Parameter", "Nominal", "Fitted", ...(errors ? ["Standard error"] : []), ...(truths ? ["Truth"] : [])],
      rows: known.map((row) => [{ t: Gaitcal.titled(row), unit }, ...told(row)]),
    },
  );
};

// As long as the total; pieces by their share, with the number that the key gives them.
Gaitcal.BLOCKS.bars = ({ unit, rows }, blocks) => {
  const names = [...new Set(rows.flatMap((row) => row.parts.map((part) => part.name)))];
  const axis = new Gaitcal.Axis(
    rows.map((row) => row.total),
    { unit, zero: true },
  );
  const shares = (row) => {
    const sum = row.parts.reduce((all, part) => all + Math.max(0, part.value), 0) || 1;
    return names.map(
      (name) => row.parts.reduce((all, part) => all + (part.name === name ? Math.max(0, part.value) : 0), 0) / sum,
    );
  };
  const lane = (row) => {
    let begin = 0;
    const pieces = shares(row).flatMap((share, k) => {
      const [from, width] = [begin, share * row.total];
      begin += width;
      const part = width / (axis.high - axis.low);
      if (part < 0.001) return [];
      const rect = Gaitcal.svg("rect", {
        class: `piece part${k % 8}`,
        x: axis.at(from),
        y: 3,
        width: `${(100 * part).toFixed(3)}%`,
        height: 16,
      });
      rect.append(Gaitcal.svg("title", {}, `${Gaitcal.visible(names[k])} ${Math.round(100 * share)} %`));
      const digit = Gaitcal.svg(
        "text",
        { class: `number part${k % 8}`, x: axis.at(from + width / 2), y: 15.5, "text-anchor": "middle" },
        String(k + 1),
      );
      return part > 0.04 ? [rect, digit] : [rect];
    });
    return axis.lane(22, ...pieces);
  };
  const digits = Math.max(1, ...axis.ticks.map((tick) => tick.digits + 1));
  const lanes = rows.map((row) => {
    const label = Gaitcal.make("span", { class: row.side ? `side-${row.side}` : null }, Gaitcal.visible(row.label));
    return [label, lane(row)];
  });
  const key = names.map((name, k) => {
    const [chip, digit] = [
      { class: `piece part${k % 8}`, width: 20, height: 14 },
      { class: `number part${k % 8}`, x: 10, y: 11.5, "text-anchor": "middle" },
    ];
    return Gaitcal.keyOf([Gaitcal.svg("rect", chip), Gaitcal.svg("text", digit, String(k + 1))], Gaitcal.visible(name));
  });
  return Gaitcal.picture(blocks.subject, lanes, axis.foot(), key, {
    head: [blocks.subject || "What", `Total, ${axis.unit}`, ...names.map((name) => `${Gaitcal.visible(name)}, %`)],
    rows: rows.map((row) => [
      Gaitcal.titled(row),
      Gaitcal.numeral(row.total, digits),
      ...shares(row).map((share) => Gaitcal.numeral(100 * share, 0)),
    ]),
  });
};

// Low to high as a line, the middle half as a box, the median across it.
Gaitcal.BLOCKS.boxes = ({ unit, title, groups }, blocks) => {
  const all = groups.flatMap((group) => group.boxes);
  const axis = new Gaitcal.Axis(
    all.flatMap((box) => [box.low, box.high]),
    { unit },
  );
  const lane = (box) => {
    const side = Gaitcal.SIDE_WORDS[box.side] ?? "middle";
    const line = (x1, x2, y1, y2, kind) =>
      Gaitcal.svg("line", { class: kind, x1: axis.at(x1), x2: axis.at(x2), y1, y2 });
    const width = `${(100 * (axis.share(box.q3) - axis.share(box.q1))).toFixed(3)}%`;
    return axis.lane(
      20,
      line(box.low, box.high, 10, 10, `whisker ${side}`),
      line(box.low, box.low, 6, 14, `whisker ${side}`),
      line(box.high, box.high, 6, 14, `whisker ${side}`),
      Gaitcal.svg("rect", { class: `box ${side}`, x: axis.at(box.q1), y: 3, width, height: 14 }),
      line(box.median, box.median, 2, 18, "median"),
    );
  };
  const digits = Math.max(1, ...axis.ticks.map((tick) => tick.digits + 1));
  const lanes = groups.flatMap((group) => [
    ...(group.label ? [[Gaitcal.make("strong", {}, Gaitcal.visible(group.label)), axis.lane(20)]] : []),
    ...group.boxes.map((box) => [
      Gaitcal.make("span", { class: box.side ? `side-${box.side}` : null }, Gaitcal.visible(box.label)),
      lane(box),
    ]),
  ]);
  return Gaitcal.picture(
    title ?? blocks.subject,
    lanes,
    axis.foot(title ? `${Gaitcal.visible(title)}, ${axis.unit}` : axis.unit),
    [],
    {
      caption: title,
      head: [`${axis.unit}`, "Lowest", "Lower quartile", "Median", "Upper quartile", "Highest"],
      rows: groups.flatMap((group) =>
        group.boxes.map((box) => [
          [Gaitcal.visible(group.label), Gaitcal.titled(box)].filter(Boolean).join(": "),
          ...[box.low, box.q1, box.median, box.q3, box.high].map((v) => Gaitcal.numeral(v, digits)),
        ]),
      ),
    },
  );
};
