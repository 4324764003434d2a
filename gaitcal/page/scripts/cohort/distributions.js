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
    Object.assign(this, { people, choices });
    this.add = Gaitcal.make("select", { "aria-label": "Add a measure" });
    this.add.addEventListener("change", () => {
      if (this.add.value) choices.set({ measures: [...choices.measures, this.add.value] });
    });
    this.place = Gaitcal.make("div", { class: "strips" });
    host.append(
      Gaitcal.make(
        "div",
        { class: "bar" },
        Gaitcal.legsChoice(choices),
        Gaitcal.make("label", { class: "pick" }, Gaitcal.make("span", {}, "Measure"), this.add),
      ),
      this.place,
    );
    choices.on([...Gaitcal.NARROWING, "legs", "measures"], () => this.stale());
    new ResizeObserver(() => this.place.clientWidth !== this.wide && this.stale()).observe(this.place);
    // Thousands of dots are drawn when they are seen.
    new IntersectionObserver(([{ isIntersecting }]) => this.seen(isIntersecting), { rootMargin: "300px" }).observe(
      host,
    );
    window.addEventListener("beforeprint", () => this.dirty && this.draw());
    this.dirty = true;
  }

  stale() {
    this.dirty = true;
    if (this.visible) this.draw();
  }

  seen(visible) {
    this.visible = visible;
    if (visible && this.dirty) this.draw();
  }

  draw() {
    this.dirty = false;
    const { choices } = this;
    this.wide = this.place.clientWidth;
    this.known = Gaitcal.distributed(this.people, choices.legs);
    const others = [...this.known.values()].filter(({ name }) => !choices.measures.includes(name));
    this.add.replaceChildren(
      Gaitcal.make("option", { value: "" }, "add …"),
      ...others.map((measure) =>
        Gaitcal.make(
          "option",
          { value: measure.name },
          `${Gaitcal.columnWords(measure)}${measure.unit ? ` (${measure.unit})` : ""}`,
        ),
      ),
    );
    const chosen = choices.measures.filter((name) => this.known.has(name));
    this.place.replaceChildren(...chosen.map((name) => new Gaitcal.Strip(this, this.known.get(name)).root));
    for (const figure of this.place.children) figure.fill();
  }
};

