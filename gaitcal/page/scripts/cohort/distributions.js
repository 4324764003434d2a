"use strict";
// Distributions: a dot is a person, a box the middle half of a group, a line its median.
Gaitcal.LANE = 54; // px high
Gaitcal.EDGE = 10; // px beside the outermost dots

// Value below which so large a part of sorted values lies.
Gaitcal.quantile = (sorted, part) => {
  const at = part * (sorted.length - 1);
  const [low, high] = [sorted[Math.floor(at)], sorted[Math.ceil(at)]];
  return low + (high - low) * (at - Math.floor(at));
};

Gaitcal.distributions = (host, people, choices) => {
  const place = host.querySelector(".strips");
  const add = Gaitcal.get("add");
  let [dirty, visible, wide] = [true, false, 0];
  // What is no longer as it is chosen, where it is seen, or everywhere: thousands of dots are drawn when they are seen.
  const draw = (changed, everywhere = false) => {
    dirty ||= changed;
    if (!dirty || !(visible || everywhere)) return;
    dirty = false;
    wide = place.clientWidth;
    const known = people.distributed(choices.legs);
    const others = [...known.values()].filter(({ name }) => !choices.measures.includes(name));
    const words = ({ legged, title, side, unit }) =>
      Gaitcal.columnWords({ title, side: legged ? null : side }) + (unit ? ` (${unit})` : "");
    add.replaceChildren(new Option("add …", ""), ...others.map((measure) => new Option(words(measure), measure.name)));
    const strips = choices.measures.filter((name) => known.has(name)).map((name) => Gaitcal.strip(people, choices, known.get(name)));
    place.replaceChildren(...strips.map(({ root }) => root));
    for (const { fill } of strips) fill();
  };
  add.addEventListener("change", () => add.value && choices.set({ measures: [...choices.measures, add.value] }));
  choices.on([...Gaitcal.NARROWING, "legs", "measures"], () => draw(true));
  new ResizeObserver(() => draw(place.clientWidth !== wide)).observe(place);
  const came = ([{ isIntersecting }]) => {
    visible = isIntersecting;
    draw(false);
  };
  new IntersectionObserver(came, { rootMargin: "300px" }).observe(host);
  window.addEventListener("beforeprint", () => draw(false, true));
};

