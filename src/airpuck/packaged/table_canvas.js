// A craft on its table, seen from above, on a canvas. Everything is given in metres, radians and
// newtons; x points right and y up.
//
//   const table = new TableCanvas(canvas, { view, table, craft, colors });
//   table.resize();                           // at first, and when the canvas has a new size
//   table.clear();                            // the empty table, to draw a frame on:
//   table.drawTrail([[x, y, age], ...]);      // age 0 (now) … 1 (oldest); null breaks the line
//   table.drawPlan([x, ...], [y, ...], color);
//   table.drawSetPoint([x, y, yaw]);
//   table.drawCraft([x, y, yaw], known);      // known false: grey, dashed, "no pose"
//   table.drawThrusts([x, y, yaw], thrustsOf(craft, commands));
//   table.toPixels(x, y), table.toMetres(px, py), table.scale [pixels per metre]
//
// view: [x0, x1, y0, y1], what to show; table: [length, width], or null to leave out the rails;
// craft and colors: as `animation_page.py` writes them.
"use strict";

const TURN = 2 * Math.PI;
const FONT = "12px " + getComputedStyle(document.body).fontFamily;

function write(pen, words, x, y, align, color, widest) {
  pen.font = FONT;
  pen.fillStyle = color;
  pen.textAlign = align;
  pen.textBaseline = "middle";
  pen.fillText(words, x, y, widest);
}
function line(pen, x0, y0, x1, y1, color, width) {
  pen.strokeStyle = color;
  pen.lineWidth = width;
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}
function dot(pen, x, y, r, color) {
  pen.fillStyle = color;
  pen.beginPath();
  pen.arc(x, y, r, 0, TURN);
  pen.fill();
}
function polygon(pen, points) {
  pen.beginPath();
  points.forEach(([px, py], k) => k ? pen.lineTo(px, py) : pen.moveTo(px, py));
  pen.closePath();
}
function multiples(low, high, step) {
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) found.push(k * step);
  return found;
}
function niceStep(range, count) {
  const rough = range / count, power = 10 ** Math.floor(Math.log10(rough));
  return power * [1, 2, 5, 10].find(k => k * power >= rough * (1 - 1e-9));
}
function label(number, step) {
  return number.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "−");
}

// Thrust of each propeller [N] at commands in [0, 1].
function thrustsOf(craft, commands) {
  return commands.map((u, i) => craft.thrust[i].reduceRight((sum, c) => (sum + c) * u, 0));
}
// Outline of an arrow along x [m].
function arrowShape(craft, length) {
  const { shaft, headWidth, headLength } = craft.arrow;
  const size = craft.radius * Math.min(1, length / (1.6 * headLength * craft.radius));
  const neck = length - headLength * size, s = shaft * size, h = headWidth * size;
  return [[0, s], [neck, s], [neck, h], [length, 0], [neck, -h], [neck, -s], [0, -s]];
}

// A canvas with sharp lines, and a layer behind it that is drawn once for each size.
class Board {
  constructor(canvas) {
    Object.assign(this, { canvas, still: document.createElement("canvas") });
    this.pen = canvas.getContext("2d");
  }
  resize() {
    const sharp = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    for (const canvas of [this.canvas, this.still]) {
      canvas.width = Math.max(1, Math.round(this.width * sharp));
      canvas.height = Math.max(1, Math.round(this.height * sharp));
      canvas.getContext("2d").setTransform(sharp, 0, 0, sharp, 0, 0);
    }
    this.drawStill(this.still.getContext("2d"));
  }
  clear() {
    this.pen.clearRect(0, 0, this.width, this.height);
    this.pen.drawImage(this.still, 0, 0, this.width, this.height);
  }
}

// Room for the rails around the view [m], and around both [pixels].
const RAIL = 0.035, EDGE = { left: 34, right: 6, top: 4, bottom: 20 };

