// The page: takes moments from the link, keeps the last ones for stepping, shows one of them and how old it is.
//
// What is old is never shown as new: every value has the time it was made, and whatever is beyond its age is greyed and named.

import { Link } from "/link.js";
import { Fan, HIGH_DB, LOW_DB, drawScale } from "/scape.js";
import { Plan, TONES } from "/plan.js";
import { SPAN_MS, drawCurve } from "/curves.js";

const KEPT = 150;
const STALE_MS = 1000;
const SILENT_MS = 3000;
const REACHES = [1, 1.5, 2, 2.5, 3, 4, 5, 6, 8];
const SHORT = {
  collision_avoidance: "collision", obstacle_avoidance: "obstacle", corridor_following: "corridor",
  flow_following: "flow lines", echoes: "echoes", detections: "detections",
};
const MOODS = {
  ACTIVE: "good", DEGRADED: "warn", READY: "warn", BOOT: "warn", SELFTEST: "warn", STOPPED: "bad", FAULT: "bad", SHUTDOWN: "bad",
  TRACK: "good", WAIT: "warn", HOLD: "bad", LATCHED: "bad",
};

const byId = (id) => document.getElementById(id);
const plan = new Plan(byId("plan"));
let robot = null;
let fans = [];
let points = [];
let kept = [];
let held = null;
let drawn = null;
let asked = false;

const words = (name) => (name || "–").replaceAll("_", " ");
// Adding zero takes the sign from a zero that rounding made.
const fixed = (value, digits) => (Number.isFinite(value) ? (+value.toFixed(digits) + 0).toFixed(digits).replace("-", "−") : "–");
const seconds = (ms) => (ms < 9950 ? `${(Math.max(ms, 0) / 1000).toFixed(ms < 995 ? 2 : 1)} s` : ms < 120000 ? `${Math.round(ms / 1000)} s` : `${Math.round(ms / 60000)} min`);
const energy = (value) => (!Number.isFinite(value) ? "–" : value === 0 ? "0" : value > 1e9 ? "∞" : value >= 10 ? value.toFixed(1) : value >= 0.1 ? value.toFixed(2) : value.toFixed(4));
const degrees = (radians) => {
  const angle = Math.round(radians * 180 / Math.PI);
  return angle === 0 ? "ahead" : `${Math.abs(angle)}° ${angle > 0 ? "left" : "right"}`;
};
function put(id, text) {
  const element = typeof id === "string" ? byId(id) : id;
  if (element.textContent !== text) element.textContent = text;
}
function make(tag, text, attributes = {}) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

const link = new Link(greet, take, () => draw(true));

function greet(hello) {
  robot = hello.robot;
  points = hello.history.slice();
  [kept, held] = [[], null];
  const far = robot.regions.flatMap((region) => region.outlines_m.flat(2)).map(Math.abs).filter((value) => value < 20);
  const need = Math.max(...far, robot.radius_m * 3, 1) * 1.15;
  plan.reach = REACHES.find((reach) => reach >= Math.min(need, robot.range_max_m)) || REACHES.at(-1);
  buildLegend();
  buildFans();
  buildRows();
  document.title = "noctule";
}

function take(moment) {
  const { command, controller, health } = moment.state;
  if (command && points.at(-1)?.t_ms !== command.published_ms) {
    const now = moment.state.now_ms;
    const heard = (part, limit) => (part && now - part.heard_ms < limit ? part : null);
    const driven = heard(controller, 500);
    const fresh = heard(health, 500);
    points.push({
      t_ms: command.published_ms, linear_m_s: command.linear_m_s, angular_rad_s: command.angular_rad_s,
      driven_linear_m_s: driven?.linear_m_s, driven_angular_rad_s: driven?.angular_rad_s,
      latency_ms: fresh?.latency_ms, layer: robot.layers.indexOf(command.layer), dropped: fresh?.dropped,
    });
    while (points.length && points[0].t_ms < now - 2 * SPAN_MS) points.shift();
  }
  const last = kept.at(-1);
  // A moment without a new ping set only tells ages, and takes the place of the one before.
  if (last && last.state.command?.published_ms === command?.published_ms && last !== held) kept.pop();
  kept.push(moment);
  while (kept.length > KEPT) kept.shift();
  document.body.dataset.link = "open";
  requestDraw();
}

