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
    window.addEventListener("keydown", (event) => this.pressed(event));
  }

  // What each key does; those of curves only where there are curves.
  bindings() {
    const { page, state } = this;
    const step = (frames) => ({ shiftKey }) => page.clock.step(frames * (shiftKey ? 10 : 1));
    const end = (k) => () => state.set({ seconds: (state.window ?? [0, page.trial.duration])[k] });
    const faster = (by) => () => {
      const here = Gaitcal.SPEEDS.indexOf(state.speed) + by;
      state.set({ speed: Gaitcal.SPEEDS[Math.min(Gaitcal.SPEEDS.length - 1, Math.max(0, here))] });
    };
    const turn = (field) => () => state.set({ [field]: !state[field] });
    const presets = Object.keys(Gaitcal.PRESETS).map((preset, k) => [k + 1, () => state.set({ preset })]);
    const always = {
      " ": () => page.clock.play(),
      ArrowRight: step(1),
      ArrowLeft: step(-1),
      Home: end(0),
      End: end(1),
      "[": () => page.timeline.begin(),
      "]": () => page.timeline.end(),
      "\\": () => state.set({ window: null }),
      "+": faster(1),
      "=": faster(1),
      "-": faster(-1),
      j: () => this.nextJoint(),
      Escape: () => (state.joint !== null ? state.set({ joint: null }) : page.controls.legend(false)),
      "?": () => this.dialog.showModal(),
    };
    const gait = {
      ...Object.fromEntries(presets),
      p: () => state.set({ axis: state.axis === "time" ? "percent" : "time" }),
      n: turn("nominal"),
      b: turn("norm"),
      e: turn("errors"),
      t: turn("truth"),
    };
    return new Map(Object.entries(page.bare ? always : { ...always, ...gait }));
  }

  pressed(event) {
    if (event.defaultPrevented || event.ctrlKey || event.altKey || event.metaKey || this.dialog.open) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (this.taken(event.target, key) || (key.length === 1 && key !== " " && !this.single.checked)) return;
    const action = this.bound.get(key);
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

  // Hip, knee, ankle of the right leg, then of the left, then the whole body again.
  nextJoint() {
    const all = ["r", "l"].flatMap((side) => ["hip", "knee", "ankle"].map((name) => `${name}_${side}`));
    const here = all.filter((joint) => this.page.stage.figure.joints.has(joint));
    this.state.set({ joint: here[here.indexOf(this.state.joint) + 1] ?? null });
  }
};