// One measure: a lane for each group.
Gaitcal.Strip = class {
  constructor(owner, measure) {
    Object.assign(this, { people: owner.people, choices: owner.choices, measure });
    const off = Gaitcal.make(
      "button",
      { type: "button", class: "off", "aria-label": `Take away ${measure.title}` },
      "✕",
    );
    off.addEventListener("click", () =>
      this.choices.set({ measures: this.choices.measures.filter((name) => name !== measure.name) }),
    );
    const legs = measure.legged
      ? { both: ", mean of both legs", r: ", right", l: ", left" }[this.choices.legs]
      : measure.side
        ? `, ${Gaitcal.SIDE_WORDS[measure.side]}`
        : "";
    this.title = `${measure.title}${legs}${measure.unit ? `, ${measure.unit}` : ""}`;
    this.tip = Gaitcal.make("p", { class: "tip-line", role: "status" }, "\u00a0");
    this.lanes = Gaitcal.make("div", { class: "lanes strip-lanes", tabindex: "0", role: "group" });
    this.root = Gaitcal.make(
      "figure",
      { class: "strip" },
      Gaitcal.make("figcaption", {}, Gaitcal.make("strong", {}, this.title), off),
      this.tip,
      this.lanes,
    );
    this.root.fill = () => this.fill();
    this.lanes.addEventListener(
      "pointerover",
      ({ target }) => target.dataset?.i && this.point(Number(target.dataset.i)),
    );
    this.lanes.addEventListener("pointerleave", () => this.point(null));
    this.lanes.addEventListener(
      "click",
      (event) => event.target.dataset?.i && this.open(Number(event.target.dataset.i), event),
    );
    this.lanes.addEventListener("keydown", (event) => this.pressed(event));
    this.lanes.addEventListener("blur", () => this.point(null));
  }

  fill() {
    const values = this.choices
      .filtered()
      .map((i) => ({ i, value: this.measure.at(i) }))
      .filter(({ value }) => Number.isFinite(value));
    values.sort((a, b) => a.value - b.value);
    this.order = values.map(({ i }) => i);
    const [low, high] = values.length ? [values[0].value, values[values.length - 1].value] : [0, 1];
    const room = 0.04 * (high - low) || Math.abs(high) * 0.05 || 1;
    this.low = low - room;
    this.high = high + room;
    const groups = this.people.groups
      .map((name) => [name, values.filter(({ i }) => this.people.groupOf[i] === name)])
      .filter(([, own]) => own.length);
    const digits = this.measure.digits ?? 2;
    const told = groups.map(
      ([name, own]) =>
        `${Gaitcal.visible(name)}: n ${own.length}, median ${Gaitcal.numeral(
          Gaitcal.quantile(
            own.map(({ value }) => value),
            0.5,
          ),
          digits,
        )}`,
    );
    this.lanes.setAttribute("aria-label", `${this.title}. ${told.join("; ") || "No values"}.`);
    this.dots = new Map();
    const label = (name, own) =>
      Gaitcal.make(
        "div",
        { class: "lane-label" },
        Gaitcal.named(name),
        Gaitcal.make(
          "small",
          {},
          `n ${own.length}, median ${Gaitcal.numeral(
            Gaitcal.quantile(
              own.map(({ value }) => value),
              0.5,
            ),
            digits,
          )}`,
        ),
      );
    this.lanes.replaceChildren(
      ...groups.flatMap(([name, own]) => [label(name, own), Gaitcal.make("div", { class: "lane-place" })]),
    );
    const places = [...this.lanes.querySelectorAll(".lane-place")];
    this.wide = Math.max(120, (places[0]?.clientWidth || 400) - 1);
    groups.forEach(([name, own], k) => {
      places[k].append(this.lane(own, this.people.groups.indexOf(name)));
    });
    if (groups.length) this.lanes.append(Gaitcal.make("div"), this.axis());
    else this.lanes.append(Gaitcal.make("p", { class: "soft" }, "Nobody who passes the filters has a value."));
  }

  x(value) {
    return Gaitcal.EDGE + ((value - this.low) / (this.high - this.low)) * (this.wide - 2 * Gaitcal.EDGE);
  }

  lane(own, k) {
    const sorted = own.map(({ value }) => value);
    const svg = Gaitcal.svg("svg", { class: "lane", width: this.wide, height: Gaitcal.LANE, "aria-hidden": "true" });
    const [first, median, third] = [0.25, 0.5, 0.75].map((part) => this.x(Gaitcal.quantile(sorted, part)));
    if (own.length > 3)
      svg.append(
        Gaitcal.svg("rect", {
          class: "middle",
          x: first,
          width: Math.max(1, third - first),
          y: 4,
          height: Gaitcal.LANE - 8,
          rx: 3,
        }),
      );
    const radius = own.length > 250 ? 2 : own.length > 60 ? 3 : 4.5;
    // Dots that would lie on each other stand in a pile, closer where there are many.
    const piles = new Map();
    for (const entry of own) {
      const bin = Math.round(this.x(entry.value) / (2 * radius));
      if (!piles.has(bin)) piles.set(bin, []);
      piles.get(bin).push(entry);
    }
    for (const pile of piles.values()) {
      const step = Math.min(2 * radius, (Gaitcal.LANE - 2 * radius - 4) / Math.max(1, pile.length - 1));
      pile.forEach(({ i, value }, n) => {
        const y = Gaitcal.LANE / 2 + (n % 2 ? 1 : -1) * Math.ceil(n / 2) * step;
        const dot = Gaitcal.svg("circle", {
          class: `person group${k % Gaitcal.GROUP_COLOURS}`,
          cx: this.x(value).toFixed(1),
          cy: y.toFixed(1),
          r: radius,
          "data-i": i,
        });
        this.dots.set(i, dot);
        svg.append(dot);
      });
    }
    svg.append(Gaitcal.svg("line", { class: "median", x1: median, x2: median, y1: 2, y2: Gaitcal.LANE - 2 }));
    return svg;
  }

  axis() {
    const svg = Gaitcal.svg("svg", { class: "lane axis", width: this.wide, height: 20, "aria-hidden": "true" });
    for (const { at, digits } of Gaitcal.roundTicks(this.low, this.high, Math.max(2, Math.min(6, this.wide / 70)))) {
      svg.append(
        Gaitcal.svg("line", { class: "zero", x1: this.x(at), x2: this.x(at), y1: 0, y2: 4 }),
        Gaitcal.svg("text", { x: this.x(at), y: 16, "text-anchor": "middle" }, Gaitcal.numeral(at, digits)),
      );
    }
    return svg;
  }

  words(i) {
    const { people, measure } = this;
    const value = Gaitcal.numeral(measure.at(i), measure.digits ?? 2);
    return `${Gaitcal.visible(people.name(i))}: ${value} ${measure.unit} (${Gaitcal.visible(people.word("verdict", i))})`;
  }

  // A dot is pointed at: who it is.
  point(i) {
    this.dots.get(this.now)?.classList.remove("pointed");
    this.now = i;
    const dot = i === null ? null : this.dots.get(i);
    dot?.classList.add("pointed");
    this.tip.textContent = dot ? this.words(i) : "\u00a0";
  }

  open(i, event) {
    const link = this.people.link(i);
    if (link) window.open(link, event.ctrlKey || event.metaKey ? "_blank" : "_self");
  }

  pressed(event) {
    const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
    if (event.key === "Enter" && this.now !== null && this.now !== undefined) this.open(this.now, event);
    else if (event.key === "Escape") this.point(null);
    else if (step && this.order.length) {
      const here = this.order.indexOf(this.now);
      this.point(
        this.order[
          here < 0 ? (step > 0 ? 0 : this.order.length - 1) : Math.min(this.order.length - 1, Math.max(0, here + step))
        ],
      );
    } else return;
    event.preventDefault();
  }
};

// Which legs pictures are of: one choice for distributions and curves.
Gaitcal.legsChoice = (choices) => {
  const options = [
    ["both", "mean of both"],
    ["r", "right"],
    ["l", "left"],
  ].map(([value, words]) => Gaitcal.make("option", { value }, words));
  const select = Gaitcal.make("select", {}, ...options);
  const write = () => {
    select.value = choices.legs;
  };
  select.addEventListener("change", () => choices.set({ legs: select.value }));
  choices.on(["legs"], write);
  write();
  return Gaitcal.make("label", { class: "pick" }, Gaitcal.make("span", {}, "Legs"), select);
};