// ---- pause and step

function setHeld(moment) {
  held = moment;
  byId("pause").setAttribute("aria-pressed", String(held !== null));
  put("pause-word", held ? "Go on" : "Pause");
  draw(true);
}
function step(by) {
  if (!kept.length) return;
  const at = held ? kept.indexOf(held) : kept.length - 1;
  setHeld(kept[Math.min(Math.max((at < 0 ? 0 : at) + by, 0), kept.length - 1)]);
}
byId("pause").onclick = () => setHeld(held ? null : kept.at(-1) || null);
byId("back").onclick = () => step(-1);
byId("forth").onclick = () => step(1);
function zoom(by) {
  const at = REACHES.findIndex((reach) => reach >= plan.reach - 1e-6);
  plan.reach = REACHES[Math.min(Math.max(at + by, 0), REACHES.length - 1)];
  draw(true);
}
byId("zoom-in").onclick = () => zoom(-1);
byId("zoom-out").onclick = () => zoom(1);
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  draw(true);
}
const prefersLight = window.matchMedia("(prefers-color-scheme: light)");
setTheme(prefersLight.matches ? "light" : "dark");
prefersLight.onchange = () => setTheme(prefersLight.matches ? "light" : "dark");
byId("theme").onclick = () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const onButton = event.target.closest?.("button, input");
  const keys = { " ": () => byId("pause").click(), ArrowLeft: () => step(-1), ArrowRight: () => step(1), "+": () => zoom(-1), "-": () => zoom(1), t: () => byId("theme").click() };
  if (!keys[event.key] || (onButton && event.key === " ")) return;
  event.preventDefault();
  keys[event.key]();
});

// ---- what is built once

function buildLegend() {
  const legend = byId("layers-shown");
  legend.replaceChildren(...["echoes", "detections", ...robot.regions.map((region) => region.layer).reverse(), ...(robot.flow_lines.length ? ["flow_following"] : [])].map((layer) => {
    const box = make("input", undefined, { type: "checkbox" });
    box.checked = plan.shown[layer];
    box.onchange = () => { plan.shown[layer] = box.checked; draw(true); };
    const row = make("label");
    row.style.setProperty("--tone", `var(--${layer}, var(--quiet))`);
    row.append(box, SHORT[layer]);
    return row;
  }));
}

function buildFans() {
  fans = robot.sensors.map((sensor) => {
    const figure = make("figure", undefined, { class: "fan" });
    const caption = make("figcaption");
    const note = make("span", "–");
    caption.append(make("b", sensor.name), note);
    const canvas = make("canvas", undefined, { role: "img" });
    figure.append(caption, canvas);
    return { figure, note, canvas, fan: new Fan(canvas), name: sensor.name };
  });
  byId("fans").replaceChildren(...fans.map((fan) => fan.figure));
  drawScale(byId("scale"));
  put("scale-low", fixed(LOW_DB, 0));
  put("scale-high", fixed(HIGH_DB, 0));
}

function buildRows() {
  const layers = ["collision_avoidance", "obstacle_avoidance", "flow_following", "corridor_following"];
  byId("layer-rows").replaceChildren(...layers.map((layer) => {
    const row = make("tr", undefined, { id: `row-${layer}` });
    row.style.setProperty("--tone", `var(--${layer})`);
    const compared = make("td");
    const bar = make("meter-bar");
    bar.append(make("i"), make("b"));
    compared.append(make("span", "–"), bar);
    row.append(make("th", words(layer), { scope: "row" }), compared, make("td", "–"));
    return row;
  }));
  byId("sensor-rows").replaceChildren(...robot.sensors.map((sensor, index) => {
    const row = make("tr", undefined, { id: `sensor-${index}` });
    row.append(make("th", sensor.name, { scope: "row" }), ...Array.from({ length: 5 }, () => make("td", "–")));
    return row;
  }));
  for (const id of ["bar-linear", "bar-angular"]) byId(id).replaceChildren(make("i"), make("b"));
}

