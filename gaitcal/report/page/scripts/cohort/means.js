// Mean curves of groups, and their legend. Legs that are refused take no part.
Gaitcal.DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3], [4, 2], [12, 5]];

Gaitcal.meanCurves = (host, people, choices) => {
  const part = (name) => host.querySelector(`.${name}`);
  const [legend, grid] = [part("mean-legend"), part("mean-grid")];
  const panels = people.curves.map((_, variable) => Gaitcal.meanPanel(people, choices, variable));
  grid.append(...panels.map(({ root }) => root));

  const label = () => {
    const inside = new Set(choices.filtered().map((i) => people.groupOf[i]));
    const key = (colour, dash) =>
      svg("svg.curve-key", { width: 34, height: 14, "aria-hidden": "true", style: `stroke: var(--${colour}); fill: var(--${colour})` },
        colour !== "ink" && svg("rect", { y: 1, width: 34, height: 12 }),
        svg("line", { x1: 0, x2: 34, y1: 7, y2: 7, "stroke-dasharray": dash.join(" ") || null }),
      );
    const { groups } = people;
    const drawn = groups.slice(0, Gaitcal.GROUP_COLOURS);
    const normal = people.curves.find((curve) => curve.normal)?.normal;
    const single = (i, n) => {
      const words = `No longer draw ${Gaitcal.visible(people.name(i))}`;
      const off = Gaitcal.button("✕", () => choices.show(i, false), { class: "off", "aria-label": words });
      return html("li", key("ink", Gaitcal.DASHES[n]), people.linked(i), off);
    };
    legend.replaceChildren();
    Gaitcal.built(legend, "", [
      drawn.map((name, k) => inside.has(name) && html("li", key(`group${k}`, Gaitcal.DASHES[k]), Gaitcal.named(name))),
      normal && html("li", key("norm", [1, 2.5]), html("span", { title: normal.source }, "normal band, mean ± SD")),
      choices.shown.map(single),
      groups.length > drawn.length &&
        html("li", html("span"), `only the first ${drawn.length} of ${groups.length} groups are drawn`),
    ]);
  };

  // What is drawn in each part of the page, when it is seen; what is no longer as it is chosen; what is seen.
  const parts = new Map(panels.map(({ root, draw }) => [root, draw]));
  const [dirty, visible] = [new Set(), new Set()];
  let later = 0;
  const refresh = (all = false) => {
    for (const one of [...dirty].filter((root) => all || visible.has(root))) {
      dirty.delete(one);
      parts.get(one)();
    }
  };
  const stale = () => {
    label();
    for (const one of parts.keys()) dirty.add(one);
    cancelAnimationFrame(later);
    later = requestAnimationFrame(() => refresh());
  };
  const paper = (on) => {
    document.documentElement.classList.toggle("on-paper", on);
    stale();
    refresh(on);
  };
  const came = (entries) => {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) visible.add(target);
      else visible.delete(target);
    }
    refresh();
  };
  const watch = new IntersectionObserver(came, { rootMargin: "200px" });
  for (const one of parts.keys()) watch.observe(one);
  choices.on([...Gaitcal.NARROWING, "legs", "doubtful", "shown"], stale);
  new ResizeObserver(stale).observe(host);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", stale);
  window.addEventListener("beforeprint", () => paper(true));
  window.addEventListener("afterprint", () => paper(false));
  stale();
};

// One variable over the stride: each group's mean with its standard deviation, people who are shown over it, normal
// people behind it.
Gaitcal.meanPanel = (people, choices, variable) => {
  const { title, unit, positive, kind, normal } = people.curves[variable];
  const digits = kind === "angle" ? 1 : 2;
  const percents = Array.from({ length: people.points }, (_, k) => k * people.every);
  const place = html("div.mean-plot");
  const reading = html("p.reading");
  let [plot, groups, singles, at] = [null, [], [], null];

  // The means at a percent, below the curves; without one how many people they are of.
  const read = (k) => {
    const parts = groups.map(({ name, mean, sd, n, people: count }) => {
      const shown = Gaitcal.visible(name);
      return k === null ? `${shown} n ${count}` : `${shown} ${Gaitcal.plusMinus(mean[k], sd[k], digits)} (n ${n[k]})`;
    });
    const words = `${k === null ? "" : `${percents[k]} %: `}${parts.join("; ")}`;
    if (reading.textContent !== words) reading.textContent = words;
  };
  const drawing = () => {
    const colours = Gaitcal.pageColours();
    const known = (values) => values.map((value) => value ?? NaN);
    const norms = normal ? [Gaitcal.normBand(percents, known(normal.mean), known(normal.sd), colours)] : [];
    const around = ({ mean, sd, k }) => ({ x: percents, ...Gaitcal.around(mean, sd), colour: colours[`group${k}`], alpha: 0.14 });
    const bands = [...norms, ...groups.map(around)];
    const line = (y, colour, width, dash) => ({ x: percents, y, colour, width, dash });
    const lines = [
      ...groups.map(({ mean, k }) => line(mean, colours[`group${k}`], 2.2, Gaitcal.DASHES[k])),
      ...singles.map(({ curve, n }) => line(curve, colours.ink, 1.4, Gaitcal.DASHES[n])),
    ];
    const all = [...bands.flatMap(({ low, high }) => [low, high]), ...lines.map(({ y }) => y)].flat().filter(Number.isFinite);
    const [low, high] = all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
    const room = 0.06 * (high - low) || 1;
    return {
      x: [0, 100], y: [low - room, high + room], lines, bands, colours, font: 11, incrs: [25, 50],
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
      hooks: { setCursor: [({ cursor }) => read(cursor.idx ?? null)] },
    };
  };
  const ends = (mean) => {
    const known = mean.filter(Number.isFinite);
    const [low, high] = [Math.min(...known), Math.max(...known)].map((value) => Gaitcal.numeral(value, digits));
    return known.length ? `from ${low} to ${high}` : "nothing known";
  };
  const draw = () => {
    const means = people.means(choices, variable);
    const drawn = people.groups.slice(0, Gaitcal.GROUP_COLOURS);
    groups = drawn.flatMap((name, k) => (means.has(name) ? [{ name, k, ...means.get(name) }] : []));
    singles = choices.shown.flatMap((i, n) => {
      const curve = people.curve(i, variable, { legs: choices.legs, doubtful: true });
      return curve ? [{ n, curve }] : [];
    });
    const told = groups.map(({ name, people: count, mean }) => `${Gaitcal.visible(name)}: ${count} people, ${ends(mean)}`);
    const label = `${title}, ${unit}, over the stride. ${told.join("; ") || "No curve"}. Arrow keys read the means.`;
    root.setAttribute("aria-label", label);
    place.classList.toggle("empty", !groups.length && !singles.length);
    const size = [place.clientWidth, place.clientHeight];
    if (size.includes(0)) return;
    plot?.destroy();
    plot = Gaitcal.plot(place, size, drawing());
    read(at);
  };
  const pressed = (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    at = Math.min(percents.length - 1, Math.max(0, (at ?? (step > 0 ? -1 : 1)) + step));
    reading.setAttribute("role", "status");
    read(at);
    event.preventDefault();
  };
  const root = html("div.mean-panel",
    { "data-kind": kind, tabindex: "0", role: "group", keydown: pressed },
    html("p.caption", html("strong", title), html("span.soft", ` ${unit}, + ${positive}`)), place, reading);
  return { root, draw };
};
