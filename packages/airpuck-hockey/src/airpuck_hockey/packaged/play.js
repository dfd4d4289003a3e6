// The page of a game. The server has the authority: it sends where everything is, and is sent where
// the hand is. Between its states this page interpolates; the own mallet it predicts.
"use strict";

// Time between messages of the pointer, but for the last one of a frame [ms].
const APART = 8;
// On a touch screen the mallet is this far ahead of the finger, to be seen [pixels].
const BEFORE_FINGER = 56;
// The trail of the puck [s].
const TRAIL = 0.35;
// Keys move the mallet this fast [m/s]; the longest frame that counts [s].
const KEY_SPEED = 1.2, LONGEST_FRAME = 0.05;
// Direction of keys on the screen: right, down.
const STEER = {
  ArrowLeft: [-1, 0], KeyA: [-1, 0], ArrowRight: [1, 0], KeyD: [1, 0],
  ArrowUp: [0, -1], KeyW: [0, -1], ArrowDown: [0, 1], KeyS: [0, 1],
};

let table, hello, role = "spectator";
let status = { phase: "waiting", score: [0, 0], level: "" };
const trail = [];           // [x, y, when, how often the puck had been put somewhere]
let thought = null, thinking = false, figuresShown = 0;
let chosen = null;          // the level that this page asked for, until the server plays it

function hear(news) {
  if (news.is === "hello") begin(news);
  else if (news.is === "role") { role = news.role; showCard(); }
  else if (news.is === "status") showStatus(news);
  else if (news.is === "event") notice(news);
  else if (news.is === "thought") {
    // The words change at once with the intention, and twice a second with the numbers.
    if (thought?.words.split(":")[0] !== news.words.split(":")[0]) figuresShown = 0;
    thought = news;
  }
}

// Whether this page moves the mallet: no page does where a human is at the table.
function plays() {
  return role === "player" && status.phase !== "watch";
}

// The own mallet: the server's law of motion, from its newest state on, towards where the hand is ----
const wishes = [];          // [when sent on this page's clock, x, y]
let lastSent = 0;
const sentAt = new Map();   // number of a wish: time of its pointer event [ms]
function wish(event) {
  if (!plays() || !table) return;
  // A finger plays where it has touched the table; the mouse may leave it.
  if (event.pointerType !== "mouse" && event.target !== table.canvas) return;
  if (event.type === "pointerrawupdate" && event.timeStamp - lastSent < APART)
    return;
  const box = table.canvas.getBoundingClientRect();
  let px = event.clientX - box.left, py = event.clientY - box.top;
  if (event.pointerType === "touch") table.tall ? py -= BEFORE_FINGER : px -= BEFORE_FINGER;
  lastSent = event.timeStamp;
  ask(...table.toMetres(px, py), lastSent);
}
function ask(x, y, stamp) {
  const number = sendPlace(x, y);
  wishes.push([performance.now() / 1000, x, y]);
  while (wishes.length > 200) wishes.shift();
  // On a graph nothing says when it was heard, and a game that starts hears late.
  if (!hello.live && status.phase === "play") sentAt.set(number, stamp);
}
// Keys that are held move what is asked for, from where it is.
const held = new Set();
let steered = 0;
function steer(stamp) {
  const lasts = Math.min((stamp - steered) / 1000, LONGEST_FRAME);
  steered = stamp;
  if (!held.size || !plays() || status.phase !== "play" || !states.length) return;
  let right = 0, down = 0;
  for (const code of held) { right += STEER[code][0]; down += STEER[code][1]; }
  if (!right && !down) return;
  const far = KEY_SPEED * lasts / Math.hypot(right, down);
  const [x, y] = wishes.length ? allowed(...wishes.at(-1).slice(1)) : states.at(-1).mallet;
  const [dx, dy] = table.tall ? [down, right] : [right, -down];
  ask(...allowed(x + far * dx, y + far * dy), stamp);
}
function allowed(x, y) {
  const [length, width] = hello.table, r = hello.hockey.mallet;
  return [Math.max(r, Math.min(x, length / 2 - r)),
    Math.max(r - width / 2, Math.min(y, width / 2 - r))];
}
// One step of the mallet, as in `twin/play.py`.
function moved([x, y, vx, vy], [wantedX, wantedY], duration) {
  const { speed: fastest, acceleration: hardest } = hello.mallet;
  const [toX, toY] = allowed(wantedX, wantedY), dx = toX - x, dy = toY - y;
  const distance = Math.hypot(dx, dy), reserve = hardest * duration;
  const brakes = Math.sqrt(reserve ** 2 / 4 + 2 * hardest * distance) - reserve / 2;
  const pace = distance ? Math.min(fastest, brakes, distance / duration) / distance : 0;
  const changeX = pace * dx - vx, changeY = pace * dy - vy, change = Math.hypot(changeX, changeY);
  const share = change ? Math.min(1, reserve / change) : 0;
  const [atX, atY] = allowed(x + (vx + share * changeX) * duration,
    y + (vy + share * changeY) * duration);
  return [atX, atY, (atX - x) / duration, (atY - y) / duration];
}
function predictedMallet(ahead, now) {
  const newest = states.at(-1);
  if (status.phase !== "play" || !wishes.length) return newest.mallet;
  // A wish of this moment is heard after the way to the server, which takes as long as that back.
  const until = Math.min(now - ahead + 0.005, newest.time + 0.1);
  let mallet = newest.mallet;
  for (let time = newest.time; time < until - 1e-4; time += hello.period) {
    let k = wishes.length - 1;
    while (k > 0 && wishes[k][0] - ahead > time) k--;
    mallet = moved(mallet, wishes[k].slice(1), Math.min(hello.period, until - time));
  }
  return mallet;
}