// ---- drawing

function requestDraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => draw(false));
}
setInterval(() => draw(true), 250);
new ResizeObserver(() => draw(true)).observe(byId("main"));

function draw(again) {
  asked = false;
  const moment = held || kept.at(-1) || null;
  const state = moment?.state || null;
  const now = link.now();
  const age = (t) => (t === null || t === undefined || now === null ? Infinity : now - t);
  const commandAge = age(state?.command?.published_ms);
  const fresh = link.open && !held && commandAge < STALE_MS;
  document.body.dataset.fresh = String(fresh || held !== null);
  document.body.dataset.paused = String(held !== null);
  drawNotice(state, age, commandAge);
  drawChips(state, age);
  if (!robot || (moment === drawn && !again)) return;
  drawn = moment;
  const stale = held ? "" : !link.open ? "connection lost" : !state?.daemon ? "no daemon" : commandAge >= STALE_MS ? `old: ${seconds(commandAge)}` : "";
  drawCommand(state);
  drawLayers(state);
  drawHealth(state, age);
  plan.draw(robot, state, moment?.images || [], stale);
  put("zoom-reach", `±${plan.reach} m`);
  drawFans(state, moment, age);
  const end = held ? state.now_ms : now ?? 0;
  const strip = (point) => robot.layers[point.layer] || "quiet";
  const lines = (what) => [{ key: `${what}`, colour: "command" }, { key: `driven_${what}`, colour: "driven", wide: 2, dashes: [2, 3] }];
  drawCurve(byId("curve-linear"), points, end, { lines: lines("linear_m_s"), low: 0, high: robot.max_linear_m_s, strip });
  drawCurve(byId("curve-angular"), points, end, { lines: lines("angular_rad_s"), low: -robot.max_angular_rad_s, high: robot.max_angular_rad_s });
  const drops = points.filter((point, index) => index && point.dropped > points[index - 1].dropped).map((point) => point.t_ms);
  drawCurve(byId("curve-latency"), points, end, { lines: [{ key: "latency_ms", colour: "accent" }], low: 0, high: 20, ticks: drops });
}

function drawNotice(state, age, commandAge) {
  let [text, mood] = ["", "bad"];
  if (!link.open) {
    text = link.offset === null ? "Connecting to the page's server …" : `The connection to the page's server was lost ${seconds(performance.now() - link.lostAt)} ago: what is shown is old.`;
  } else if (held) {
    const newer = kept.length - 1 - kept.indexOf(held);
    [text, mood] = [`Paused. Shown is ping set ${held.state.command?.sequence ?? "–"}, ${seconds(age(held.state.now_ms))} old; ${newer} newer ${newer === 1 ? "one" : "ones"} to step to.`, "warn"];
  } else if (state?.trouble) {
    text = `The topics cannot be opened: ${state.trouble}`;
  } else if (!state?.daemon) {
    text = "No daemon is heard. Start one with “noctule run”, or a simulated robot with “noctule demo”.";
  } else if (age(state.daemon.heard_ms) > SILENT_MS) {
    text = `The daemon has been silent for ${seconds(age(state.daemon.heard_ms))}: what is shown is old.`;
  } else if (commandAge > STALE_MS) {
    text = `No command for ${seconds(commandAge)}: what is shown is old.`;
  } else if (!state.controller || age(state.controller.heard_ms) > STALE_MS) {
    [text, mood] = ["No controller is heard: nobody tells the platform to drive.", "warn"];
  }
  const notice = byId("notice");
  notice.hidden = text === "";
  notice.dataset.mood = mood;
  put(notice, text);
}

