"use strict";
// Headings, sentences and tables that a sheet holds as data. Whatever they hold becomes text, never markup.

// An element with its attributes (null or false: none) and children (null: none); strings become text.
Gaitcal.make = (name, attributes = {}, ...children) =>
  Gaitcal.dress(document.createElement(name), attributes, children);

Gaitcal.dress = (element, attributes, children) => {
  for (const [key, value] of Object.entries(attributes))
    if (value !== null && value !== undefined && value !== false)
      element.setAttribute(key, value === true ? "" : value);
  element.append(...children.filter((child) => child !== null));
  return element;
};

// Characters that control the layout or the writing direction are shown as such.
Gaitcal.visible = (text) => String(text ?? "").replace(/[\p{Cc}\p{Cf}\p{Cs}\p{Co}]/gu, "?");

// A name from the study; a very long one is cut, the whole appears on pointing at it.
Gaitcal.named = (text) => {
  const whole = Gaitcal.visible(text);
  const long = whole.length > 60;
  return Gaitcal.make("bdi", { title: long ? whole : null }, long ? `${whole.slice(0, 59)}…` : whole);
};

// The same digits as the tables that come as text: a true minus, thin spaces, a dash where there is no value.
Gaitcal.numeral = (value, digits = 1, sign = false) => {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const [whole, part] = Math.abs(value).toFixed(digits).split(".");
  const text = whole.replace(/\B(?=(\d{3})+$)/g, "\u202f") + (part ? `.${part}` : "");
  if (Number(value.toFixed(digits)) === 0) return text;
  return (value < 0 ? "−" : sign ? "+" : "") + text;
};

Gaitcal.SIDE_WORDS = { r: "right", l: "left" };

Gaitcal.TONES = { good: ["✓", "good"], look: ["!", "look at this"], poor: ["✕", "poor"] };

// A word with its tone: its mark says without colour what the colour says; a number without words gets them, unseen.
Gaitcal.tag = (text, tone) => {
  const [mark, words] = Gaitcal.TONES[tone] ?? ["", ""];
  const shown = Gaitcal.visible(text);
  return Gaitcal.make(
    "span",
    { class: `tag ${words ? tone : ""}` },
    mark ? Gaitcal.make("span", { "aria-hidden": "true", class: "mark" }, mark) : null,
    shown,
    words && !/\p{L}/u.test(shown) ? Gaitcal.make("span", { class: "unseen" }, ` (${words})`) : null,
  );
};

// Tables wider than their place are scrolled: only then can they be reached by the keyboard.
Gaitcal.scroller = (table, label) => {
  const place = Gaitcal.make("div", { class: "scroll", "data-label": label }, table);
  Gaitcal.widths.observe(place);
  return place;
};

Gaitcal.widths = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    const wide = target.scrollWidth > target.clientWidth + 1;
    target.classList.toggle("wide", wide);
    const told = { tabindex: "0", role: "group", "aria-label": `${target.dataset.label}: table, scrolls sideways` };
    for (const [name, value] of Object.entries(told))
      wide ? target.setAttribute(name, value) : target.removeAttribute(name);
  }
});

// Renders blocks one after the other. Headings never skip a level, whatever the blocks say.
Gaitcal.Blocks = class {
  // scope: { page of `page.js`, trial: that of the sheet whose curves are shown, or null, cursors: what follows the
  // clock };
  // level, subject: of the heading that stands above.
  constructor(scope, level = 2, subject = "") {
    Object.assign(this, { scope, level, subject });
  }

  all(blocks) {
    const out = document.createDocumentFragment();
    for (const block of blocks ?? []) {
      const made = Object.hasOwn(Gaitcal.BLOCKS, block.kind) ? Gaitcal.BLOCKS[block.kind](block, this) : null;
      if (made !== null) out.append(made);
    }
    return out;
  }

  // Of a part of its own, in which headings come below the present one.
  inside(blocks, subject = this.subject) {
    return new Gaitcal.Blocks(this.scope, this.level, subject).all(blocks);
  }

  heading(text, level) {
    this.level = Math.min(level, this.level + 1);
    this.subject = Gaitcal.visible(text);
    return Gaitcal.make(`h${this.level}`, { class: `level${level}` }, this.subject);
  }
};

