"use strict";
// What the lines of the curves are, and of how many strides; above and below the grid.
Gaitcal.CurveLegend = class {
  constructor(curves) {
    this.curves = curves;
    this.root = Gaitcal.curvePart("ul", "curve-legend");
    this.root.setAttribute("aria-label", "Legend of the curves");
    this.notes = Gaitcal.curvePart("div", "curve-notes");
  }

  write() {
    const { strides, state } = this.curves;
    const percent = strides.percent;
    const counts = ["r", "l"].map((side) => strides.on(state.result, side).straight.length);
    const means = percent && state.spread === "mean" && Math.max(...counts) > 1;
    const has = (part) => strides.sheet.trials.some(({ packed }) => packed.curves.some((curve) => curve[part] && curve.side !== undefined && curve.joint));
    const second = state.second && strides.sheets[1 - state.result];
    const items = [
      ["right", "right", true],
      ["left", "left", true],
      ["none", "neither leg", !percent],
      ["sd", "\u00b1 SD over strides", means],
      ["se", means ? "\u00b1 standard error of the mean" : "\u00b1 standard error", state.errors && has("se")],
      ["thin", "other strides", percent && !means && Math.max(...counts) > 1],
      ["nominal", "nominal model", state.nominal && has("nominal")],
      ["truth", "truth", state.truth && has("truth")],
      ["norm", "healthy, mean \u00b1 SD", state.norm && percent && strides.sheet.bands.length > 0],
      ["invalid", "not valid", true],
      ["off", "toe-off", percent],
      ["stance", "foot on the ground", !percent],
      ["second", second ? this.curves.named(1 - state.result) : "", Boolean(second)],
    ];
    this.root.replaceChildren(
      ...items.filter(([, , shown]) => shown).map(([key, text]) => {
        const item = Gaitcal.curvePart("li");
        item.append(Gaitcal.key(key), Gaitcal.curvePart("span", "", text));
        return item;
      }),
    );
    this.notes.replaceChildren(...this.sentences(percent, counts).map((text) => Gaitcal.curvePart("p", "", text)));
  }

  sentences(percent, counts) {
    const { strides, state } = this.curves;
    const many = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
    const out = [];
    if (percent) {
      const trials = (side) => new Set(strides.on(state.result, side).straight.map(({ trial }) => trial)).size;
      out.push(
        `0 to 100 % of each leg\u2019s own stride, from strike to next strike: right ${many(counts[0], "stride")} of ${many(trials("r"), "trial")}, ` +
          `left ${many(counts[1], "stride")} of ${many(trials("l"), "trial")}.`,
      );
      const turning = ["r", "l"].reduce((sum, side) => sum + strides.on(state.result, side).turning.length, 0);
      if (turning) out.push(`${many(turning, "stride")} turn${turning === 1 ? "s" : ""} and take${turning === 1 ? "s" : ""} no part in means.`);
      for (const side of ["r", "l"]) if (!strides.near(side, state.seconds)) out.push(`The ${Gaitcal.LEGS[side]} leg makes no complete stride in ${strides.trial.name}.`);
      const sources = new Set(strides.sheet.bands.map(({ source }) => source));
      if (state.norm) for (const source of sources) out.push(`Healthy people: ${source}.`);
    } else {
      const why = state.axis === "percent" ? ", which holds no complete stride" : "";
      out.push(`Against the time of ${strides.trial.name}${why}.`);
    }
    if (strides.trial.relative) out.push("Joint angles are counted from the static trial.");
    return out;
  }
};

// A small picture of a line or band.
Gaitcal.key = (name) => {
  const space = "http://www.w3.org/2000/svg";
  const make = (kind, values) => {
    const made = document.createElementNS(space, kind);
    for (const [key, value] of Object.entries(values)) made.setAttribute(key, String(value));
    return made;
  };
  const svg = make("svg", { width: 26, height: 12, viewBox: "0 0 26 12", class: `curve-key key-${name}`, "aria-hidden": "true" });
  if (["sd", "se", "norm"].includes(name)) svg.append(make("rect", { x: 1, y: 1, width: 24, height: 10 }));
  else if (name === "off") svg.append(make("line", { x1: 13, y1: 0, x2: 13, y2: 12 }));
  else svg.append(make("line", { x1: 0, y1: 6, x2: 26, y2: 6 }));
  if (name === "second") svg.append(make("circle", { cx: 13, cy: 6, r: 3 }));
  return svg;
};