function chip(id, part, age, limit) {
  const silent = !part || age(part.heard_ms) > limit;
  byId(`chip-${id}`).dataset.mood = silent ? "off" : MOODS[part.state] || "warn";
  byId(`chip-${id}`).title = part?.reason || "";
  put(`${id}-state`, !part ? "not heard" : silent && !held ? `silent ${seconds(age(part.heard_ms))}` : part.state || "unknown");
}

function drawChips(state, age) {
  chip("daemon", state?.daemon, age, held ? Infinity : SILENT_MS);
  chip("controller", state?.controller, age, held ? Infinity : STALE_MS);
  const emitted = age(state?.command?.emitted_ms || null);
  byId("chip-age").dataset.mood = !Number.isFinite(emitted) ? "off" : emitted < 300 ? "good" : emitted < STALE_MS ? "warn" : "bad";
  put("ping-age", Number.isFinite(emitted) ? seconds(emitted) : "–");
}

/** A bar from the middle to either side, `share` from -1 to 1. */
function centred(id, share, mark) {
  const [bar, line] = byId(id).children;
  const width = Math.min(Math.abs(share || 0), 1) * 50;
  bar.style.left = `${share < 0 ? 50 - width : 50}%`;
  bar.style.width = `${width}%`;
  line.style.left = `${50 + mark}%`;
}

function drawCommand(state) {
  const command = state?.command;
  const controller = state?.controller;
  put("command-linear", fixed(command?.linear_m_s, 2));
  put("command-angular", fixed(command?.angular_rad_s, 2));
  put("driven-linear", fixed(controller?.linear_m_s, 2));
  put("driven-angular", fixed(controller?.angular_rad_s, 2));
  centred("bar-linear", (command?.linear_m_s || 0) / robot.max_linear_m_s, 0);
  // Left is left.
  centred("bar-angular", -(command?.angular_rad_s || 0) / robot.max_angular_rad_s, 0);
  const section = document.querySelector(".card.command");
  section.style.setProperty("--tone", `var(--${command?.layer || "quiet"})`);
  put("layer", words(command?.layer));
  put("why", command?.why || "Nothing was heard yet.");
  const refusal = controller?.refusal || "";
  byId("refusal").hidden = refusal === "";
  put("refusal", refusal);
}

function drawLayers(state) {
  const rows = new Map((state?.cues?.layers || []).map((row) => [row.layer, row]));
  if (state?.cues) {
    const { walls, wall_threshold_single: threshold } = state.cues;
    const nearest = walls.map((wall) => `${Math.abs(wall.lateral_m).toFixed(2)} m ${wall.lateral_m >= 0 ? "left" : "right"}`).slice(0, 2).join(", ");
    rows.set("flow_following", { energy: walls[0]?.strength ?? 0, threshold, text: nearest ? `wall ${nearest}` : "no wall" });
  }
  for (const element of byId("layer-rows").children) {
    const layer = element.id.slice(4);
    const row = rows.get(layer);
    const [, compared, nearest] = element.children;
    put(compared.firstChild, row ? `${energy(row.energy)} / ${energy(row.threshold)}` : "–");
    const [bar, mark] = compared.lastChild.children;
    // Two decades below the threshold to two above it.
    const share = row && row.energy > 0 && row.threshold > 0 ? (Math.log10(row.energy / row.threshold) + 2) / 4 : 0;
    bar.style.width = `${Math.min(Math.max(share, 0), 1) * 100}%`;
    mark.style.left = "50%";
    put(nearest, row?.text || (row?.nearest ? `${row.nearest.sensor} ${row.nearest.range_m.toFixed(2)} m, ${degrees(row.nearest.bearing_rad)}` : "–"));
    element.toggleAttribute("aria-current", false);
    if (state?.command?.layer === layer) element.setAttribute("aria-current", "true");
  }
}

