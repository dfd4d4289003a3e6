// The page of the live view: craft, trail, thrusts, plan, and a set point to drag; gauges beside it.
"use strict";

// Colours of a plan by what holds it back.
const BOUND = { nothing: "#009e73", motor: "#e69f00", motion: "#d55e00" };
const RING_FILL = "#f0c81466", RING_EDGE = "#967300", KNOB_FILL = "#f0c814";
// Radius of the set point's ring and distance of its knob, in radii of the craft: both show around a
// craft that has arrived.
const RING = 1.45, KNOB = 1.95;
// Radius of the knob, and how near to it a pointer takes hold of it [m].
const BALL = 0.018, GRIP = 0.04;
// Points of the trail, and the least distance between two [m].
const TRAIL_POINTS = 200, TRAIL_STEP = 0.005;

let table, hello, scene = { seen: false, set_point: null, plan: null, hint: "" };
const trail = [];           // [x, y], oldest first
let trailed = -Infinity;    // time of the newest state that is in the trail [s]
// What the pointer holds: null, or a function from where it is [m] to the set point.
let held = null;
window.airpuck = { states, scene: () => scene };

const handlers = { hello: begin, scene: showScene, panel: showPanel };
function hear(message) {
  byId("lost").hidden = true;
  handlers[message.is]?.(message);
}
function begin(message) {
  hello = withColors(message);
  trailed = -Infinity;  // another process has another clock
  if (!table) {
    table = new TableCanvas(byId("table"), hello);
    requestAnimationFrame(draw);
  }
  Object.assign(table, hello);
  [["x", hello.reach[0]], ["y", hello.reach[1]], ["yaw", 3.2]].forEach(([name, limit]) => {
    byId(name).min = -limit;
    byId(name).max = limit;
  });
  resize();
}
function resize() {
  table.resize();
  table.clear();
}

// Drawing --------------------------------------------------------------------------------------
function draw() {
  requestAnimationFrame(draw);
  table.clear();
  if (states.length) {
    const { craft, commands } = stateAt(performance.now() / 1000 - clockAhead() - BEHIND);
    for (const state of states) if (state.time > trailed) leaveTrail(state);
    table.drawTrail(trail.map(([x, y], k) => [x, y, 1 - (k + 1) / trail.length]));
    if (scene.set_point) drawHandle(scene.set_point);
    table.drawCraft(craft, scene.seen);
    table.drawThrusts(craft, thrustsOf(hello.craft, commands));
  }
  // The plan lies above the craft, which would hide it.
  if (scene.plan) table.drawPlan(scene.plan.x, scene.plan.y, BOUND[scene.plan.bound] ?? BOUND.nothing);
}
function leaveTrail({ time, craft: [x, y] }) {
  const last = trail.at(-1);
  trailed = time;
  if (!last || Math.hypot(x - last[0], y - last[1]) > TRAIL_STEP) trail.push([x, y]);
  if (trail.length > TRAIL_POINTS) trail.shift();
}
// The set point: a ring to drag, and a knob to turn it by.
function drawHandle(pose) {
  const { pen } = table, { radius } = hello.craft;
  table.atPose(pose, pixel => {
    dot(pen, 0, 0, RING * radius, RING_FILL);
    pen.strokeStyle = RING_EDGE;
    pen.lineWidth = 2 * pixel;
    pen.stroke();
    line(pen, RING * radius, 0, KNOB * radius, 0, RING_EDGE, 3 * pixel);
    dot(pen, KNOB * radius, 0, BALL, KNOB_FILL);
    pen.lineWidth = 1.5 * pixel;
    pen.strokeStyle = RING_EDGE;
    pen.stroke();
  });
}

// The set point --------------------------------------------------------------------------------
function want(pose) {
  scene.set_point = pose;
  sendPlace(...pose);
}
function pointed(event) {
  const box = table.canvas.getBoundingClientRect();
  return table.toMetres(event.clientX - box.left, event.clientY - box.top);
}
// Return what a pointer that goes down at a place takes hold of.
function holdAt(px, py) {
  const [x, y, yaw] = scene.set_point, radius = hello.craft.radius;
  const knobX = x + KNOB * radius * Math.cos(yaw), knobY = y + KNOB * radius * Math.sin(yaw);
  if (Math.hypot(px - knobX, py - knobY) < GRIP)
    return (toX, toY) => [x, y, Math.atan2(toY - y, toX - x)];
  // What is grabbed stays under the pointer.
  if (Math.hypot(px - x, py - y) < RING * radius)
    return (toX, toY) => [...inside(x + toX - px, y + toY - py), yaw];
  return null;
}
function inside(x, y) {
  return [x, y].map((value, k) => Math.max(-hello.reach[k], Math.min(value, hello.reach[k])));
}
byId("table").addEventListener("pointerdown", event => {
  if (!table || !scene.set_point) return;
  held = holdAt(...pointed(event));
  if (held) byId("table").setPointerCapture(event.pointerId);
});
byId("table").addEventListener("pointermove", event => {
  if (held) want(held(...pointed(event)));
});
for (const kind of ["pointerup", "pointercancel"])
  byId("table").addEventListener(kind, () => { held = null; });
byId("numbers").onchange = () => {
  const pose = ["x", "y", "yaw"].map(name => byId(name).valueAsNumber);
  if (pose.every(Number.isFinite)) want([...inside(...pose), pose[2]]);
};
byId("numbers").onsubmit = event => event.preventDefault();

function showScene(message) {
  // While the pointer holds the set point, what this page wants is newer.
  if (held) message.set_point = scene.set_point;
  scene = message;
  byId("hint").textContent = scene.hint;
  const shown = scene.set_point?.map((value, k) => (k === 2 ? turn(value) : value).toFixed(3));
  // A number that is being entered stays.
  ["x", "y", "yaw"].forEach((name, k) => {
    if (shown && document.activeElement !== byId(name)) byId(name).value = +shown[k];
  });
}

// Gauges and events ----------------------------------------------------------------------------
function made(kind, text = "", className = "") {
  return Object.assign(document.createElement(kind), { textContent: text, className });
}
// A table of gauges: [name, value, share]; a share of 1 is a full bar, null is none.
function gauges(rows) {
  const element = made("table");
  for (const [name, value, share] of rows) {
    const row = element.insertRow(), bar = made("div", "", "bar");
    row.insertCell().textContent = name;
    if (share !== null) {
      const length = made("div", "", share > 1 ? "too-long" : "");
      length.style.width = `${100 * Math.max(0, Math.min(share, 1))}%`;
      bar.append(length);
      row.insertCell().append(bar);
    } else row.insertCell();
    row.insertCell().textContent = value;
  }
  return element;
}
function showPanel({ flight, health, findings, events }) {
  byId("flight").replaceChildren(gauges(flight));
  byId("health").replaceChildren(
    ...health.flatMap(([heading, rows]) => [made("p", heading), gauges(rows)]),
    ...findings.map(([finding, kind]) => made("p", finding, kind)));
  byId("events").replaceChildren(
    ...(events.length ? events : [["none yet", "info"]]).map(([text, kind]) => made("p", text, kind)));
}

addEventListener("resize", () => table && resize());
darkness.addEventListener("change", () => {
  if (!table) return;
  hello = withColors(hello);
  table.colors = hello.colors;
  resize();
});
connect({ hear, lost: () => { byId("lost").hidden = false; } });