// Drawing --------------------------------------------------------------------------------------
const figures = { frames: [], latencies: [] };   // [ms]
window.airpuck = { figures, states, status: () => status };
function resize() {
  table.tall = innerHeight > innerWidth;
  table.resize();
  table.clear();
}
function draw(stamp) {
  requestAnimationFrame(draw);
  steer(stamp);
  figures.frames.push(stamp);
  if (figures.frames.length > 3600) figures.frames.shift();
  if (!states.length) return;
  const now = performance.now() / 1000, ahead = clockAhead();
  const seen = stateAt(now - ahead - BEHIND);
  const mallet = plays() ? predictedMallet(ahead, now) : seen.mallet;
  table.clear();
  leaveTrail(seen, now);
  table.drawTrail(trail.map(point => point && [point[0], point[1], (now - point[2]) / TRAIL]));
  const shown = thinking && (hello.live || status.phase === "play") ? thought : null;
  if (shown?.predicted) table.drawPath(shown.predicted, hello.colors.grey);
  const { left, right } = hello.colors, [one, other] = hello.sides;
  const commands = drawSide(one, seen.craft, left, seen.commands);
  if (!seen.hidden) table.drawPuck(seen.puck);
  drawSide(other, mallet, right, commands);
  if (shown) table.drawIntention(shown);  // its words lie above the craft
  for (const [number, sent] of sentAt) {
    if (number > seen.heard) break;
    sentAt.delete(number);
    figures.latencies.push(performance.now() - sent);
  }
  if (figures.latencies.length > 3600) figures.latencies.splice(0, 600);
  showFigures(now);
}
// A craft or a mallet; returns the commands that are not its own.
function drawSide(kind, pose, color, commands) {
  if (kind === "hand") {
    table.drawMallet(pose, color);
    return commands;
  }
  const motors = hello.craft.positions.length;
  table.drawCraft(pose, true, color);
  table.drawThrusts(pose, thrustsOf(hello.craft, commands.slice(0, motors)));
  return commands.slice(motors);
}
function leaveTrail({ hidden, placing, puck: [x, y] }, now) {
  const last = trail.at(-1);
  if (hidden) { if (last) trail.push(null); }
  else {
    if (last && placing !== last[3]) trail.push(null);
    trail.push([x, y, now, placing]);
  }
  while (trail.length && (!trail[0] || now - trail[0][2] > TRAIL)) trail.shift();
}
function showFigures(now) {
  if (now - figuresShown < 0.5) return;
  figuresShown = now;
  const { frames, latencies } = figures, recent = frames.slice(-61);
  const rate = 1000 * (recent.length - 1) / (recent.at(-1) - recent[0]);
  const late = latencies.slice(-200).sort((a, b) => a - b);
  const p95 = late.length ? `, server answers within ${late[Math.floor(0.95 * late.length)].toFixed(0)} ms` : "";
  byId("figures").textContent = thinking ? `${rate.toFixed(0)} frames per second${p95}` : "";
  byId("said").textContent = thinking && thought ? thought.said : "";
}

