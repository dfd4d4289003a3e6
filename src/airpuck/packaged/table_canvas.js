// A craft on its table, seen from above, on a canvas; and a game of air hockey. Everything is given in
// metres, radians and newtons; x points right and y up.
//
//   const table = new TableCanvas(canvas, { view, table, craft, colors, hockey, bare });
//   table.resize();                           // at first, and when the canvas has a new size
//   table.clear();                            // the empty table, to draw a frame on:
//   table.drawTrail([[x, y, age], ...]);      // age 0 (now) … 1 (oldest); null breaks the line
//   table.drawPlan([x, ...], [y, ...], color);
//   table.drawSetPoint([x, y, yaw]);
//   table.drawCraft([x, y, yaw], known, color);   // known false: grey, dashed, "no pose"
//   table.drawThrusts([x, y, yaw], thrustsOf(craft, commands));
//   table.drawPuck([x, y, yaw]), table.drawMallet([x, y], color);
//   table.drawPath([[x, y], ...], color);     // where something is expected to go; it fades
//   table.drawIntention({ words, meet, path });   // meet: where the puck will be touched, [x, y] or
//                                             // null; path: where it goes then, as above or null
//   table.toPixels(x, y), table.toMetres(px, py), table.scale [pixels per metre]
//
// view: [x0, x1, y0, y1], what to show; table: [length, width], or null to leave out the rails;
// craft, colors and hockey: as `table_canvas.py` writes them; without hockey there are no goals, puck
// and mallet. bare: neither axes nor grid. table.tall = true, before resize: a quarter turn, so that x
// points down; bare only.
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

// Room for the rails around the view and for the goals behind them [m], and around both [pixels].
const RAIL = 0.035, POCKET = 0.06, EDGE = { left: 34, right: 6, top: 4, bottom: 20 };
const NO_EDGE = { left: 0, right: 0, top: 0, bottom: 0 };

