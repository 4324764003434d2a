// The packed scene, back as numbers. See gaitcal/report/page/scene_file.py for how it was packed.

Gaitcal.bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;

Gaitcal.floats = (text) => new Float32Array(Gaitcal.bytes(text));

// Packed lengths: at(i) is a number, or NaN in a gap.
Gaitcal.Lengths = class {
  constructor({ low, step, data }) { Object.assign(this, { low, step, data: new Int16Array(Gaitcal.bytes(data)) }); }

  at(i) {
    const value = this.data[i];
    return value === Gaitcal.GAP ? NaN : this.low + this.step * (value + Gaitcal.LARGEST);
  }

  all() { return Float32Array.from(this.data, (_, i) => this.at(i)); }
};

// Where x lies in ascending values: the last one at or before it, the next one, and the share of the way to that.
Gaitcal.located = (values, x) => {
  let low = 0;
  let high = values.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] <= x) low = middle;
    else high = middle;
  }
  return { low, high, share: high > low ? (x - values[low]) / (values[high] - values[low]) : 0 };
};

// One trial, read at any time: poses, markers and forces between two frames are interpolated.
Gaitcal.Trial = class {
  constructor(packed, scene) {
    const { name, role, about, valid, tracked, hasForces } = packed;
    Object.assign(this, { packed, name, role, about, valid, tracked, hasForces });
    this.segments = scene.segments.length;
    this.markers = scene.markers.labels.length;
  }

  // Unpacked only when it is first shown, so that many trials cost nothing.
  open() {
    if (this.time) return this;
    const { packed } = this;
    for (const name of ["time", "pelvis", "forces", "centres", "plates"]) this[name] = Gaitcal.floats(packed[name]);
    for (const name of ["origins", "measured"]) this[name] = new Gaitcal.Lengths(packed[name]);
    this.turns = new Int16Array(Gaitcal.bytes(packed.turns));
    this.packed = null;
    return this;
  }

  get duration() { return this.time[this.time.length - 1]; }

  // The frame at or before time t (s from the start), and how far (0..1) it is to the next one.
  frame(t) {
    const { low, high, share } = Gaitcal.located(this.time, t);
    return { low, high, part: Math.min(1, Math.max(0, share)) };
  }

  // Segments and markers are packed relative to the pelvis.
  fromPelvis(at, out) {
    const mixed = (k) => this.pelvis[3 * at.low + k] * (1 - at.part) + this.pelvis[3 * at.high + k] * at.part;
    return out.set(out.x + mixed(0), out.y + mixed(1), out.z + mixed(2));
  }

  origin(at, segment, out) {
    const [a, b] = [3 * (at.low * this.segments + segment), 3 * (at.high * this.segments + segment)];
    const mixed = (k) => this.origins.at(a + k) * (1 - at.part) + this.origins.at(b + k) * at.part;
    return this.fromPelvis(at, out.set(mixed(0), mixed(1), mixed(2)));
  }

  turn(at, segment, out) {
    const [a, b] = [4 * (at.low * this.segments + segment), 4 * (at.high * this.segments + segment)];
    const sign = [0, 1, 2, 3].reduce((sum, k) => sum + this.turns[a + k] * this.turns[b + k], 0) < 0 ? -1 : 1;
    const mixed = (k) => this.turns[a + k] * (1 - at.part) + sign * this.turns[b + k] * at.part;
    return out.set(mixed(0), mixed(1), mixed(2), mixed(3)).normalize();
  }

  // False where the marker was not seen in either frame.
  marker(at, marker, out) {
    const [a, b] = [3 * (at.low * this.markers + marker), 3 * (at.high * this.markers + marker)];
    const found = Gaitcal.between((k) => this.measured.at(a + k), (k) => this.measured.at(b + k), at.part, out);
    if (found) this.fromPelvis(at, out);
    return found;
  }

  force(at, foot, outForce, outCentre) {
    const [a, b] = [3 * (2 * at.low + foot), 3 * (2 * at.high + foot)];
    return (
      Gaitcal.between((k) => this.forces[a + k], (k) => this.forces[b + k], at.part, outForce) &&
      Gaitcal.between((k) => this.centres[a + k], (k) => this.centres[b + k], at.part, outCentre)
    );
  }
};

// Between two points; the nearer one where the other is missing, nothing where the nearer one is missing.
Gaitcal.between = (from, to, part, out) => {
  const [a, b] = [Number.isNaN(from(0)), Number.isNaN(to(0))];
  if (part < 0.5 ? a : b) return false;
  const share = a ? 1 : b ? 0 : part;
  const mixed = (k) => (share === 1 ? to(k) : share === 0 ? from(k) : from(k) * (1 - share) + to(k) * share);
  out.set(mixed(0), mixed(1), mixed(2));
  return true;
};
