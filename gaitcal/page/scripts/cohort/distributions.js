"use strict";
// Distributions: a dot is a person, a box the middle half of a group, a line its median.
Gaitcal.LANE = 54;
Gaitcal.EDGE = 10;

// Value below which so large a part of sorted values lies.
Gaitcal.quantile = (sorted, part) => {
  const at = part * (sorted.length - 1);
  const [low, high] = [sorted[Math.floor(at)], sorted[Math.ceil(at)]];
  return low + (high - low) * (at - Math.floor(at));
};

Gaitcal.Distributions = class {
  constructor(host, people, choices) {
    Object.assign(this, { people, choices, dirty: true });
    const add = (name) => name && choices.set({ measures: [...choices.measures, name] });
    this.add = Gaitcal.select([], add, { "aria-label": "Add a measure" });
    this.place = html("div.strips");
    host.append(html("div.bar", Gaitcal.legsChoice(choices), Gaitcal.pick("Measure", this.add)), this.place);
    choices.on([...Gaitcal.NARROWING, "legs", "measures"], () => this.draw(true));
    new ResizeObserver(() => this.draw(this.place.clientWidth !== this.wide)).observe(this.place);
    // Thousands of dots are drawn when they are seen.
    const watch = new IntersectionObserver(
      ([{ isIntersecting }]) => {
        this.visible = isIntersecting;
        this.draw(false);
      },
      { rootMargin: "300px" },
    );
    watch.observe(host);
    window.addEventListener("beforeprint", () => this.draw(false, true));
  }

  // What is no longer as it is chosen, where it is seen, or everywhere.
  draw(changed, everywhere = false) {
    this.dirty ||= changed;
    if (!this.dirty || !(this.visible || everywhere)) return;
    this.dirty = false;
    const { choices } = this;
    this.wide = this.place.clientWidth;
    const known = this.people.distributed(choices.legs);
    const others = [...known.values()].filter(({ name }) => !choices.measures.includes(name));
    const words = ({ unit, ...measure }) => Gaitcal.columnWords(measure) + (unit ? ` (${unit})` : "");
    const named = others.map((one) => [one.name, one.legged ? words({ ...one, side: null }) : words(one)]);
    this.add.replaceChildren(new Option("add …", ""), ...named.map(([value, text]) => new Option(text, value)));
    const strips = choices.measures.filter((name) => known.has(name)).map((name) => new Gaitcal.Strip(this, known.get(name)));
    this.place.replaceChildren(...strips.map(({ root }) => root));
    for (const strip of strips) strip.fill();
  }
};