// Score, cards, calls --------------------------------------------------------------------------
function begin(news) {
  hello = withColors(news);
  if (!table) {
    table = new TableCanvas(byId("table"), { ...hello, bare: true });
    requestAnimationFrame(draw);
  }
  Object.assign(table, hello);
  byId("left-name").textContent = hello.names[0];
  document.body.classList.toggle("live", !!hello.live);
  byId("levels").replaceChildren(...hello.levels.map(level => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = level;
    button.onclick = event => {
      chosen = level;
      tell({ do: "level", level });
      release(event);
      showStatus(status);
    };
    return button;
  }));
  document.title = `airpuck – ${hello.names[0]}`;
  resize();
  if (thinking) tell({ do: "think", on: true });
}
function showStatus(news) {
  status = news;
  byId("left").textContent = status.score[0];
  byId("right").textContent = status.score[1];
  const verb = status.phase === "paused" ? "Resume" : "Pause";
  byId("pause").setAttribute("aria-label", verb);
  byId("pause").title = `${verb} (space)`;
  if (status.level === chosen && status.phase !== "starting") chosen = null;
  if (status.phase === "starting") wishes.length = 0;  // the mallet goes back to its place
  for (const button of byId("levels").children)
    button.setAttribute("aria-pressed", button.textContent === (chosen ?? status.level));
  showCard();
}
const TOUCH = matchMedia("(pointer: coarse)").matches;
const MEANS = TOUCH ? "your finger" : "the mouse, the arrow keys or W A S D";
const KEYS = "Space starts and pauses, R restarts, T shows what the craft thinks, M turns the sound on and off.";
function card() {
  const [left, right] = status.score;
  const keys = TOUCH ? "" : KEYS;
  const recorded = hello.recorded ? " Games are recorded." : "";
  if (role === "lost") return ["Connection lost", "Is airpuck still running? This page keeps trying to reconnect.", ""];
  if (status.phase === "watch") return null;
  if (role === "spectator")
    return status.phase === "waiting"
      ? ["The seat is free", `The player has left.${recorded}`, "Play"] : null;
  if (chosen) return ["One moment", `Starting a new game at the level ${chosen}.`, ""];
  switch (status.phase) {
    case "waiting": case "starting": return ["One moment", "Starting a new game.", ""];
    case "ready": return ["You against the craft",
      `Move the orange mallet with ${MEANS}. First to ${hello.first_to} wins. Whoever keeps the puck ` +
      `for ${hello.foul_s} s loses it to the other side.${recorded}`, "Play", keys];
    case "paused": return ["Paused", `${left} : ${right}`, "Resume", keys];
    case "over": return right > left
      ? ["You win", `${right} : ${left}. Well played.`, "Play again"]
      : ["The craft wins", `${left} : ${right}. Another game?`, "Play again"];
    default: return null;
  }
}
function showCard() {
  const content = card(), watching = role === "spectator" && status.phase !== "waiting";
  const shows = status.phase === "watch";
  byId("card").hidden = !content;
  document.body.classList.toggle("plays", !content && plays());
  for (const button of document.querySelectorAll("#pause, #restart, #levels button"))
    button.disabled = role !== "player";
  const player = role === "player" ? "you" : watching ? "player (you are watching)" : "player";
  byId("right-name").textContent = (shows ? hello.names[1] : player) + (hello.recorded ? ", recorded" : "");
  if (!content) return;
  const [title, words, go, hint] = content;
  byId("title").textContent = title;
  byId("words").textContent = words;
  byId("go").textContent = go;
  byId("go").hidden = !go;
  byId("hint").textContent = hint || "";
  byId("hint").hidden = !hint;
}
function call(words, color) {
  const element = byId("call");
  element.textContent = words;
  element.style.color = color;
  element.classList.remove("shown");
  void element.offsetWidth;  // starts the animation again
  element.classList.add("shown");
}
function whose(side) {
  if (hello.live && !plays()) return `${hello.names[side < 0 ? 0 : 1]}'s`;
  return side < 0 ? "its" : plays() ? "your" : "the player's";
}
function notice({ kind, side, strength }) {
  const { left, right } = hello.colors;
  if (kind === "goal") {
    call("Goal!", side > 0 ? right : left);
    sound(side > 0 ? [523, 659, 784] : [392, 330, 262], 0.12, 0.18, "triangle");
  } else if (kind === "over") {
    const who = side > 0 && plays() ? "You win" : `${hello.names[side < 0 ? 0 : 1]} wins`;
    call(side ? who : "A draw", side < 0 ? left : side > 0 ? right : hello.colors.grey);
  } else if (kind === "stuck") {
    call("Stuck puck: new serve", hello.colors.grey);
  } else if (kind === "foul") {
    call(`Foul: puck on ${whose(side)} side for ${hello.foul_s} s`, hello.colors.grey);
    sound([220, 220], 0.15, 0.12, "square");
  } else sound([{ rail: 900, post: 1400, mallet: 340, craft: 260 }[kind]], 0.045,
    Math.min(0.3, strength), "sine");
}

