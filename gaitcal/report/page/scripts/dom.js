"use strict";
// Elements, words and controls: what the pages are built of. Whatever data hold becomes text, never markup.
const Gaitcal = {};

// `html("p.soft", { title: "..." }, child, ...)`: an element with classes, attributes and children. An attribute that is
// null or false is none, a function listens to the event of that name; children that are null or false are none, lists
// are taken apart, strings become text.
const html = (name, ...parts) => Gaitcal.built(document.createElement(name.split(".")[0]), name, parts);
// biome-ignore lint/correctness/noUnusedVariables: for the scripts that follow
const svg = (name, ...parts) =>
  Gaitcal.built(document.createElementNS("http://www.w3.org/2000/svg", name.split(".")[0]), name, parts);

Gaitcal.built = (element, name, parts) => {
  const classes = name.split(".").slice(1);
  if (classes.length) element.setAttribute("class", classes.join(" "));
  for (const part of parts.flat(Infinity)) {
    if (part === null || part === undefined || part === false) continue;
    if (Object.getPrototypeOf(part) === Object.prototype) Gaitcal.dress(element, part);
    else element.append(part);
  }
  return element;
};

Gaitcal.dress = (element, attributes) => {
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") element.addEventListener(key, value);
    else if (key === "class") element.classList.add(...value.split(" ").filter(Boolean));
    else element.setAttribute(key, value === true ? "" : value);
  }
};

Gaitcal.get = (id) => document.getElementById(id);

Gaitcal.button = (words, click, attributes = {}) => html("button", { type: "button", click, ...attributes }, words);

// A box to tick, in its label (`.control` is the box).
Gaitcal.tick = (words, change, attributes = {}) =>
  html("label.tick", html("input", { type: "checkbox", change: ({ target }) => change(target.checked), ...attributes }), words);

// Characters that control the layout or the writing direction are shown as such.
Gaitcal.visible = (text) => String(text ?? "").replace(/[\p{Cc}\p{Cf}\p{Cs}\p{Co}]/gu, "?");

// A name from the study; a very long one is cut, the whole appears on pointing at it.
Gaitcal.named = (text) => {
  const whole = Gaitcal.visible(text);
  const long = whole.length > 60;
  return html("bdi", { title: long && whole }, long ? `${whole.slice(0, 59)}…` : whole);
};

Gaitcal.capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

Gaitcal.count = (number, one, many = `${one}s`) => `${number} ${number === 1 ? one : many}`;

// The digits of tables that come as text: a true minus, thin spaces between thousands, a dash where there is no value.
Gaitcal.numeral = (value, digits = 1, sign = false) => {
  if (!Number.isFinite(value)) return "–";
  const [whole, part] = Math.abs(value).toFixed(digits).split(".");
  const text = whole.replace(/\B(?=(\d{3})+$)/g, "\u202f") + (part ? `.${part}` : "");
  if (Number(value.toFixed(digits)) === 0) return text;
  return (value < 0 ? "−" : sign ? "+" : "") + text;
};

// "0.62 ± 0.04"; without an error that is known, the value alone.
Gaitcal.plusMinus = (value, error, digits) =>
  Gaitcal.numeral(value, digits) + (Number.isFinite(error) ? ` ± ${Gaitcal.numeral(error, digits)}` : "");

// Round numbers within [low, high], about as many as asked for.
Gaitcal.roundTicks = (low, high, count = 5) => {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5].find((factor) => factor * power >= raw) ?? 10);
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
  return out.map((at) => ({ at, digits: Gaitcal.digitsOf(step) }));
};

// As many digits as tell values apart that lie a step from each other.
Gaitcal.digitsOf = (step) => Math.min(4, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));

Gaitcal.TONES = { good: ["✓", "good"], look: ["!", "look at this"], poor: ["✕", "poor"] };

// A word with its tone: its mark says without colour what the colour says; a number without words gets them, unseen.
Gaitcal.tag = (text, tone) => {
  const [mark, words] = Gaitcal.TONES[tone] ?? ["", ""];
  const shown = Gaitcal.visible(text);
  return html("span.tag", { class: words && tone },
    mark && html("span.mark", { "aria-hidden": "true" }, mark),
    shown,
    words && !/\p{L}/u.test(shown) && html("span.unseen", ` (${words})`),
  );
};

// Tables wider than their place are scrolled: only then can they be reached by the keyboard.
Gaitcal.scroller = (table, label) => {
  const place = html("div.scroll", { "data-label": label }, table);
  Gaitcal.widths.observe(place);
  return place;
};

Gaitcal.widths = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    const wide = target.scrollWidth > target.clientWidth + 1;
    target.classList.toggle("wide", wide);
    const reached = { tabindex: "0", role: "group", "aria-label": `${target.dataset.label}: table, scrolls sideways` };
    if (wide) Gaitcal.dress(target, reached);
    else for (const name of Object.keys(reached)) target.removeAttribute(name);
  }
});

Gaitcal.fold = (title, ...children) => html("details", html("summary", Gaitcal.visible(title)), children);

// Key -> the items that have it, in their order.
Gaitcal.grouped = (items, key) => {
  const out = new Map();
  for (const item of items) {
    if (!out.has(key(item))) out.set(key(item), []);
    out.get(key(item)).push(item);
  }
  return out;
};
