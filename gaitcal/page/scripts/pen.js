"use strict";
// Draws a panel's lines on its canvas. Right is solid, left dashed; nothing is told by colour alone.
Gaitcal.CURVE_COLOURS = ["ink", "soft", "line", "paper", "right", "left", "nominal", "norm", "truth"];
// On paper, whatever the screen has.
Gaitcal.ON_PAPER = {
  ink: "#1d2733", soft: "#5b6875", line: "#d5dbe1", paper: "#ffffff", right: "#0072b2", left: "#d55e00", nominal: "#7a828a",
  norm: "#cc79a7", truth: "#000000",
};

// The colours of the page as it is now, light or dark.
Gaitcal.curveColours = () => {
  const style = window.getComputedStyle(document.documentElement);
  const read = (name) => [name, style.getPropertyValue(`--${name}`).trim() || Gaitcal.ON_PAPER[name]];
  return Object.fromEntries(Gaitcal.CURVE_COLOURS.map(read));
};

Gaitcal.Pen = class {
  // `plot`: a uPlot; `scale`: canvas pixels of one pixel of the page.
  constructor(plot, colours, scale) {
    this.plot = plot;
    this.pen = plot.ctx;
    this.colours = colours;
    this.scale = scale;
    const { left, top, width, height } = plot.bbox;
    const { x, y } = plot.scales;
    this.box = { left, top, width, height };
    this.x = (value) => left + ((value - x.min) / (x.max - x.min)) * width;
    this.y = (value) => top + ((y.max - value) / (y.max - y.min)) * height;
  }

  draw(traces, chosen) {
    const { pen, box } = this;
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top, box.width, box.height);
    pen.clip();
    pen.lineJoin = "round";
    const main = traces.lines.filter(({ weight }) => weight === "main" || weight === "mean");
    for (const band of traces.bands) this.normal(band);
    for (const line of main) if (!line.second && line.sd) this.band(line, line.sd, 0.16);
    if (chosen.errors) for (const line of main) if (!line.second && line.se) this.band(line, line.se, 0.3);
    this.zero();
    this.feet(traces);
    for (const line of traces.lines) this.stroke(line, line.value, { width: line.weight === "thin" ? 0.8 : 0.7, alpha: 0.45, dash: [], valid: false });
    for (const line of traces.lines) if (line.weight === "thin") this.stroke(line, line.value, { width: 0.9, alpha: 0.55 });
    for (const line of main) if (line.nominal) this.stroke(line, line.nominal, { width: 1, colour: "nominal" });
    for (const line of main) this.stroke(line, line.value, { width: line.second ? 1 : 1.9 });
    for (const line of main) if (line.second) this.marks(line);
    for (const line of main) if (line.truth) this.stroke(line, line.truth, { width: 1.5, colour: "truth", dash: [1.5, 3] });
    pen.restore();
  }

  colour(side) {
    return this.colours[{ r: "right", l: "left" }[side] ?? "ink"];
  }

  // A line where it is valid, or where it is not.
  stroke(line, values, { width, alpha = 1, colour = null, dash = null, valid = true }) {
    const { pen, scale } = this;
    pen.globalAlpha = alpha;
    pen.lineWidth = width * scale;
    pen.strokeStyle = colour ? this.colours[colour] : this.colour(line.side);
    pen.setLineDash((dash ?? (line.side === "l" ? [6, 3.5] : [])).map((length) => length * scale));
    pen.beginPath();
    let drawing = false;
    for (let i = 1; i < values.length; i++) {
      const counts = Boolean(line.valid[i - 1] && line.valid[i]);
      if (counts !== valid || Number.isNaN(values[i - 1]) || Number.isNaN(values[i])) drawing = false;
      else {
        if (!drawing) pen.moveTo(this.x(line.x[i - 1]), this.y(values[i - 1]));
        pen.lineTo(this.x(line.x[i]), this.y(values[i]));
        drawing = true;
      }
    }
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  // Around the valid stretches of a line.
  band(line, half, alpha) {
    this.fill(line.x, line.value, half, (i) => line.valid[i], this.colour(line.side), alpha);
  }

  fill(x, middle, half, counts, colour, alpha) {
    const { pen } = this;
    pen.globalAlpha = alpha;
    pen.fillStyle = colour;
    const there = (i) => i < x.length && counts(i) && Number.isFinite(middle[i]) && Number.isFinite(half[i]);
    for (let from = 0; from < x.length; from++) {
      if (!there(from)) continue;
      let to = from;
      while (there(to + 1)) to++;
      pen.beginPath();
      for (let i = from; i <= to; i++) pen.lineTo(this.x(x[i]), this.y(middle[i] + half[i]));
      for (let i = to; i >= from; i--) pen.lineTo(this.x(x[i]), this.y(middle[i] - half[i]));
      pen.fill();
      from = to;
    }
    pen.globalAlpha = 1;
  }

  normal({ mean, sd }) {
    this.fill(Gaitcal.PERCENTS, mean, sd, () => true, this.colours.norm, 0.25);
    const edge = { x: Gaitcal.PERCENTS, valid: new Uint8Array(101).fill(1), side: "" };
    for (const sign of [1, -1]) {
      this.stroke(edge, mean.map((value, i) => value + sign * sd[i]), { width: 1, colour: "norm", dash: [1, 2.5] });
    }
  }

  zero() {
    const { pen, box } = this;
    const y = Math.round(this.y(0)) + 0.5;
    if (y < box.top || y > box.top + box.height) return;
    pen.globalAlpha = 0.6;
    pen.lineWidth = this.scale;
    pen.strokeStyle = this.colours.soft;
    pen.beginPath();
    pen.moveTo(box.left, y);
    pen.lineTo(box.left + box.width, y);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  // Over the cycle a line where stance ends; over time a bar while a foot is on the ground, right above left.
  feet({ offs, stances }) {
    const { pen, box, scale } = this;
    for (const { side, at } of offs) {
      pen.globalAlpha = 0.7;
      pen.lineWidth = scale;
      pen.strokeStyle = this.colour(side);
      pen.setLineDash(side === "l" ? [3 * scale, 3 * scale] : []);
      pen.beginPath();
      pen.moveTo(this.x(at), box.top);
      pen.lineTo(this.x(at), box.top + box.height);
      pen.stroke();
    }
    pen.setLineDash([]);
    pen.globalAlpha = 0.55;
    for (const { side, from, to } of stances) {
      pen.fillStyle = this.colour(side);
      const row = side === "r" ? 7 : 3.5;
      pen.fillRect(this.x(from), box.top + box.height - row * scale, this.x(to) - this.x(from), 2.5 * scale);
    }
    pen.globalAlpha = 1;
  }

  // Rings by which the second result is known.
  marks(line) {
    const { pen, scale } = this;
    pen.lineWidth = scale;
    pen.strokeStyle = this.colour(line.side);
    pen.fillStyle = this.colours.paper;
    const step = Math.max(1, Math.round(line.x.length / 10));
    for (let i = step >> 1; i < line.x.length; i += step) {
      if (!line.valid[i] || Number.isNaN(line.value[i])) continue;
      pen.beginPath();
      pen.arc(this.x(line.x[i]), this.y(line.value[i]), 2.4 * scale, 0, 2 * Math.PI);
      pen.fill();
      pen.stroke();
    }
  }
};