Gaitcal.cell = (cell, node) => {
  const {
    t = "",
    unit = null,
    tone = null,
    side = null,
  } = cell !== null && typeof cell === "object" ? cell : { t: cell };
  if (side) node.classList.add(`side-${side}`);
  if (tone === "soft") node.classList.add("soft");
  const shown = Gaitcal.visible(t);
  node.append(tone && tone !== "soft" && shown ? Gaitcal.tag(shown, tone) : shown);
  if (unit) node.append(" ", Gaitcal.make("span", { class: "unit" }, Gaitcal.visible(unit)));
  return node;
};

// Columns that a sheet of paper has no room for unless words are broken.
Gaitcal.MANY = 10;

Gaitcal.table = ({ head = [], rows, caption = null, total = [] }, label = "") => {
  const texts = head.map((cell) => cell?.align === "text");
  const align = (cell, column) => (texts[column] || cell?.align === "text" || !head.length ? "text" : null);
  const top = head.map((cell, column) => {
    const empty = (typeof cell === "object" ? cell?.t : cell) === "";
    return Gaitcal.cell(
      cell,
      Gaitcal.make(empty ? "td" : "th", { scope: empty ? null : "col", class: align(cell, column) }),
    );
  });
  const body = rows.map((row, index) =>
    Gaitcal.make(
      "tr",
      { class: total?.includes(index) ? "total" : null },
      ...row.map((cell, column) =>
        Gaitcal.cell(
          cell,
          column ? Gaitcal.make("td", { class: align(cell, column) }) : Gaitcal.make("th", { scope: "row" }),
        ),
      ),
    ),
  );
  return Gaitcal.make(
    "table",
    { "aria-label": caption || !label ? null : label, class: head.length > Gaitcal.MANY ? "many" : null },
    caption ? Gaitcal.make("caption", {}, Gaitcal.make("span", {}, Gaitcal.visible(caption))) : null,
    top.length ? Gaitcal.make("thead", {}, Gaitcal.make("tr", {}, ...top)) : null,
    Gaitcal.make("tbody", {}, ...body),
  );
};

Gaitcal.fold = (title, ...children) =>
  Gaitcal.make("details", {}, Gaitcal.make("summary", {}, Gaitcal.visible(title)), ...children);

// Kind of a block -> what it becomes. Pictures and curves add theirs.
Gaitcal.BLOCKS = {
  heading: (block, blocks) => blocks.heading(block.text, block.level),

  text: ({ text, tone }) => Gaitcal.make("p", { class: tone ?? null }, Gaitcal.visible(text)),

  list: ({ items, tone }) =>
    Gaitcal.make(
      "ul",
      { class: `plain ${tone ?? ""}` },
      ...items.map((item) => Gaitcal.make("li", {}, Gaitcal.visible(item))),
    ),

  table: (block, blocks) => {
    const label = Gaitcal.visible(block.caption || blocks.subject || "Table");
    const place = Gaitcal.scroller(Gaitcal.table(block, label), label);
    return block.fold ? Gaitcal.fold(block.fold, place) : place;
  },

  cards: ({ cards }) =>
    Gaitcal.make(
      "ul",
      { class: "cards" },
      ...cards.map(({ question, value, verdict, tone, text }) =>
        Gaitcal.make(
          "li",
          { class: `card ${tone}` },
          Gaitcal.make("p", { class: "question" }, Gaitcal.visible(question)),
          Gaitcal.make(
            "p",
            { class: "value" },
            Gaitcal.visible(value),
            " ",
            verdict ? Gaitcal.tag(verdict, tone) : null,
          ),
          Gaitcal.make("p", {}, Gaitcal.visible(text)),
        ),
      ),
    ),

  pair: ({ left, right }, blocks) => {
    const [first, second] = [left, right].map((half) => Gaitcal.make("div", {}, blocks.inside(half)));
    return Gaitcal.make("div", { class: "pair" }, first, second);
  },

  fold: (block, blocks) => Gaitcal.fold(block.title, blocks.inside(block.blocks, Gaitcal.visible(block.title))),
};