class TableCanvas extends Board {
  constructor(canvas, { view, table, craft, colors }) {
    super(canvas);
    Object.assign(this, { view, table, craft, colors });
  }
  toPixels(x, y) {
    return [this.left + x * this.scale, this.top - y * this.scale];
  }
  toMetres(px, py) {
    return [(px - this.left) / this.scale, (this.top - py) / this.scale];
  }
  drawStill(pen) {
    this.place();
    const { scale, colors, table } = this, [x0, x1, y0, y1] = this.view;
    const pad = table ? 0.6 * RAIL : 0;
    pen.beginPath();
    pen.roundRect(...this.toPixels(x0 - pad, y1 + pad), (x1 - x0 + 2 * pad) * scale,
      (y1 - y0 + 2 * pad) * scale, table ? 2 * RAIL * scale : 0);
    pen.fillStyle = colors.floor;
    pen.fill();
    this.drawGrid(pen);
    if (!table) return;
    const [x, y] = this.toPixels(0, 0);
    line(pen, x - 6, y, x + 6, y, colors.rail, 1.5);
    line(pen, x, y - 6, x, y + 6, colors.rail, 1.5);
    pen.beginPath();
    pen.roundRect(...this.toPixels(x0 - pad, y1 + pad), (x1 - x0 + 2 * pad) * scale,
      (y1 - y0 + 2 * pad) * scale, 2 * RAIL * scale);
    pen.strokeStyle = colors.rail;
    pen.lineWidth = Math.max(3, 0.55 * RAIL * scale);
    pen.stroke();
  }
  // Find scale and origin for the size of the canvas.
  place() {
    const [x0, x1, y0, y1] = this.view;
    const wide = x1 - x0 + 2 * RAIL, tall = y1 - y0 + 2 * RAIL;
    const room = this.width - EDGE.left - EDGE.right;
    this.scale = Math.min(room / wide, (this.height - EDGE.top - EDGE.bottom) / tall);
    this.left = EDGE.left + (room - this.scale * wide) / 2 + (RAIL - x0) * this.scale;
    this.top = EDGE.top + (y1 + RAIL) * this.scale;
  }
  drawGrid(pen) {
    const { colors } = this, [x0, x1, y0, y1] = this.view;
    const step = niceStep(Math.max(x1 - x0, y1 - y0), 5);
    const across = multiples(x0, x1, step), up = multiples(y0, y1, step);
    const [left, bottom] = this.toPixels(x0, y0), [right, top] = this.toPixels(x1, y1);
    const below = bottom + RAIL * this.scale + 10, beside = left - RAIL * this.scale;
    for (const at of multiples(x0, x1, step / 5))
      for (const other of multiples(y0, y1, step / 5))
        dot(pen, ...this.toPixels(at, other), 1.1, colors.holes);
    for (const at of across) {
      const [x] = this.toPixels(at, 0);
      line(pen, x, bottom, x, top, colors.grid, 1);
      write(pen, label(at, step), x, below, "center", colors.ink);
    }
    for (const at of up) {
      const [, y] = this.toPixels(0, at);
      line(pen, left, y, right, y, colors.grid, 1);
      write(pen, label(at, step), beside - 5, y, "right", colors.ink);
    }
    // The names of the axes stand between the last two numbers.
    const [x, y] = this.toPixels(across.at(-1) - step / 2, up.at(-1) - step / 2);
    write(pen, "x [m]", x, below, "center", colors.ink);
    pen.save();
    pen.translate(beside - 14, y);
    pen.rotate(-Math.PI / 2);
    write(pen, "y [m]", 0, 0, "center", colors.ink);
    pen.restore();
  }
  // Draw in the body frame of a pose, in metres; `draw` is given the size of a pixel.
  atPose([x, y, yaw], draw) {
    const { pen } = this;
    pen.save();
    pen.translate(...this.toPixels(x, y));
    pen.rotate(-yaw);
    pen.scale(this.scale, -this.scale);
    draw(1 / this.scale);
    pen.restore();
  }
  drawTrail(points) {
    const { inkRgb, floorRgb } = this.colors;
    this.pen.lineCap = "round";
    for (let k = 1; k < points.length; k++) {
      if (!points[k - 1] || !points[k]) continue;
      const [x0, y0] = points[k - 1], [x1, y1, age] = points[k];
      // Opaque, so that overlapping ends do not show.
      const mixed = inkRgb.map((ink, i) => Math.round(ink + (0.1 + 0.9 * age) * (floorRgb[i] - ink)));
      line(this.pen, ...this.toPixels(x0, y0), ...this.toPixels(x1, y1), `rgb(${mixed})`,
        3.2 - 2 * age);
    }
    this.pen.lineCap = "butt";
  }
  drawPlan(x, y, color) {
    const { pen } = this;
    pen.strokeStyle = color;
    pen.lineWidth = 3;
    pen.lineJoin = pen.lineCap = "round";
    pen.beginPath();
    x.forEach((at, k) => pen.lineTo(...this.toPixels(at, y[k])));
    pen.stroke();
    pen.lineCap = "butt";
    dot(pen, ...this.toPixels(x[x.length - 1], y[y.length - 1]), 4, color);
  }
  drawSetPoint(pose) {
    const { pen, craft } = this;
    this.atPose(pose, pixel => {
      pen.strokeStyle = pen.fillStyle = this.colors.asked;
      pen.lineWidth = 2 * pixel;
      pen.setLineDash([6 * pixel, 3.4 * pixel]);
      pen.beginPath();
      pen.arc(0, 0, craft.radius, 0, TURN);
      pen.stroke();
      polygon(pen, craft.mark);
      pen.fill();
    });
  }
  drawCraft(pose, known = true) {
    const { pen, craft, colors } = this;
    this.atPose(pose, pixel => {
      if (!known) pen.setLineDash([4 * pixel, 4 * pixel]);
      dot(pen, 0, 0, craft.radius, "#fff");
      pen.strokeStyle = known ? colors.ink : colors.grey;
      pen.lineWidth = 2 * pixel;
      pen.stroke();
      pen.setLineDash([]);
      pen.fillStyle = colors.ink;
      polygon(pen, craft.mark);
      pen.fill();
      craft.positions.forEach(([px, py], i) => {
        pen.globalAlpha = 0.25;
        dot(pen, px, py, craft.propeller, craft.colors[i]);
        pen.globalAlpha = 1;
        pen.strokeStyle = craft.colors[i];
        pen.lineWidth = pixel;
        pen.stroke();
      });
    });
    const above = this.toPixels(pose[0], pose[1] + 1.4 * craft.radius);
    if (!known) write(pen, "no pose", ...above, "center", colors.grey);
  }
  drawThrusts(pose, thrusts) {
    const { pen, craft } = this;
    this.atPose(pose, pixel => thrusts.forEach((thrust, i) => {
      const [dx, dy] = craft.directions[i];
      pen.save();
      pen.translate(...craft.positions[i]);
      pen.rotate(Math.atan2(dy, dx) + (thrust < 0 ? Math.PI : 0));
      polygon(pen, arrowShape(craft, Math.abs(craft.arrow.scale * thrust)));
      pen.fillStyle = craft.colors[i];
      pen.fill();
      pen.strokeStyle = "#fff";
      pen.lineWidth = 0.6 * pixel;
      pen.stroke();
      pen.restore();
    }));
  }
}