// Sound ----------------------------------------------------------------------------------------
let audio = null, loud = localStorage.getItem("sound") !== "off";
function sound(tones, lasts, volume, shape) {
  if (!loud || !audio || audio.state !== "running") return;
  tones.forEach((tone, k) => {
    const begins = audio.currentTime + 0.8 * k * lasts;
    const source = audio.createOscillator(), gain = audio.createGain();
    source.type = shape;
    source.frequency.setValueAtTime(tone, begins);
    if (tones.length === 1) source.frequency.exponentialRampToValueAtTime(tone / 2, begins + lasts);
    gain.gain.setValueAtTime(volume, begins);
    gain.gain.exponentialRampToValueAtTime(1e-3, begins + lasts);
    source.connect(gain).connect(audio.destination);
    source.start(begins);
    source.stop(begins + lasts);
  });
}
function wakeSound() {
  audio ??= window.AudioContext ? new AudioContext() : null;
  if (audio?.state === "suspended") audio.resume();
}

// Hands and buttons ----------------------------------------------------------------------------
function press(button, on) {
  byId(button).setAttribute("aria-pressed", on);
}
const actions = {
  go: () => tell({ do: role === "spectator" ? "sit" : status.phase === "over" ? "restart" : "go" }),
  pause: () => tell({ do: status.phase === "paused" ? "go" : "pause" }),
  restart: () => tell({ do: "restart" }),
  think: () => {
    thinking = !thinking;
    thought = null;
    press("think", thinking);
    byId("legend").hidden = !thinking;
    if (table) resize();
    tell({ do: "think", on: thinking });
  },
  sound: () => { loud = !loud; localStorage.setItem("sound", loud ? "on" : "off"); press("sound", loud); },
};
const keys = { " ": "pause", p: "pause", r: "restart", t: "think", m: "sound" };
for (const name of Object.keys(actions))
  byId(name).onclick = event => { wakeSound(); actions[name](); release(event); };
// A button that a pointer pressed gives the space bar back; one pressed by key keeps the focus.
function release(event) {
  if (event.detail) event.currentTarget.blur();
}
addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.code in STEER) {
    held.add(event.code);
    event.preventDefault();
    return;
  }
  const name = keys[event.key.toLowerCase()];
  if (!name || event.repeat) return;
  // Space presses the button that has the focus.
  if (event.key === " " && event.target.closest?.("button")) return;
  event.preventDefault();
  const offered = !byId("card").hidden && !byId("go").hidden;
  wakeSound();
  actions[name === "pause" && offered ? "go" : name]();
});
addEventListener("keyup", event => held.delete(event.code));
addEventListener("blur", () => held.clear());
press("sound", loud);
byId("table").addEventListener("pointerdown", event => {
  wakeSound();
  byId("table").setPointerCapture(event.pointerId);
  wish(event);
});
// Raw updates come at once, moves with the next frame; not every browser has both.
for (const kind of ["pointermove", "pointerrawupdate"]) addEventListener(kind, wish);
addEventListener("contextmenu", event => event.preventDefault());
addEventListener("resize", () => table && resize());
darkness.addEventListener("change", () => {
  if (!table) return;
  hello = withColors(hello);
  table.colors = hello.colors;
  resize();
});
// A page that is not seen does not play.
document.addEventListener("visibilitychange", () => {
  if (document.hidden && role === "player" && status.phase === "play") tell({ do: "pause" });
});
connect({ hear, lost: () => { role = "lost"; chosen = null; showCard(); } });
