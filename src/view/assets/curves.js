// Curves over the last minute. A line ends where nothing was heard: no value is carried on.

import { fit } from "/scape.js";

export const SPAN_MS = 60000;
const GAP_MS = 600;

const niceStep = (span) => {
  const rough = span / 3;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= rough * 0.99);
};

/** Draws `lines` ({key, colour, wide, dashes}) of `points` up to `endMs` between `low` and `high` at least. */
export function drawCurve(canvas, points, endMs, { lines, low, high, ticks = [], strip = null }) {
  fit(canvas);
  const style = getComputedStyle(document.documentElement);
  const ink = (name) => style.getPropertyValue(`--${name}`).trim();
  const [width, height] = [canvas.width, canvas.height];
  const dot = width / Math.max(canvas.clientWidth, 1);
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, width, height);
  const shown = points.filter((point) => point.t_ms > endMs - SPAN_MS && point.t_ms <= endMs + 50);
  const values = shown.flatMap((point) => lines.map((line) => point[line.key])).filter((value) => Number.isFinite(value));
  let [bottom, top] = [Math.min(low, ...values), Math.max(high, ...values)];
  const step = niceStep(top - bottom);
  [bottom, top] = [Math.floor(bottom / step + 1e-9) * step, Math.ceil(top / step - 1e-9) * step];
  const area = { left: 38 * dot, right: width - 6 * dot, top: 6 * dot, bottom: height - (strip ? 26 : 19) * dot };
  const x = (time) => area.right - (endMs - time) / SPAN_MS * (area.right - area.left);
  const y = (value) => area.bottom - (value - bottom) / (top - bottom) * (area.bottom - area.top);
  context.font = `${11 * dot}px system-ui, sans-serif`;
  context.lineWidth = dot;
  context.textBaseline = "middle";
  for (let value = bottom; value <= top + step / 2; value += step) {
    context.strokeStyle = ink(Math.abs(value) < step / 1e6 ? "quiet" : "faint");
    context.beginPath();
    context.moveTo(area.left, Math.round(y(value)) + 0.5);
    context.lineTo(area.right, Math.round(y(value)) + 0.5);
    context.stroke();
    context.fillStyle = ink("quiet");
    context.textAlign = "right";
    context.fillText(String(+value.toFixed(3)), area.left - 6 * dot, y(value));
  }
  for (let second = 0; second <= 60; second += 15) {
    context.textAlign = second === 0 ? "right" : second === 60 ? "left" : "center";
    context.fillText(second === 0 ? "now" : `−${second} s`, x(endMs - second * 1000), height - 6 * dot);
  }
  context.save();
  context.beginPath();
  context.rect(area.left, 0, area.right - area.left, height);
  context.clip();
  for (const time of ticks) {
    context.fillStyle = ink("bad");
    context.fillRect(x(time) - dot, area.top, 2 * dot, 9 * dot);
  }
  if (strip) drawStrip(context, shown, x, area.bottom + 3 * dot, 5 * dot, (point) => ink(strip(point)));
  for (const line of lines) drawLine(context, shown, line, x, y, ink(line.colour), dot);
  context.restore();
}

function drawLine(context, points, { key, wide = 2, dashes = [] }, x, y, colour, dot) {
  context.strokeStyle = colour;
  context.lineWidth = wide * dot;
  context.lineJoin = "round";
  context.setLineDash(dashes.map((dash) => dash * dot));
  context.beginPath();
  let last = null;
  for (const point of points) {
    if (!Number.isFinite(point[key])) {
      last = null;
      continue;
    }
    const joined = last !== null && point.t_ms - last < GAP_MS;
    context[joined ? "lineTo" : "moveTo"](x(point.t_ms), y(point[key]));
    last = point.t_ms;
  }
  context.stroke();
  context.setLineDash([]);
}

function drawStrip(context, points, x, top, height, colour) {
  points.forEach((point, index) => {
    const next = points[index + 1];
    const until = next && next.t_ms - point.t_ms < GAP_MS ? next.t_ms : point.t_ms + 100;
    context.fillStyle = colour(point);
    context.fillRect(x(point.t_ms), top, Math.max(x(until) - x(point.t_ms), 1) + 0.5, height);
  });
}