// One measure: a lane for each group.
Gaitcal.Strip = class {
  constructor({ people, choices }, measure) {
    Object.assign(this, { people, choices, measure, now: null });
    const { title, unit, legged, side, name } = measure;
    const legs = { both: "mean of both legs", ...Gaitcal.LEGS }[legged ? choices.legs : side];
    this.title = [title, legs, unit].filter(Boolean).join(", ");
    this.tip = html("p.tip-line", { role: "status" }, "\u00a0");
    const of = ({ target }) => (target.dataset?.i ? Number(target.dataset.i) : null);
    this.lanes = html("div.lanes.strip-lanes", {
      tabindex: "0",
      role: "group",
      pointerover: (event) => of(event) !== null && this.point(of(event)),
      pointerleave: () => this.point(null),
      click: (event) => this.open(of(event), event),
      keydown: (event) => this.pressed(event),
      blur: () => this.point(null),
    });
    const others = () => choices.measures.filter((other) => other !== name);
    const off = Gaitcal.button("✕", () => choices.set({ measures: others() }), {
      class: "off", "aria-label": `Take away ${title}`,
    });
    this.root = html("figure.strip", html("figcaption", html("strong", this.title), off), this.tip, this.lanes);
  }

  fill() {
    const { people, measure } = this;
    const values = this.choices.filtered().map((i) => ({ i, value: measure.at(i) })).filter(({ value }) => Number.isFinite(value));
    values.sort((a, b) => a.value - b.value);
    this.order = values.map(({ i }) => i);
    const [low, high] = values.length ? [values[0].value, values.at(-1).value] : [0, 1];
    const room = 0.04 * (high - low) || Math.abs(high) * 0.05 || 1;
    Object.assign(this, { low: low - room, high: high + room, dots: new Map() });
    const inGroups = Gaitcal.grouped(values, ({ i }) => people.groupOf[i]);
    const groups = people.groups.flatMap((name, k) => {
      const own = inGroups.get(name);
      if (!own) return [];
      const quartiles = [0.25, 0.5, 0.75].map((part) => Gaitcal.quantile(own.map(({ value }) => value), part));
      const words = `n ${own.length}, median ${Gaitcal.numeral(quartiles[1], measure.digits)}`;
      return [{ name, k, own, quartiles, words, place: html("div.lane-place") }];
    });
    const told = groups.map(({ name, words }) => `${Gaitcal.visible(name)}: ${words}`);
    this.lanes.setAttribute("aria-label", `${this.title}. ${told.join("; ") || "No values"}.`);
    const nobody = html("p.soft", "Nobody who passes the filters has a value.");
    const label = ({ name, words }) => html("div.lane-label", Gaitcal.named(name), html("small", words));
    this.lanes.replaceChildren(...groups.flatMap((group) => [label(group), group.place]), ...(groups.length ? [] : [nobody]));
    this.wide = Math.max(120, (groups[0]?.place.clientWidth || 400) - 1);
    for (const group of groups) group.place.append(this.lane(group));
    if (groups.length) this.lanes.append(html("div"), this.axis());
  }

  x(value) {
    return Gaitcal.EDGE + ((value - this.low) / (this.high - this.low)) * (this.wide - 2 * Gaitcal.EDGE);
  }

  lane({ own, k, quartiles }) {
    const [first, median, third] = quartiles.map((value) => this.x(value));
    const box = { x: first, width: Math.max(1, third - first), y: 4, height: Gaitcal.LANE - 8, rx: 3 };
    const radius = own.length > 250 ? 2 : own.length > 60 ? 3 : 4.5;
    // Dots that would lie on each other stand in a pile, closer where there are many.
    const piles = Gaitcal.grouped(own, ({ value }) => Math.round(this.x(value) / (2 * radius)));
    for (const pile of piles.values()) {
      const step = Math.min(2 * radius, (Gaitcal.LANE - 2 * radius - 4) / Math.max(1, pile.length - 1));
      for (const [n, { i, value }] of pile.entries()) {
        const y = Gaitcal.LANE / 2 + (n % 2 ? 1 : -1) * Math.ceil(n / 2) * step;
        const at = { cx: this.x(value).toFixed(1), cy: y.toFixed(1), r: radius, "data-i": i };
        this.dots.set(i, svg(`circle.person.group${k % Gaitcal.GROUP_COLOURS}`, at));
      }
    }
    return svg("svg.lane", { width: this.wide, height: Gaitcal.LANE, "aria-hidden": "true" },
      own.length > 3 && svg("rect.middle", box),
      own.map(({ i }) => this.dots.get(i)),
      svg("line.median", { x1: median, x2: median, y1: 2, y2: Gaitcal.LANE - 2 }),
    );
  }

  axis() {
    const ticks = Gaitcal.roundTicks(this.low, this.high, Math.max(2, Math.min(6, this.wide / 70)));
    return svg("svg.lane.axis", { width: this.wide, height: 20, "aria-hidden": "true" },
      ticks.map(({ at, digits }) => [
        svg("line.zero", { x1: this.x(at), x2: this.x(at), y1: 0, y2: 4 }),
        svg("text", { x: this.x(at), y: 16, "text-anchor": "middle" }, Gaitcal.numeral(at, digits)),
      ]),
    );
  }

  words(i) {
    const { people, measure } = this;
    const value = Gaitcal.numeral(measure.at(i), measure.digits);
    return `${Gaitcal.visible(people.name(i))}: ${value} ${measure.unit} (${Gaitcal.visible(people.word("verdict", i))})`;
  }

  // A dot is pointed at: who it is.
  point(i) {
    this.dots.get(this.now)?.classList.remove("pointed");
    this.now = i;
    const dot = this.dots.get(i);
    dot?.classList.add("pointed");
    this.tip.textContent = dot ? this.words(i) : "\u00a0";
  }

  open(i, event) {
    const link = i !== null && this.people.link(i);
    if (link) window.open(link, event.ctrlKey || event.metaKey ? "_blank" : "_self");
  }

  pressed(event) {
    const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
    const last = this.order.length - 1;
    const here = this.order.indexOf(this.now);
    const next = here < 0 ? (step > 0 ? 0 : last) : Math.min(last, Math.max(0, here + step));
    if (event.key === "Enter" && this.now !== null) this.open(this.now, event);
    else if (event.key === "Escape") this.point(null);
    else if (step && this.order.length) this.point(this.order[next]);
    else return;
    event.preventDefault();
  }
};
