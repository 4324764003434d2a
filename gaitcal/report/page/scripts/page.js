// Everything together: the result, what is chosen of it, and all that draws.
Gaitcal.Page = class {
  // `result`: {scene, sheet: null on the page of a bare scene}, as the page holds them.
  constructor(result) {
    this.result = result;
    this.trials = result.scene.trials.map((packed) => new Gaitcal.Trial(packed, result.scene));
    this.bare = result.sheet === null;
    Gaitcal.get("main").classList.toggle("bare", this.bare);
    for (const part of document.querySelectorAll(".gait")) part.hidden = this.bare;
    this.state = new Gaitcal.State(this);
    this.clock = Gaitcal.clock(this);
    this.stage = this.staged();
    this.timeline = Gaitcal.timeline(this);
    this.controls = Gaitcal.controls(this);
    Gaitcal.keys(this);
    if (!this.bare) this.parts();
    Gaitcal.bind(this.state);
    // A joint that the address names is looked at once everything below has its place.
    if (!this.bare) requestAnimationFrame(() => this.curves.reveal(false));
    this.state.on(["trial"], () => this.titled());
    this.titled();
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.clock.play(!still && !this.state.still);
  }

  // The body in motion; null, told in its place, where the browser draws nothing in space: all else is there without it.
  staged() {
    try {
      return new Gaitcal.Stage(this);
    } catch (error) {
      Gaitcal.get("main").classList.add("flat");
      Gaitcal.failed(`The body in motion is not drawn: this browser has no WebGL (${error.message}).`);
      return null;
    }
  }

  // What the page of a result has beside the body, each in its place in the page.
  parts() {
    const { get } = Gaitcal;
    Gaitcal.presets(get("presets"), this);
    Gaitcal.switches(get("switches"), this);
    Gaitcal.verdict(get("verdict"), this);
    this.curves = new Gaitcal.Curves(get("curves"), this);
    Gaitcal.steps(get("steps"), this);
    Gaitcal.counting(get("counting"), this);
    Gaitcal.sections(get("sections"), this);
    this.events = Gaitcal.events(this);
    this.comments = Gaitcal.comments(get("comments"), this);
    this.print = Gaitcal.print(get("print"), this);
  }

  get trial() { return this.trials[this.state.trial].open(); }

  // The curves and tables of the shown trial; null on a page of a bare scene.
  get sheet() { return this.result.sheet?.trials[this.state.trial] ?? null; }

  titled() {
    const { scene } = this.result;
    document.title = `${scene.subject} \u00b7 ${this.trial.name}`;
    Gaitcal.get("subject").textContent = scene.subject;
  }
};

Gaitcal.failed = (words) => {
  const failure = Gaitcal.get("failure");
  failure.hidden = false;
  failure.textContent = words;
};

(() => {
  try {
    window.gaitcal = new Gaitcal.Page(JSON.parse(Gaitcal.get("result").textContent));
  } catch (error) {
    Gaitcal.failed(`This page could not be drawn (${error.message}).`);
    throw error;
  }
})();
