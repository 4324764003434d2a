// Headings, sentences and tables that a sheet holds as data, rendered one after the other. Headings never skip a level,
// whatever the blocks say.
Gaitcal.Blocks = class {
  // scope: { page of `page.js`, trial: that of the sheet whose curves are shown, or null, cursors: what follows the
  // clock, wide: px of the paper that curves are drawn for };
  // level, subject: of the heading that stands above.
  constructor(scope, level = 2, subject = "") { Object.assign(this, { scope, level, subject }); }

  all(blocks) {
    const known = (blocks ?? []).filter(({ kind }) => Object.hasOwn(Gaitcal.BLOCKS, kind));
    return known.map((block) => Gaitcal.BLOCKS[block.kind](block, this));
  }

  // Of a part of its own, in which headings come below the present one.
  inside(blocks, subject = this.subject) { return new Gaitcal.Blocks(this.scope, this.level, subject).all(blocks); }

  heading(text, level) {
    this.level = Math.min(level, this.level + 1);
    this.subject = Gaitcal.visible(text);
    return html(`h${this.level}.level${level}`, this.subject);
  }
};

// A cell of a table: a text, or {t, unit, tone, side, note (below the text)}.
Gaitcal.cell = (cell, node) => {
  const { t = "", unit, tone, side, note } = cell !== null && typeof cell === "object" ? cell : { t: cell };
  const shown = Gaitcal.visible(t);
  return Gaitcal.built(node, "", [
    { class: [side && `side-${side}`, tone === "soft" && tone].filter(Boolean).join(" ") },
    tone && tone !== "soft" && shown ? Gaitcal.tag(shown, tone) : shown,
    unit && [" ", html("span.unit", Gaitcal.visible(unit))],
    note && html("small", ` ${Gaitcal.visible(note)}`),
  ]);
};

// Columns that a sheet of paper has no room for unless words are broken.
Gaitcal.MANY = 10;

Gaitcal.table = ({ head = [], rows, caption = null, total = [] }, label = "") => {
  const ofText = (cell, column) => (head[column]?.align === "text" || cell?.align === "text" || !head.length) && "text";
  const top = head.map((cell, column) => {
    const empty = (cell?.t ?? cell) === "";
    const made = html(empty ? "td" : "th", { scope: !empty && "col", class: ofText(cell, column) });
    return Gaitcal.cell(cell, made);
  });
  const filled = (cell, column) =>
    Gaitcal.cell(cell, column ? html("td", { class: ofText(cell, column) }) : html("th", { scope: "row" }));
  return html("table", { "aria-label": !caption && label, class: head.length > Gaitcal.MANY && "many" },
    caption && html("caption", html("span", Gaitcal.visible(caption))),
    top.length > 0 && html("thead", html("tr", top)),
    html("tbody", rows.map((row, index) => html("tr", { class: total?.includes(index) && "total" }, row.map(filled)))),
  );
};

// Kind of a block -> what it becomes. Pictures and curves add theirs.
Gaitcal.BLOCKS = {
  heading: (block, blocks) => blocks.heading(block.text, block.level),

  text: ({ text, tone }) => html("p", { class: tone }, Gaitcal.visible(text)),

  list: ({ items, tone }) => html("ul.plain", { class: tone }, items.map((item) => html("li", Gaitcal.visible(item)))),

  table: (block, blocks) => {
    const label = Gaitcal.visible(block.caption || blocks.subject || "Table");
    const place = Gaitcal.scroller(Gaitcal.table(block, label), label);
    return block.fold ? Gaitcal.fold(block.fold, place) : place;
  },

  pair: ({ left, right }, blocks) =>
    html("div.pair", [left, right].map((half) => html("div", blocks.inside(half)))),

  fold: (block, blocks) => Gaitcal.fold(block.title, blocks.inside(block.blocks, Gaitcal.visible(block.title))),
};
