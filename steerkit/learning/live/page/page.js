"use strict";
// Asks for the run once a second, and draws what has changed. All that is shown as text is set as text.

const EVERY = 1000, PATIENCE = 8000;
const at = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
let run = null, answered = 0, drawn = "";

function seconds(s) {
  s = Math.round(s);
  if (s < 60) return `${s} s`;
  const minutes = Math.floor(s / 60);
  return minutes < 60 ? `${minutes} min ${s % 60} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

// ---- drawing ------------------------------------------------------------------------------------------------------

function sheet(id) {
  // an empty picture as large as its place
  const svg = at(id), box = svg.getBoundingClientRect();
  svg.setAttribute("viewBox", `0 0 ${box.width} ${box.height}`);
  svg.replaceChildren();
  return { svg, w: box.width, h: box.height };
}

function put(svg, kind, attributes, text) {
  const node = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== undefined) node.textContent = text;
  svg.appendChild(node);
  return node;
}

function polyline(svg, name, points) {
  if (points.length > 1) put(svg, "polyline", { class: name, points: points.map((p) => `${p[0].toFixed(1)},${p[1].toFixed(1)}`).join(" ") });
}

function cross(svg, x, y, r) {
  put(svg, "path", { class: "fail", d: `M${x - r} ${y - r}l${2 * r} ${2 * r}M${x - r} ${y + r}l${2 * r} ${-2 * r}` });
}

function drawCurve() {
  const { svg, w, h } = sheet("curve"), c = run.curve;
  const left = 46, right = 12, top = 18, bottom = 24, low = 1e-3, high = 1;
  const end = horizon(run.t, 60 * run.ends.minutes);
  const x = (t) => left + (w - left - right) * t / end;
  const y = (e) => top + (h - top - bottom) * Math.log(high / Math.min(high, Math.max(low, e))) / Math.log(high / low);
  put(svg, "rect", { class: "goal", x: left, y: y(run.limits.goal), width: w - left - right, height: y(low) - y(run.limits.goal) });
  for (const [a, b] of c.recovery) put(svg, "rect", { class: "shade", x: x(a), y: top, width: Math.max(1, x(b) - x(a)), height: y(low) - top });
  for (const [value, text] of [[1, "1 m"], [0.1, "0.1 m"], [0.01, "1 cm"], [0.001, "1 mm"]]) {
    put(svg, "line", { class: "grid", x1: left, x2: w - right, y1: y(value), y2: y(value) });
    put(svg, "text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, text);
  }
  put(svg, "line", { class: "trip", x1: left, x2: w - right, y1: y(run.limits.trip), y2: y(run.limits.trip) });
  const step = [5, 10, 15, 30, 60, 120, 300, 600, 1200, 3600, 7200, 21600, 86400].find((s) => end / s <= (w < 600 ? 5 : 10)) || end;
  for (let t = 0; t <= end + 1e-9; t += step) {
    put(svg, "line", { class: "grid", x1: x(t), x2: x(t), y1: top, y2: y(low) });
    const text = step < 60 ? `${t} s` : `${Math.round(t / 6) / 10} min`;
    put(svg, "text", { x: x(t), y: h - 6, "text-anchor": t === 0 ? "start" : x(t) > w - 40 ? "end" : "middle" }, text);
  }
  let piece = [];
  for (let k = 0; k <= c.t.length; k++) {
    if (k < c.t.length && c.rms[k] !== null) { piece.push([x(c.t[k]), y(c.rms[k])]); continue; }
    if (piece.length === 1) piece.push([piece[0][0] + 1.5, piece[0][1]]);
    polyline(svg, "learner", piece);
    piece = [];
  }
  for (const t of c.failed) cross(svg, x(t), top - 8, 4);
}

function horizon(t, whole) {
  // the axis grows in steps, up to the whole run
  const step = [30, 60, 120, 180, 300, 480, 660, 900, 1200, 1800, 3600].find((s) => t <= s) || 3600 * Math.ceil(t / 3600);
  return Math.max(t, Math.min(step, whole));
}

function drawMap() {
  const { svg, w, h } = sheet("map"), m = run.map, margin = 22;
  const all = [...m.path, ...m.learner.flat(), ...m.recovery.flat()];
  const xs = all.map((p) => p[0]), ys = all.map((p) => p[1]);
  const low = [Math.min(...xs), Math.min(...ys)], high = [Math.max(...xs), Math.max(...ys)];
  const size = [Math.max(1, high[0] - low[0]), Math.max(1, high[1] - low[1])];
  const k = Math.min((w - 2 * margin) / size[0], (h - 2 * margin) / size[1]);
  const place = (p) => [w / 2 + k * (p[0] - (low[0] + high[0]) / 2), h / 2 - k * (p[1] - (low[1] + high[1]) / 2)];
  polyline(svg, "path", m.path.map(place));
  for (const way of m.learner) polyline(svg, "learner", way.map(place));
  for (const way of m.recovery) polyline(svg, "rescue", way.map(place));
  for (const p of m.failed) cross(svg, ...place(p), 5);
  if (m.car) {
    const [cx, cy] = place(m.car);
    put(svg, "circle", { class: "car", cx, cy, r: 6.5 });
  }
  const length = [1000, 500, 200, 100, 50, 20, 10, 5, 1].find((s) => s * k < w / 4) || 1;
  put(svg, "path", { class: "scale", d: `M10 ${h - 8}v-6m0 3h${length * k}m0 -3v6` });
  put(svg, "text", { x: 16 + length * k, y: h - 7 }, `${length} m`);
}

function drawPolicy() {
  const { svg, w, h } = sheet("policy"), p = run.policy;
  const left = 46, right = 10, top = 8, bottom = 38, wide = w - left - right, high = h - top - bottom;
  const n = p.e.length, e = p.e[n - 1], psi = p.psi_e_deg[n - 1];
  const x = (value) => left + wide * (value + e) / (2 * e), y = (value) => top + high * (psi - value) / (2 * psi);
  const across = (j) => Math.round(left + wide * j / n), down = (i) => Math.round(top + high * i / n);
  p.action_deg.forEach((row, i) => row.forEach((a, j) => {
    if (!a) return;
    put(svg, "rect", {
      class: a < 0 ? "to-right" : "to-left", "fill-opacity": Math.min(1, 0.12 + 0.88 * Math.abs(a) / p.largest_deg).toFixed(3),
      x: across(j), y: down(n - 1 - i), width: across(j + 1) - across(j), height: down(n - i) - down(n - 1 - i),
    });
  }));
  for (const value of [-0.5, -0.25, 0, 0.25, 0.5]) {
    put(svg, "text", { x: x(value), y: h - 22, "text-anchor": value === 0.5 ? "end" : "middle" }, value > 0 ? `+${value}` : value);
  }
  for (const value of [-10, -5, 0, 5, 10]) put(svg, "text", { x: left - 6, y: y(value) + (value === 10 ? 10 : 4), "text-anchor": "end" }, `${value > 0 ? "+" : ""}${value}°`);
  put(svg, "text", { x: left + wide / 2, y: h - 5, "text-anchor": "middle" }, "e [m], + = car left of the path");
  put(svg, "text", { x: -(top + high / 2), y: 11, "text-anchor": "middle", transform: "rotate(-90)" }, "heading error, less the bend's");
  for (const way of [[[-e, 0], [e, 0]], [[0, -psi], [0, psi]]]) polyline(svg, "frame", way.map((q) => [x(q[0]), y(q[1])]));
  put(svg, "rect", { class: "frame", x: left, y: top, width: wide, height: high });
  const inside = p.lately.map((q) => [x(Math.max(-e, Math.min(e, q[0]))), y(Math.max(-psi, Math.min(psi, q[1])))]);
  polyline(svg, "trail", inside);
  if (inside.length) put(svg, "circle", { class: "car", cx: inside.at(-1)[0], cy: inside.at(-1)[1], r: 5 });
}

// ---- words --------------------------------------------------------------------------------------------------------

function over() {
  const { minutes, rounds, episodes } = run.ends;
  return run.t >= 60 * minutes - 0.1 || (rounds > 0 && run.rounds >= rounds) || run.failures >= episodes;
}

function tell() {
  const whole = 60 * run.ends.minutes;
  at("name").textContent = run.name;
  document.title = `steerkit: ${run.name}`;
  at("place").textContent = run.learner ? `${run.place}, ${run.learner}` : run.place;
  at("driven").textContent = `${(run.t / 60).toFixed(1)} of ${run.ends.minutes} min`;
  at("done").max = whole;
  at("done").value = run.t;
  const left = over() ? "it has come to its end" : run.pace && run.learner ? `about ${seconds((whole - run.t) / run.pace)} to go` : "";
  at("left").textContent = left;
  at("rms").textContent = run.curve.lately === null ? "–" : `${run.curve.lately.toFixed(3)} m`;
  at("rms-note").textContent = run.curve.lately !== null && run.curve.lately < run.limits.goal ? "within the goal band" : "cross-track error";
  const who = { true: "learner", false: "recovery", null: "–" }[run.map.learning];
  at("who").textContent = who;
  at("who").className = `${who}-steers`;
  at("held").textContent = run.map.learning === null ? "" : run.held === null ? "until the next net" : `for ${seconds(run.held)}`;
  at("failures").textContent = run.failures;
  at("failed-last").textContent = run.curve.failed.length ? `last: ${seconds(run.curve.failed.at(-1))}` : "none so far";
  at("updates").textContent = run.updates;
  at("km").textContent = `of ${run.driven_km.toFixed(2)} km driven`;
  at("rounds").textContent = run.rounds;
  at("first").textContent = run.first_round[1] === null ? "none yet" : `first: ${seconds(run.first_round[1])}`;
  const one = run.policy.element === "integrator" ? "turn of the wheel in a step" : "the wheel's angle";
  at("policy-note").textContent = `${one}, wheel straight, ${run.policy.v} m/s`;
  at("to-right").textContent = `right, to ${run.policy.largest_deg}°`;
  at("to-left").textContent = `left, to ${run.policy.largest_deg}°`;
}

function trouble(text) {
  at("trouble").hidden = !text;
  at("trouble").textContent = text;
}

function chip() {
  const silent = Date.now() - answered > PATIENCE / 2;
  const learning = !silent && run !== null && Boolean(run.learner);
  const what = silent ? "no answer" : run === null ? "waiting" : learning ? "learning" : over() ? "has ended" : "nobody learns now";
  at("state").textContent = silent && run !== null ? "no answer: the server has ended" : what;
  at("state").className = `chip ${silent ? "lost" : learning ? "learning" : ""}`;
  if (run !== null) {
    const age = Math.max(0, Date.now() / 1000 - run.written);
    at("written").textContent = `${new Date(1000 * run.written).toLocaleTimeString()}, ${seconds(age)} ago`;
  }
}

function draw() {
  if (run === null) return;
  drawCurve();
  drawMap();
  drawPolicy();
}

async function ask() {
  try {
    const answer = await fetch("run.json", { cache: "no-store", signal: AbortSignal.timeout(PATIENCE) });
    const told = await answer.json();
    answered = Date.now();
    if (told.trouble !== undefined) {
      trouble(told.trouble);
    } else {
      run = told;
      trouble(run.stuck.length ? run.stuck.at(-1) : "");
      tell();
      const version = `${run.name} ${run.checkpoint} ${run.t}`;
      if (version !== drawn) draw();
      drawn = version;
    }
  } catch (error) {
    if (!(error instanceof TypeError || error.name === "TimeoutError" || error.name === "SyntaxError")) throw error;
  } finally {
    chip();
    setTimeout(ask, EVERY);
  }
}

addEventListener("resize", draw);
ask();