class TableCanvas extends Board {
  constructor(canvas, { view, table, craft, colors, hockey = null, bare = false }) {
    super(canvas);
    Object.assign(this, { view, table, craft, colors, hockey, bare, tall: false });
  }
  toPixels(x, y) {
    const { left, top, scale } = this;
    return this.tall ? [left + y * scale, top + x * scale] : [left + x * scale, top - y * scale];
  }
  toMetres(px, py) {
    const right = (px - this.left) / this.scale, down = (py - this.top) / this.scale;
    return this.tall ? [down, right] : [right, -down];
  }
  // A rectangle with round corners from corner to corner [m].
  box(pen, x0, y0, x1, y1, round) {
    const [[px, py], [qx, qy]] = [this.toPixels(x0, y0), this.toPixels(x1, y1)];
    pen.beginPath();
    pen.roundRect(Math.min(px, qx), Math.min(py, qy), Math.abs(qx - px), Math.abs(qy - py),
      round * this.scale);
  }
  drawStill(pen) {
    this.place();
    const { scale, colors, table, hockey } = this, [x0, x1, y0, y1] = this.view;
    const pad = table ? 0.6 * RAIL : 0, around = [x0 - pad, y0 - pad, x1 + pad, y1 + pad];
    if (hockey) this.drawPockets(pen);
    this.box(pen, ...around, table ? 2 * RAIL : 0);
    pen.fillStyle = colors.floor;
    pen.fill();
    this.drawHoles(pen);
    if (!this.bare) this.drawGrid(pen);
    if (!table) return;
    if (hockey) this.drawMarkings(pen);
    else {
      const [x, y] = this.toPixels(0, 0);
      line(pen, x - 6, y, x + 6, y, colors.rail, 1.5);
      line(pen, x, y - 6, x, y + 6, colors.rail, 1.5);
    }
    this.box(pen, ...around, 2 * RAIL);
    pen.strokeStyle = colors.rail;
    pen.lineWidth = Math.max(3, 0.55 * RAIL * scale);
    pen.stroke();
    if (hockey) this.drawGoals(pen);
  }
  // Find scale and origin for the size of the canvas.
  place() {
    const [x0, x1, y0, y1] = this.view, edge = this.bare ? NO_EDGE : EDGE;
    const behind = RAIL + (this.hockey ? POCKET : 0), beside = this.bare ? 0.01 : 0;
    const long = x1 - x0 + 2 * behind, short = y1 - y0 + 2 * (RAIL + beside);
    const [wide, high] = this.tall ? [short, long] : [long, short];
    const room = this.width - edge.left - edge.right;
    const stack = this.height - edge.top - edge.bottom;
    const scale = this.scale = Math.min(room / wide, stack / high);
    this.left = edge.left + (room - scale * wide) / 2;
    this.top = edge.top + (this.bare ? (stack - scale * high) / 2 : 0);
    // From the corner of what is shown to the origin.
    this.left += scale * (this.tall ? RAIL + beside - y0 : behind - x0);
    this.top += scale * (this.tall ? behind - x0 : RAIL + beside + y1);
  }
  drawHoles(pen) {
    const [x0, x1, y0, y1] = this.view, step = niceStep(Math.max(x1 - x0, y1 - y0), 5) / 5;
    for (const at of multiples(x0, x1, step))
      for (const other of multiples(y0, y1, step))
        dot(pen, ...this.toPixels(at, other), 1.1, this.colors.holes);
  }
  // Both ends: where they are, which way is out, whose colour they have.
  ends() {
    const [x0, x1] = this.view, { left, right } = this.colors;
    return [[x0, -1, left], [x1, 1, right]];
  }
  drawPockets(pen) {
    const half = this.hockey.goal / 2;
    for (const [x, out, color] of this.ends()) {
      this.box(pen, x, -half, x + out * (RAIL + 0.8 * POCKET), half, 0.02);
      pen.globalAlpha = 0.3;
      pen.fillStyle = color;
      pen.fill();
      pen.globalAlpha = 1;
    }
  }
  drawMarkings(pen) {
    const { scale, colors, hockey } = this, [, , y0, y1] = this.view;
    const [x, y] = this.toPixels(0, 0), turn = this.tall ? Math.PI / 2 : 0, pad = 0.6 * RAIL;
    line(pen, ...this.toPixels(0, y0 - pad), ...this.toPixels(0, y1 + pad), colors.rail, 2);
    pen.beginPath();
    pen.arc(x, y, 0.16 * scale, 0, TURN);
    pen.stroke();
    dot(pen, x, y, 0.012 * scale, colors.rail);
    for (const [at, out, color] of this.ends()) {
      const from = turn + (out < 0 ? -Math.PI / 2 : Math.PI / 2);
      pen.beginPath();
      pen.arc(...this.toPixels(at + out * pad, 0), 0.62 * hockey.goal * scale, from, from + Math.PI);
      pen.globalAlpha = 0.07;
      pen.fillStyle = color;
      pen.fill();
      pen.globalAlpha = 0.7;
      pen.strokeStyle = color;
      pen.stroke();
      pen.globalAlpha = 1;
    }
  }
  drawGoals(pen) {
    const { scale, colors, hockey } = this, half = hockey.goal / 2;
    for (const [x, out, color] of this.ends()) {
      const at = x + 0.6 * RAIL * out;
      for (const [shade, alpha] of [[colors.floor, 1], [color, 0.3]]) {
        pen.globalAlpha = alpha;
        line(pen, ...this.toPixels(at, -half), ...this.toPixels(at, half), shade,
          Math.max(5, RAIL * scale));
      }
      pen.globalAlpha = 1;
      for (const post of [-half, half])
        dot(pen, ...this.toPixels(at, post), Math.max(3, 0.55 * RAIL * scale), color);
    }
  }
  drawGrid(pen) {
    const { colors } = this, [x0, x1, y0, y1] = this.view;
    const step = niceStep(Math.max(x1 - x0, y1 - y0), 5);
    const across = multiples(x0, x1, step), up = multiples(y0, y1, step);
    const [left, bottom] = this.toPixels(x0, y0), [right, top] = this.toPixels(x1, y1);
    const behind = RAIL + (this.hockey ? POCKET : 0);
    const below = bottom + RAIL * this.scale + 10, beside = left - behind * this.scale;
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
  // Draw in the body frame of a pose, in metres; `draw` is given the size of a pixel. What is nowhere
  // (not a number) is not drawn.
  atPose([x, y, yaw], draw) {
    const { pen } = this;
    if (Number.isNaN(x)) return;
    pen.save();
    pen.translate(...this.toPixels(x, y));
    pen.rotate((this.tall ? Math.PI / 2 : 0) - yaw);
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
  drawCraft(pose, known = true, color = this.colors.craft) {
    const { pen, craft, colors } = this;
    this.atPose(pose, pixel => {
      if (!known) pen.setLineDash([4 * pixel, 4 * pixel]);
      dot(pen, 0, 0, craft.radius, "#fff");
      pen.strokeStyle = known ? color : colors.grey;
      pen.lineWidth = 2 * pixel;
      pen.stroke();
      pen.setLineDash([]);
      pen.fillStyle = color;
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
  drawPuck(pose) {
    const { pen, colors, hockey } = this, r = hockey.puck;
    this.atPose(pose, pixel => {
      dot(pen, 0, 0, r, colors.puck);
      pen.strokeStyle = colors.mark;
      pen.lineWidth = Math.max(pixel, 0.05 * r);
      pen.globalAlpha = 0.75;
      pen.beginPath();
      pen.arc(0, 0, 0.72 * r, 0, TURN);
      pen.stroke();
      pen.globalAlpha = 1;
      dot(pen, 0.4 * r, 0, 0.14 * r, colors.mark);  // it shows the spin
    });
  }
  drawMallet([x, y], color = this.colors.right) {
    const { pen, hockey } = this, r = hockey.mallet;
    this.atPose([x, y, 0], pixel => {
      dot(pen, 0, 0, r, color);
      pen.strokeStyle = "#fff";
      pen.lineWidth = Math.max(1.5 * pixel, 0.05 * r);
      pen.globalAlpha = 0.85;
      for (const ring of [0.8, 0.42]) {
        pen.beginPath();
        pen.arc(0, 0, ring * r, 0, TURN);
        pen.stroke();
      }
      pen.globalAlpha = 1;
    });
  }
  drawPath(points, color) {
    const { pen } = this;
    pen.strokeStyle = color;
    pen.lineWidth = 2.5;
    pen.lineCap = "round";
    pen.setLineDash([1, 7]);
    // In pieces, the later the paler.
    const pieces = Math.min(8, points.length - 1);
    for (let k = 0; k < pieces; k++) {
      const from = Math.floor(k * (points.length - 1) / pieces);
      const to = Math.floor((k + 1) * (points.length - 1) / pieces);
      pen.globalAlpha = 1 - 0.8 * k / pieces;
      pen.beginPath();
      for (const [x, y] of points.slice(from, to + 1)) pen.lineTo(...this.toPixels(x, y));
      pen.stroke();
    }
    pen.globalAlpha = 1;
    pen.setLineDash([]);
    pen.lineCap = "butt";
  }
  drawIntention({ words, meet, path }) {
    const { pen, colors, hockey, scale } = this;
    if (path && path.length > 1) {
      this.drawPath(path, colors.asked);
      dot(pen, ...this.toPixels(...path[path.length - 1]), 4, colors.asked);
    }
    if (!meet) return;
    const [x, y] = this.toPixels(...meet), r = hockey.puck * scale;
    pen.strokeStyle = colors.asked;
    pen.lineWidth = 2;
    pen.setLineDash([6, 3.4]);
    pen.beginPath();
    pen.arc(x, y, r, 0, TURN);
    pen.stroke();
    pen.setLineDash([]);
    if (!words) return;
    pen.font = FONT;
    const half = pen.measureText(words).width / 2 + 4;  // the words stay on the canvas
    const middle = Math.max(half, Math.min(x, this.width - half));
    write(pen, words, middle, y - r - 9, "center", colors.asked);
  }
}
