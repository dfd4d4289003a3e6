// What all pages share: the connection to the server, and the states between which a page interpolates.
//
//   connect({ hear, lost });        // hear(message) of each JSON message; lost() when the server is gone
//   tell(object), sendPlace(x, y, yaw);
//   stateAt(time), clockAhead(), states
//   withColors(hello)               // with the canvas's colours for a light or a dark page
"use strict";

const byId = name => document.getElementById(name);
// States are drawn this late [s], and extrapolated by as much where none is newer: half a period of the
// server.
const BEHIND = 0.006;
// States farther apart than this are no motion: somebody put the puck there [m].
const JUMP = 0.15;

const darkness = matchMedia("(prefers-color-scheme: dark)");
function withColors(hello) {
  return { ...hello, colors: hello.schemes[darkness.matches ? "dark" : "light"] };
}

let socket;
const states = [];          // oldest first
const arrivals = [];        // [when, how far this page's clock is ahead of the state's] [s]
let placings = 0;           // how often the puck has been put somewhere
let placeNumber = 0;        // sequence number of the places that this page sends

// The connection -------------------------------------------------------------------------------
function connect({ hear, lost }) {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => typeof data === "string" ? hear(JSON.parse(data)) : see(data);
  socket.onclose = () => {
    states.length = arrivals.length = 0;
    lost();
    setTimeout(connect, 1000, { hear, lost });
  };
}
function tell(what) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(what));
}
// Send where the mallet, or the set point, is wanted; return the number of the message.
function sendPlace(x, y, yaw = 0) {
  const data = new DataView(new ArrayBuffer(16));
  data.setUint32(0, ++placeNumber, true);
  [x, y, yaw].forEach((value, k) => data.setFloat32(4 + 4 * k, value, true));
  if (socket.readyState === WebSocket.OPEN) socket.send(data.buffer);
  return placeNumber;
}

// A state: time f64, wishes heard u32, flags u8 …, then f32: puck x, y, yaw; on the right mallet x, y,
// vx, vy, or craft x, y, yaw, 0; on the left craft x, y, yaw; commands of motors.
function see(data) {
  const view = new DataView(data);
  const numbers = Array.from({ length: (data.byteLength - 16) / 4 },
    (_, k) => view.getFloat32(16 + 4 * k, true));
  const state = {
    time: view.getFloat64(0, true), heard: view.getUint32(8, true), hidden: view.getUint8(12) & 1,
    puck: numbers.slice(0, 3), mallet: numbers.slice(3, 7), craft: numbers.slice(7, 10),
    commands: numbers.slice(10),
  };
  const now = performance.now() / 1000, newest = states.at(-1);
  if (newest && state.time < newest.time) states.length = 0;
  // While time stands still, there is one state.
  if (newest && state.time === newest.time) states.pop();
  if (!states.length || jumps(newest.puck, state.puck)) placings++;
  state.placing = placings;
  const ahead = now - state.time;
  // After a pause this page's clock is ahead by more.
  if (arrivals.length && (now - arrivals.at(-1)[0] > 0.25 || ahead - arrivals.at(-1)[1] > 0.25))
    arrivals.length = 0;
  arrivals.push([now, ahead]);
  while (now - arrivals[0][0] > 2) arrivals.shift();
  states.push(state);
  while (states.length > 2 && states[1].time < state.time - 0.5) states.shift();
}
function clockAhead() {
  let least = Infinity;
  for (const [, ahead] of arrivals) least = Math.min(least, ahead);
  return least;
}

function jumps(from, to) {
  return Math.hypot(to[0] - from[0], to[1] - from[1]) > JUMP;
}

// What is seen at a moment on the server's clock -----------------------------------------------
function stateAt(time) {
  let k = states.length - 1;
  while (k > 0 && states[k].time > time) k--;
  if (time <= states[k].time || states.length < 2) return states[k];
  const beyond = k === states.length - 1, [before, after] = states.slice(beyond ? -2 : k);
  const until = beyond ? Math.min(time, after.time + BEHIND) : time;
  const share = (until - before.time) / (after.time - before.time);
  const between = (from, to) => jumps(from, to) ? to
    : from.map((value, i) => value + share * (i === 2 ? turn(to[i] - value) : to[i] - value));
  return { ...(beyond ? after : before), placing: after.placing,
    hidden: before.hidden || after.hidden, puck: between(before.puck, after.puck),
    craft: between(before.craft, after.craft), mallet: between(before.mallet, after.mallet) };
}
function turn(angle) {
  return angle - TURN * Math.round(angle / TURN);
}
