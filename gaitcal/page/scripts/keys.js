"use strict";
// The keyboard, and the dialog that tells its keys.
Gaitcal.Keys = class {
  constructor(page) {
    this.page = page;
    this.state = page.state;
    this.dialog = Gaitcal.get("keys");
    Gaitcal.get("help").addEventListener("click", () => this.dialog.showModal());
    Gaitcal.get("keys-close").addEventListener("click", () => this.dialog.close());
    this.single = Gaitcal.get("keys-on"); // who speaks to the computer may not want keys of one letter
    this.bound = this.bindings();
    this.write();
    window.addEventListener("keydown", (event) => this.pressed(event));
  }

  // [keys, what they do, action]; those of curves only where there are curves.
  bindings() {
    const { page, state } = this;
    const { clock } = page;
    const turn = (field) => () => state.set({ [field]: !state[field] });
    const always = [
      [[" "], "Space", "play, pause", () => clock.play()],
      [["ArrowRight", "ArrowLeft"], "\u2190 \u2192", "one frame; with Shift ten", (event) => this.step(event)],
      [["Home", "End"], "Home, End", "begin and end, of the window where there is one", (event) => this.end(event.key === "End")],
      [["[", "]"], "[ ]", "the looped window begins, ends here", (event) => this.loop(event.key)],
      [["\\"], "\\", "no window", () => state.set({ window: null })],
      [["+", "=", "-"], "+ \u2212", "faster, slower", (event) => this.faster(event.key === "-" ? -1 : 1)],
      [["j"], "J", "come near the next joint", () => this.nextJoint()],
      [["Escape"], "Esc", "back to the whole body; close the layers", () => this.escape()],
      [["?"], "?", "these keys", () => this.dialog.showModal()],
    ];
    const titles = Gaitcal.PRESETS.map(({ title }) => title);
    const gait = [
      [["1", "2", "3", "4", "5"], "1 \u2026 5", titles.join(", "), (event) => this.preset(event.key)],
      [["p"], "P", "% of the gait cycle or time", () => state.set({ axis: state.axis === "time" ? "percent" : "time" })],
      [["n"], "N", "nominal model", turn("nominal")],
      [["b"], "B", "norm band", turn("norm")],
      [["e"], "E", "error bands", turn("errors")],
      [["t"], "T", "truth of a synthetic person", turn("truth")],
    ];
    return page.bare ? always : [...always, ...gait];
  }

  write() {
    const rows = this.bound.map(([, keys, what]) => [html("dt", html("kbd", keys)), html("dd", what)]);
    Gaitcal.get("keys-list").replaceChildren(...rows.flat());
  }

  pressed(event) {
    if (event.defaultPrevented || event.ctrlKey || event.altKey || event.metaKey || this.dialog.open) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (this.taken(event.target, key) || (key.length === 1 && key !== " " && !this.single.checked)) return;
    const [, , , action] = this.bound.find(([keys]) => keys.includes(key)) ?? [];
    if (!action) return;
    action(event);
    event.preventDefault();
  }

  // Whether what has the focus needs the key itself. The time slider does not: its arrows step as everywhere.
  taken(target, key) {
    if (key === "Escape" || !(target instanceof Element) || target.id === "time") return false;
    if (target.closest("select, textarea, input:not([type=checkbox]):not([type=radio])")) return true;
    if (target.closest("input, button, summary, a, [role=tab]")) return [" ", "Enter"].includes(key);
    const scrolls = target.closest("[tabindex]") !== null && target.scrollHeight > target.clientHeight + 1;
    return scrolls && ["Home", "End", " "].includes(key);
  }

  step(event) {
    this.page.clock.step((event.key === "ArrowRight" ? 1 : -1) * (event.shiftKey ? 10 : 1));
  }

  end(last) {
    const [from, to] = this.state.window ?? [0, this.page.trial.duration];
    this.state.set({ seconds: last ? to : from });
  }

  loop(bracket) {
    if (bracket === "[") this.page.timeline.begin();
    else this.page.timeline.end();
  }

  faster(by) {
    const here = Gaitcal.SPEEDS.indexOf(this.state.speed);
    this.state.set({ speed: Gaitcal.SPEEDS[Math.min(Gaitcal.SPEEDS.length - 1, Math.max(0, here + by))] });
  }

  preset(key) {
    this.state.set({ preset: Gaitcal.PRESETS[Number(key) - 1].name });
  }

  // Hip, knee, ankle of the right leg, then of the left, then the whole body again.
  nextJoint() {
    const all = ["r", "l"].flatMap((side) => ["hip", "knee", "ankle"].map((name) => `${name}_${side}`));
    const here = all.filter((joint) => this.page.stage.figure.joints.has(joint));
    this.state.set({ joint: here[here.indexOf(this.state.joint) + 1] ?? null });
  }

  escape() {
    if (this.state.joint !== null) this.state.set({ joint: null });
    else this.page.controls.legend(false);
  }
};