function drawFans(state, moment, age) {
  fans.forEach(({ figure, note, canvas, fan, name }, index) => {
    const image = moment?.images[index];
    const imageAge = age(image?.emittedMs);
    const stale = held ? "" : !link.open ? "connection lost" : image && imageAge >= STALE_MS ? `old: ${seconds(imageAge)}` : !image && state && !state.daemon ? "no daemon" : "";
    const { cause, layer } = state?.command || {};
    const marks = cause?.sensor_index === index && cause.range_m ? [{ range: cause.range_m, bearing: cause.bearing_rad, colour: TONES[layer] || "#fff" }] : [];
    figure.dataset.stale = String(stale !== "");
    const peak = state?.sensors[index]?.peak_dbfs;
    put(note, image ? `${stale || `${seconds(imageAge)} old`}${Number.isFinite(peak) ? ` · peak ${fixed(peak, 0)} dBFS` : ""}` : stale || "no image yet");
    canvas.setAttribute("aria-label", `Energyscape of ${name}: ${note.textContent}`);
    fan.draw(image, robot.range_max_m, marks, stale);
  });
}

function drawHealth(state, age) {
  const health = state?.health;
  put("backend", health ? `${health.backend || "?"} · ${health.adapter || "unknown"}` : "–");
  const count = (name, value, mood) => [name, value === undefined ? "–" : String(value), mood && value > 0 ? mood : ""];
  const time = (value) => (Number.isFinite(value) ? value.toFixed(1) : undefined);
  const cells = [
    count("Ping sets", health?.ping_sets), count("Dropped", health?.dropped, "warn"), count("Late", health?.late, "warn"), count("Stops", health?.stops, "warn"),
    ["Latency p50", health ? `${time(health.latency_p50_ms)} ms` : "–", ""], ["p99", health ? `${time(health.latency_p99_ms)} ms` : "–", ""],
    ["Max", health ? `${time(health.latency_max_ms)} ms` : "–", ""], count("GPU losses", health?.gpu_losses, "warn"),
    count("Obeyed", state?.controller?.accepted), count("Refused", state?.controller?.refused, "warn"),
    ["Way seen", Number.isFinite(state?.cues?.coverage_ahead_m) ? `${state.cues.coverage_ahead_m.toFixed(2)} m` : "–", ""],
    ["Health age", health ? seconds(age(health.heard_ms)) : "–", age(health?.heard_ms) > SILENT_MS && health ? "bad" : ""],
  ];
  const list = byId("numbers");
  if (list.children.length !== cells.length) {
    list.replaceChildren(...cells.map(([name]) => {
      const cell = make("div");
      cell.append(make("dt", name), make("dd", "–"));
      return cell;
    }));
  }
  cells.forEach(([, value, mood], index) => {
    put(list.children[index].lastChild, value);
    list.children[index].dataset.mood = mood;
  });
  (state?.sensors || []).forEach((sensor, index) => {
    const row = byId(`sensor-${index}`);
    if (!row) return;
    const shown = (value) => (value === null || value === undefined ? "–" : String(value));
    const values = [
      [sensor.delivers === null ? "–" : sensor.delivers ? "yes" : "no", sensor.delivers === null ? "" : sensor.delivers ? "good" : "bad"],
      [shown(sensor.bad_channels), sensor.bad_channels > 2 ? "bad" : sensor.bad_channels > 0 ? "warn" : ""],
      [shown(sensor.rejected), sensor.rejected > 0 ? "warn" : ""], [shown(sensor.gaps), sensor.gaps > 0 ? "warn" : ""],
      [fixed(sensor.peak_dbfs ?? NaN, 0), ""],
    ];
    values.forEach(([text, mood], column) => {
      put(row.children[column + 1], text);
      row.children[column + 1].dataset.mood = mood;
    });
  });
  put("epoch", state?.daemon ? `Daemon start ${state.daemon.epoch}: ${state.daemon.reason || "reason unknown"}` : "");
}
