// Mean, standard deviation (of n - 1) and number of those values that are known; NaN where there are too few.
Gaitcal.average = (values) => {
  const known = values.filter(Number.isFinite);
  const n = known.length;
  const mean = known.reduce((sum, value) => sum + value, 0) / n;
  const sd = Math.sqrt(known.reduce((sum, value) => sum + (value - mean) ** 2, 0) / (n - 1));
  return { n, mean, sd: n > 1 ? sd : NaN };
};

// The same at each point of curves.
Gaitcal.averages = (curves) => {
  const at = Array.from(curves[0], (_, i) => Gaitcal.average(curves.map((curve) => curve[i])));
  return { n: at.map(({ n }) => n), mean: at.map(({ mean }) => mean), sd: at.map(({ sd }) => sd) };
};

// The mean of strides in the form of one, as gaitcal/gait/ensemble.py: every stride counts the same, what is not valid is
// left out. `laid`: curves over the percents of their strides.
Gaitcal.averaged = (laid) => {
  const counts = (one, name, i) => one.valid[i] && Number.isFinite(one[name]?.[i]);
  const of = (name) => Gaitcal.averages(laid.map((one) => one.value.map((_, i) => (counts(one, name, i) ? one[name][i] : NaN))));
  const mean = (name) => (laid.some((one) => one[name]) ? of(name).mean : null);
  const value = of("value");
  const se = (sd, i) => {
    const there = laid.filter((one) => counts(one, "value", i));
    if (there.length === 1) return there[0].se[i];
    if (!there.length || !there.every((one) => one.own)) return NaN;
    // Of one stride, what is its own; the rest all strides share.
    const shared = there.map((one) => Math.sqrt(Math.max(one.se[i] ** 2 - one.own[i] ** 2, 0)));
    return Math.hypot(sd / Math.sqrt(there.length), shared.reduce((a, b) => a + b) / there.length);
  };
  return {
    x: Gaitcal.PERCENTS,
    valid: value.n.map((n) => n > 0),
    counts: value.n,
    value: value.mean,
    sd: value.sd,
    se: laid.every((one) => one.se) ? value.sd.map(se) : null,
    nominal: mean("nominal"),
    truth: mean("truth"),
  };
};
