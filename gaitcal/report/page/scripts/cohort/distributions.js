// Distributions: a dot is a person, a box the middle half of a group, a line its median.
Gaitcal.LANE = 54; // px high
Gaitcal.LANE_WIDE = 380; // px, about: dots that are nearer than their size in it stand in a pile

// Value below which so large a part of sorted values lies.
Gaitcal.quantile = (sorted, part) => {
  const at = part * (sorted.length - 1);
  const [low, high] = [sorted[Math.floor(at)], sorted[Math.ceil(at)]];
  return low + (high - low) * (at - Math.floor(at));
};

Gaitcal.distributions = (host, people, choices) => {
  const place = host.querySelector(".strips");
  const add = Gaitcal.get("add");
  let [dirty, visible] = [true, false];
  // What is no longer as it is chosen, where it is seen, or everywhere: thousands of dots are drawn when they are seen.
  const draw = (changed, everywhere = false) => {
    dirty ||= changed;
    if (!dirty || !(visible || everywhere)) return;
    dirty = false;
    const known = people.distributed(choices.legs);
    const others = [...known.values()].filter(({ name }) => !choices.measures.includes(name));
    const words = ({ legged, title, side, unit }) =>
      Gaitcal.columnWords({ title, side: legged ? null : side }) + (unit ? ` (${unit})` : "");
    add.replaceChildren(new Option("add …", ""), ...others.map((measure) => new Option(words(measure), measure.name)));
    const chosen = choices.measures.filter((name) => known.has(name));
    place.replaceChildren(...chosen.map((name) => Gaitcal.strip(people, choices, known.get(name))));
  };
  add.addEventListener("change", () => add.value && choices.set({ measures: [...choices.measures, add.value] }));
  choices.on([...Gaitcal.NARROWING, "legs", "measures"], () => draw(true));
  const came = ([{ isIntersecting }]) => {
    visible = isIntersecting;
    draw(false);
  };
  new IntersectionObserver(came, { rootMargin: "300px" }).observe(host);
  window.addEventListener("beforeprint", () => draw(false, true));
};

// One measure: a lane for each group.
Gaitcal.strip = (people, choices, measure) => {
  const { name, legged, digits, unit } = measure;
  const legs = { both: "mean of both legs", ...Gaitcal.LEGS }[legged ? choices.legs : measure.side];
  const title = [measure.title, legs, unit].filter(Boolean).join(", ");
  const values = choices.filtered().map((i) => ({ i, value: measure.at(i) })).filter(({ value }) => Number.isFinite(value));
  values.sort((a, b) => a.value - b.value);
  const axis = new Gaitcal.Axis(values.map(({ value }) => value), {});
  const dots = new Map();
  let now = null;

  // Who a dot is that is pointed at.
  const point = (i) => {
    dots.get(now)?.classList.remove("pointed");
    now = i;
    dots.get(i)?.classList.add("pointed");
    const words = () => `${people.name(i)}: ${Gaitcal.numeral(measure.at(i), digits)} ${unit} (${people.word("verdict", i)})`;
    tip.textContent = dots.has(i) ? Gaitcal.visible(words()) : "\u00a0";
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

  const lane = (own, k, quartiles) => {
    const [first, median, third] = quartiles;
    const radius = own.length > 250 ? 2 : own.length > 60 ? 3 : 4.5;
    const pile = ({ value }) => Math.round((axis.share(value) * Gaitcal.LANE_WIDE) / (2 * radius));
    // Dots that would lie on each other stand in a pile, closer where there are many.
    for (const one of Gaitcal.grouped(own, pile).values()) {
      const step = Math.min(2 * radius, (Gaitcal.LANE - 2 * radius - 4) / Math.max(1, one.length - 1));
      for (const [n, { i, value }] of one.entries()) {
        const cy = (Gaitcal.LANE / 2 + (n % 2 ? 1 : -1) * Math.ceil(n / 2) * step).toFixed(1);
          const style = `fill: var(--group${k % Gaitcal.GROUP_COLOURS})`;
        dots.set(i, svg("circle.person", { cx: axis.at(value), cy, r: radius, style, "data-i": i }));
      }
    }
    const box = { x: axis.at(first), width: axis.width(first, third), y: 4, height: Gaitcal.LANE - 8, rx: 3 };
    return axis.lane(Gaitcal.LANE,
      own.length > 3 && svg("rect.middle", box),
      own.map(({ i }) => dots.get(i)),
      axis.line("median", median, median, 2, Gaitcal.LANE - 2),
    );
  };
  const inGroups = Gaitcal.grouped(values, ({ i }) => people.groupOf[i]);
  const groups = people.groups.filter((group) => inGroups.has(group)).map((group) => {
    const own = inGroups.get(group);
    const quartiles = [0.25, 0.5, 0.75].map((part) => Gaitcal.quantile(own.map(({ value }) => value), part));
    const words = `n ${own.length}, median ${Gaitcal.numeral(quartiles[1], digits)}`;
    const label = html("div.lane-label", Gaitcal.named(group), html("small", words));
    const drawn = lane(own, people.groups.indexOf(group), quartiles);
    return { told: `${Gaitcal.visible(group)}: ${words}`, parts: [label, drawn] };
  });
  const nobody = html("p.soft", "No person who passes the filters has a value.");
  const of = ({ target }) => (target.dataset?.i ? Number(target.dataset.i) : null);
  const told = groups.map((group) => group.told).join("; ") || "No values";
  const lanes = html("div.lanes.strip-lanes",
    {
      tabindex: "0", role: "group", "aria-label": `${title}. ${told}.`, keydown: pressed,
      pointerover: (event) => of(event) !== null && point(of(event)), pointerleave: () => point(null),
      click: (event) => open(of(event), event), blur: () => point(null),
    },
    groups.length ? [groups.map(({ parts }) => parts), html("div"), axis.foot()] : nobody,
  );
  const tip = html("p.tip-line", { role: "status" }, "\u00a0");
  const gone = () => choices.set({ measures: choices.measures.filter((other) => other !== name) });
  const off = Gaitcal.button("✕", gone, { class: "off", "aria-label": `Take away ${measure.title}` });
  return html("figure.strip", html("figcaption", html("strong", title), off), tip, lanes);
};