// One measure: a lane for each group. {root, fill()}: it is filled once it has its place.
Gaitcal.strip = (people, choices, measure) => {
  const { name, legged, digits, unit } = measure;
  const legs = { both: "mean of both legs", ...Gaitcal.LEGS }[legged ? choices.legs : measure.side];
  const title = [measure.title, legs, unit].filter(Boolean).join(", ");
  const values = choices.filtered().map((i) => ({ i, value: measure.at(i) })).filter(({ value }) => Number.isFinite(value));
  values.sort((a, b) => a.value - b.value);
  const [lowest, highest] = values.length ? [values[0].value, values.at(-1).value] : [0, 1];
  const room = 0.04 * (highest - lowest) || Math.abs(highest) * 0.05 || 1;
  const [low, high] = [lowest - room, highest + room];
  const dots = new Map();
  let [wide, now] = [0, null];
  const x = (value) => Gaitcal.EDGE + ((value - low) / (high - low)) * (wide - 2 * Gaitcal.EDGE);

  // Who a dot is that is pointed at.
  const point = (i) => {
    dots.get(now)?.classList.remove("pointed");
    now = i;
    const dot = dots.get(i);
    dot?.classList.add("pointed");
    const words = () =>
      `${Gaitcal.visible(people.name(i))}: ${Gaitcal.numeral(measure.at(i), digits)} ${unit} ` +
      `(${Gaitcal.visible(people.word("verdict", i))})`;
    tip.textContent = dot ? words() : "\u00a0";
  };
  const open = (i, event) => {
    const link = i !== null && people.link(i);
    if (link) window.open(link, event.ctrlKey || event.metaKey ? "_blank" : "_self");
  };
  const pressed = (event) => {
    const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
    const last = values.length - 1;
    const here = values.findIndex(({ i }) => i === now);
    const next = here < 0 ? (step > 0 ? 0 : last) : Math.min(last, Math.max(0, here + step));
    if (event.key === "Enter" && now !== null) open(now, event);
    else if (event.key === "Escape") point(null);
    else if (step && values.length) point(values[next].i);
    else return;
    event.preventDefault();
  };
  const of = ({ target }) => (target.dataset?.i ? Number(target.dataset.i) : null);
  const tip = html("p.tip-line", { role: "status" }, "\u00a0");
  const lanes = html("div.lanes.strip-lanes", {
    tabindex: "0", role: "group",
    pointerover: (event) => of(event) !== null && point(of(event)),
    pointerleave: () => point(null),
    click: (event) => open(of(event), event),
    keydown: pressed,
    blur: () => point(null),
  });
  const gone = () => choices.set({ measures: choices.measures.filter((other) => other !== name) });
  const off = Gaitcal.button("✕", gone, { class: "off", "aria-label": `Take away ${measure.title}` });

  const lane = ({ own, k, quartiles }) => {
    const [first, median, third] = quartiles.map(x);
    const box = { x: first, width: Math.max(1, third - first), y: 4, height: Gaitcal.LANE - 8, rx: 3 };
    const radius = own.length > 250 ? 2 : own.length > 60 ? 3 : 4.5;
    // Dots that would lie on each other stand in a pile, closer where there are many.
    for (const pile of Gaitcal.grouped(own, ({ value }) => Math.round(x(value) / (2 * radius))).values()) {
      const step = Math.min(2 * radius, (Gaitcal.LANE - 2 * radius - 4) / Math.max(1, pile.length - 1));
      for (const [n, { i, value }] of pile.entries()) {
        const y = Gaitcal.LANE / 2 + (n % 2 ? 1 : -1) * Math.ceil(n / 2) * step;
        const at = { cx: x(value).toFixed(1), cy: y.toFixed(1), r: radius, "data-i": i };
        dots.set(i, svg(`circle.person.group${k % Gaitcal.GROUP_COLOURS}`, at));
      }
    }
    return svg("svg.lane", { width: wide, height: Gaitcal.LANE, "aria-hidden": "true" },
      own.length > 3 && svg("rect.middle", box),
      own.map(({ i }) => dots.get(i)),
      svg("line.median", { x1: median, x2: median, y1: 2, y2: Gaitcal.LANE - 2 }),
    );
  };
  const axis = () =>
    svg("svg.lane.axis", { width: wide, height: 20, "aria-hidden": "true" },
      Gaitcal.roundTicks(low, high, Math.max(2, Math.min(6, wide / 70))).map((tick) => [
        svg("line.zero", { x1: x(tick.at), x2: x(tick.at), y1: 0, y2: 4 }),
        svg("text", { x: x(tick.at), y: 16, "text-anchor": "middle" }, Gaitcal.numeral(tick.at, tick.digits)),
      ]),
    );
  const fill = () => {
    const inGroups = Gaitcal.grouped(values, ({ i }) => people.groupOf[i]);
    const groups = people.groups.flatMap((group, k) => {
      const own = inGroups.get(group);
      if (!own) return [];
      const quartiles = [0.25, 0.5, 0.75].map((part) => Gaitcal.quantile(own.map(({ value }) => value), part));
      const words = `n ${own.length}, median ${Gaitcal.numeral(quartiles[1], digits)}`;
      return [{ group, k, own, quartiles, words, place: html("div.lane-place") }];
    });
    const told = groups.map(({ group, words }) => `${Gaitcal.visible(group)}: ${words}`);
    lanes.setAttribute("aria-label", `${title}. ${told.join("; ") || "No values"}.`);
    const label = ({ group, words }) => html("div.lane-label", Gaitcal.named(group), html("small", words));
    const nobody = html("p.soft", "Nobody who passes the filters has a value.");
    lanes.replaceChildren(...(groups.length ? groups.flatMap((group) => [label(group), group.place]) : [nobody]));
    wide = Math.max(120, (groups[0]?.place.clientWidth || 400) - 1);
    for (const group of groups) group.place.append(lane(group));
    if (groups.length) lanes.append(html("div"), axis());
  };
  return { root: html("figure.strip", html("figcaption", html("strong", title), off), tip, lanes), fill };
};
