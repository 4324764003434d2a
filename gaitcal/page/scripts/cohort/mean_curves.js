"use strict";
// The grid of mean curves, its legend, and who lies far from the mean.
Gaitcal.MeanCurves = class {
  constructor(host, people, choices) {
    Object.assign(this, { people, choices, dirty: new Set(), seen: new Set() });
    this.colours = Gaitcal.groupColours();
    const doubtful = Gaitcal.make("input", { type: "checkbox" });
    doubtful.addEventListener("change", () => choices.set({ doubtful: doubtful.checked }));
    this.tick = doubtful;
    this.legend = Gaitcal.make("ul", { class: "mean-legend", "aria-label": "Legend" });
    this.far = Gaitcal.make("div", { class: "far" });
    this.panels = people.curves.map((_, k) => new Gaitcal.MeanPanel(this, k));
    host.append(
      Gaitcal.make(
        "div",
        { class: "bar" },
        Gaitcal.legsChoice(choices),
        Gaitcal.make("label", { class: "tick" }, doubtful, "doubtful legs take part"),
      ),
      this.legend,
      Gaitcal.make("div", { class: "mean-grid" }, ...this.panels.map(({ root }) => root)),
      this.far,
    );
    this.watch = new IntersectionObserver((entries) => this.came(entries), { rootMargin: "200px" });
    for (const { root } of this.panels) this.watch.observe(root);
    this.watch.observe(this.far);
    choices.on([...Gaitcal.NARROWING, "legs", "doubtful"], () => this.stale());
    choices.on(["shown"], () => this.stale(false));
    new ResizeObserver(() => this.stale(false)).observe(host);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.coloured());
    window.addEventListener("beforeprint", () => this.paper(true));
    window.addEventListener("afterprint", () => this.paper(false));
    this.stale();
  }

  // What is drawn again when it is next seen. `people`: whether other people take part.
  stale(people = true) {
    this.tick.checked = this.choices.doubtful;
    this.label();
    for (const panel of this.panels) this.dirty.add(panel.root);
    if (people) this.dirty.add(this.far);
    if (this.later) return;
    this.later = requestAnimationFrame(() => {
      this.later = null;
      this.refresh();
    });
  }

  came(entries) {
    for (const { target, isIntersecting } of entries) isIntersecting ? this.seen.add(target) : this.seen.delete(target);
    this.refresh();
  }

  refresh(all = false) {
    for (const panel of this.panels)
      if (this.dirty.has(panel.root) && (all || this.seen.has(panel.root))) {
        this.dirty.delete(panel.root);
        panel.draw();
      }
    if (this.dirty.has(this.far) && (all || this.seen.has(this.far))) {
      this.dirty.delete(this.far);
      this.farthest();
    }
  }

  coloured() {
    this.colours = Gaitcal.groupColours();
    for (const { plot } of this.panels) plot?.redraw();
  }

  paper(on) {
    document.documentElement.classList.toggle("on-paper", on);
    this.colours = Gaitcal.groupColours();
    if (on) for (const { root } of this.panels) this.dirty.add(root);
    this.refresh(on);
    for (const { plot } of this.panels) plot?.redraw();
  }

  label() {
    const { people, choices } = this;
    const inside = new Set(choices.filtered().map((i) => people.groupOf[i]));
    const key = (k, colour) =>
      Gaitcal.svg(
        "svg",
        { class: "curve-key", width: 34, height: 14, "aria-hidden": "true" },
        colour === "ink" ? null : Gaitcal.svg("rect", { class: `fill-${colour}`, y: 1, width: 34, height: 12 }),
        Gaitcal.svg("line", {
          class: `line-${colour}`,
          x1: 0,
          x2: 34,
          y1: 7,
          y2: 7,
          "stroke-dasharray": k === null ? "1 2.5" : Gaitcal.DASHES[k].join(" ") || null,
        }),
      );
    const item = (mark, ...words) => Gaitcal.make("li", {}, mark, ...words);
    const items = people.groups.flatMap((name, k) =>
      inside.has(name) && k < Gaitcal.GROUP_COLOURS ? [item(key(k, `group${k}`), Gaitcal.named(name))] : [],
    );
    const normal = people.curves.find((curve) => curve.normal)?.normal;
    if (normal)
      items.push(item(key(null, "norm"), Gaitcal.make("span", { title: normal.source }, "normal band, mean ± SD")));
    choices.shown.forEach((i, n) => {
      const off = Gaitcal.make(
        "button",
        { type: "button", class: "off", "aria-label": `No longer draw ${Gaitcal.visible(people.name(i))}` },
        "✕",
      );
      off.addEventListener("click", () => choices.set({ shown: choices.shown.filter((other) => other !== i) }));
      items.push(item(key(n, "ink"), Gaitcal.make("strong", {}, String(n + 1)), this.named(i), off));
    });
    if (people.groups.length > Gaitcal.GROUP_COLOURS)
      items.push(
        item(
          Gaitcal.make("span"),
          `only the first ${Gaitcal.GROUP_COLOURS} of ${people.groups.length} groups are drawn`,
        ),
      );
    this.legend.replaceChildren(...items);
  }

  named(i) {
    const link = this.people.link(i);
    const name = Gaitcal.named(this.people.name(i));
    return link ? Gaitcal.make("a", { href: link }, name) : name;
  }

  farthest() {
    const found = Gaitcal.farthest(this.people, this.choices);
    if (!found.length) return this.far.replaceChildren();
    const items = found.map(({ i, distance }) => {
      const button = Gaitcal.make(
        "button",
        { type: "button" },
        Gaitcal.named(this.people.name(i)),
        Gaitcal.make("span", { class: "soft" }, ` ${Gaitcal.numeral(distance, 1)} SD`),
      );
      button.addEventListener("click", () =>
        this.choices.set({
          shown: [...this.choices.shown.filter((other) => other !== i), i].slice(-Gaitcal.MOST_SHOWN),
        }),
      );
      return Gaitcal.make("li", {}, button);
    });
    this.far.replaceChildren(
      Gaitcal.make("h3", {}, "Farthest from the mean of their group"),
      Gaitcal.make(
        "p",
        { class: "hint" },
        "Root mean square over all curves, in standard deviations between people. Press to draw over the means.",
      ),
      Gaitcal.make("ul", { class: "chips" }, ...items),
    );
  }
};
