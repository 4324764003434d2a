// Lines and bands over one axis, drawn by uPlot.

// Between ticks: 1, 2, 5, 10, ...
Gaitcal.STEPS = [-4, -3, -2, -1, 0, 1, 2, 3, 4].flatMap((power) => [1, 2, 5].map((digit) => Number(`${digit}e${power}`)));

Gaitcal.GROUP_COLOURS = 6;

// The colours of the page as it is now: light, dark, or as on paper.
Gaitcal.pageColours = () => {
  const style = window.getComputedStyle(document.documentElement);
  const groups = Array.from({ length: Gaitcal.GROUP_COLOURS }, (_, k) => `group${k}`);
  const names = ["ink", "soft", "line", "paper", "accent", "poor", "right", "left", "nominal", "norm", "truth", ...groups];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
};

// A plot in `place`, `size` px wide and high. NaN is a gap.
// x, y: [low, high] of both axes; lines, all over the same x: [{x, y, colour, width, dash, alpha}];
// bands: [{x, low, high, colour, alpha, dash: of its rim}]; uprights: [{at, colour, dash}]; feet: bars at the foot of the plot,
// [{from, to, row, colour}]; incrs: steps between ticks of x; density: px of the plot for one of the page;
// unit: of the numbers along x; cursor, hooks: as of uPlot.
Gaitcal.plot = (place, size, drawing) => {
  const { x, y, lines, bands = [], uprights = [], feet = [], colours, density = 1, font = 10, unit = "" } = drawing;
  const { incrs = Gaitcal.STEPS, cursor = { show: false }, hooks = {} } = drawing;
  const scale = density * uPlot.pxRatio; // canvas pixels of one of the page
  const edges = bands.flatMap((band) => [
    { x: band.x, y: band.high, width: 0, alpha: band.alpha },
    { x: band.x, y: band.low, width: 0 },
  ]);
  const rims = bands.filter(({ dash }) => dash).flatMap(({ x: own, low, high, colour, dash }) =>
    [low, high].map((edge) => ({ x: own, y: edge, colour, width: 1, dash })));
  const all = [...edges, ...rims, ...lines];
  const known = ({ y: numbers }) => Array.from(numbers, (value) => (Number.isFinite(value) ? value : null));
  const series = all.map(({ colour, width, dash = [], alpha = 1 }) => ({
    stroke: colour, width: width * density, dash: dash.map((length) => length * scale), alpha, pxAlign: 0, points: { show: false },
  }));
  const line = { stroke: colours.line, width: 0.6 * density };
  const axis = {
    font: `${font * density}px system-ui, sans-serif`,
    stroke: colours.soft,
    grid: line,
    ticks: { ...line, size: 3 * density },
    gap: 2 * density,
    values: (_plot, splits) => Gaitcal.tickWords(splits),
  };
  const values = (_plot, splits) => Gaitcal.tickWords(splits).map((words) => words + unit);
  const under = (plot) => Gaitcal.underLines(plot, { uprights, feet, colours, scale });
  return new uPlot(
    {
      width: size[0] * density,
      height: size[1] * density,
      legend: { show: false },
      cursor,
      padding: [4 * density, 12 * density, 0, 0],
      scales: { x: { time: false, range: () => x }, y: { range: () => y } },
      axes: [
        { ...axis, values, incrs, size: (font + 6) * density, space: 38 * density },
        { ...axis, incrs: Gaitcal.STEPS, size: (3 * font + 6) * density, space: 24 * density },
      ],
      series: [{}, ...series],
      bands: bands.map((band, k) => ({ series: [1 + 2 * k, 2 + 2 * k], fill: band.colour })),
      hooks: { ...hooks, drawAxes: [under] },
    },
    [Array.from(all[0]?.x ?? x), ...all.map(known)],
    place,
  );
};

// The edges of a band about its middle.
Gaitcal.around = (middle, half) => ({
  low: middle.map((value, i) => value - half[i]),
  high: middle.map((value, i) => value + half[i]),
});

// The band of healthy people.
Gaitcal.normBand = (x, mean, sd, { norm }) => ({ x, ...Gaitcal.around(mean, sd), colour: norm, alpha: 0.25, dash: [1, 2.5] });

// As many digits as tell the ticks apart.
Gaitcal.tickWords = (splits) => {
  const digits = splits.length > 1 ? Gaitcal.digitsOf(Math.abs(splits[1] - splits[0])) : 0;
  return splits.map((value) => Gaitcal.numeral(value, digits));
};

// Zero; over the cycle lines where stance ends; over time bars while a foot is on the ground, right above left.
Gaitcal.underLines = ({ ctx: pen, bbox: { left, top, width, height }, valToPos }, { uprights, feet, colours, scale }) => {
  const stroke = (from, to, { colour, alpha, dash = [] }) => {
    Object.assign(pen, { strokeStyle: colour, globalAlpha: alpha, lineWidth: scale });
    pen.setLineDash(dash.map((length) => length * scale));
    pen.beginPath();
    pen.moveTo(...from);
    pen.lineTo(...to);
    pen.stroke();
  };
  pen.save();
  pen.beginPath();
  pen.rect(left, top, width, height);
  pen.clip();
  const zero = Math.round(valToPos(0, "y", true)) + 0.5;
  stroke([left, zero], [left + width, zero], { colour: colours.soft, alpha: 0.6 });
  for (const { at, ...upright } of uprights) {
    const x = valToPos(at, "x", true);
    stroke([x, top], [x, top + height], { alpha: 0.7, ...upright });
  }
  for (const { from, to, row, colour } of feet) {
    const [begin, end] = [from, to].map((time) => valToPos(time, "x", true));
    Object.assign(pen, { fillStyle: colour, globalAlpha: 0.55 });
    pen.fillRect(begin, top + height - row * scale, end - begin, 2.5 * scale);
  }
  pen.restore();
};
