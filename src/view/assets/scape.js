// Energyscapes in polar form: colours, the table that leads from a pixel to its cell, and a sensor's own picture.
//
// What a sensor cannot see is hatched and never has the colour of silence; what holds no number is magenta.

export const LOW_DB = -70;
export const HIGH_DB = -20;
export const GROUND = "#0a0e13";
export const INK = "#e8eef3";
const OUTSIDE = -1;
const DEAF = -2;
const INFERNO = [
  [0, 0, 4], [22, 11, 57], [66, 10, 104], [106, 23, 110], [147, 38, 103], [188, 55, 84],
  [221, 81, 58], [243, 120, 25], [252, 165, 10], [246, 215, 70], [252, 255, 164],
];
const packed = (r, g, b, a = 255) => ((a << 24) | (b << 16) | (g << 8) | r) >>> 0;
const UNSEEN = packed(44, 54, 63);
const UNSEEN_LINE = packed(70, 84, 96);
const BROKEN = packed(255, 0, 255);

function inferno(share) {
  const at = Math.min(Math.max(share, 0), 1) * (INFERNO.length - 1);
  const index = Math.min(Math.floor(at), INFERNO.length - 2);
  return INFERNO[index].map((low, channel) => Math.round(low + (INFERNO[index + 1][channel] - low) * (at - index)));
}

const tables = new Map();
function colours(image) {
  const key = `${image.floorDb} ${image.stepDb}`;
  if (!tables.has(key)) {
    const table = new Uint32Array(256);
    for (let code = 1; code < 255; code++) {
      const db = image.floorDb + (code - 1) * image.stepDb;
      table[code] = packed(...inferno((db - LOW_DB) / (HIGH_DB - LOW_DB)));
    }
    table[255] = BROKEN;
    tables.set(key, table);
  }
  return tables.get(key);
}

export function drawScale(canvas) {
  const context = canvas.getContext("2d");
  const picture = context.createImageData(canvas.width, 1);
  const pixels = new Uint32Array(picture.data.buffer);
  pixels.forEach((_, x) => { pixels[x] = packed(...inferno(x / (canvas.width - 1))); });
  context.putImageData(picture, 0, 0);
}

/** Fits a canvas to its place on the screen; true when that changed its size. */
export function fit(canvas, ratioMax = 2) {
  const ratio = Math.min(window.devicePixelRatio || 1, ratioMax);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width === width && canvas.height === height) return false;
  canvas.width = width;
  canvas.height = height;
  return true;
}

const sameGrid = (a, b) => a && a.bearings === b.bearings && a.ranges === b.ranges && a.bearingFirst === b.bearingFirst
  && a.bearingStep === b.bearingStep && a.rangeFirst === b.rangeFirst && a.rangeStep === b.rangeStep;

/** Of every pixel the cell that lies there. `local(x, y)` gives the place in the sensor's frame, metres. */
function cellTable(image, width, height, local) {
  const table = new Int32Array(width * height);
  for (let y = 0, index = 0; y < height; y++) {
    for (let x = 0; x < width; x++, index++) {
      const [ahead, left] = local(x + 0.5, y + 0.5);
      const bearing = Math.round((Math.atan2(left, ahead) - image.bearingFirst) / image.bearingStep);
      const range = Math.round((Math.hypot(ahead, left) - image.rangeFirst) / image.rangeStep);
      const outside = bearing < 0 || bearing >= image.bearings || range >= image.ranges;
      table[index] = outside ? OUTSIDE : range < 0 ? DEAF : bearing * image.ranges + range;
    }
  }
  return table;
}

/** What several sensors hear, laid over each other on one piece of ground: the loudest counts. */
export class Ground {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.layers = [];
    this.key = "";
  }

  /** Draws `images` for `sensors` (poses; null is the sensor's own frame) into a picture of this size. */
  draw(images, sensors, width, height, origin, scale) {
    const key = [width, height, ...origin, scale].join(" ");
    if (key !== this.key) {
      [this.key, this.layers] = [key, []];
      [this.canvas.width, this.canvas.height] = [width, height];
      this.picture = this.canvas.getContext("2d").createImageData(width, height);
      this.pixels = new Uint32Array(this.picture.data.buffer);
    }
    const shown = [];
    images.forEach((image, index) => {
      const sensor = sensors[index];
      if (!image || sensor === undefined) return;
      if (!sameGrid(this.layers[index]?.image, image)) {
        const [x, y, heading] = sensor === null ? [0, 0, 0] : [sensor.x_m, sensor.y_m, sensor.heading_rad];
        const [sin, cos] = [Math.sin(heading), Math.cos(heading)];
        const local = (px, py) => {
          const [ahead, left] = [(origin[1] - py) / scale - x, (origin[0] - px) / scale - y];
          return [ahead * cos + left * sin, left * cos - ahead * sin];
        };
        this.layers[index] = { image, table: cellTable(image, width, height, local) };
      }
      shown.push([this.layers[index].table, image.codes, colours(image)]);
    });
    this.fill(shown, width);
    this.canvas.getContext("2d").putImageData(this.picture, 0, 0);
    return this.canvas;
  }

  fill(shown, width) {
    const pixels = this.pixels;
    for (let index = 0; index < pixels.length; index++) {
      let code = 0;
      let touched = false;
      let colour = null;
      for (const [table, codes, palette] of shown) {
        const cell = table[index];
        if (cell === OUTSIDE) continue;
        touched = true;
        const own = cell >= 0 ? codes[cell] : 0;
        if (own > code) [code, colour] = [own, palette];
      }
      if (code > 0) pixels[index] = colour[code];
      else if (!touched) pixels[index] = 0;
      else pixels[index] = (index % width + Math.floor(index / width)) % 8 < 3 ? UNSEEN_LINE : UNSEEN;
    }
  }
}

/** Writes over a picture so that it can be read on any colour. */
export function label(context, text, x, y, colour = INK, align = "center") {
  context.textAlign = align;
  context.textBaseline = "middle";
  context.lineJoin = "round";
  context.lineWidth = 3.5 * (context.dotSize || 1);
  context.strokeStyle = "rgba(6, 9, 13, .85)";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

/** Greys out a picture that is not of now, and says so. */
export function veil(context, text, width, height, dot) {
  context.globalCompositeOperation = "source-atop";
  context.fillStyle = "rgba(10, 14, 19, .62)";
  context.fillRect(0, 0, width, height);
  context.globalCompositeOperation = "source-over";
  context.font = `650 ${14 * dot}px system-ui, sans-serif`;
  context.dotSize = dot;
  label(context, text, width / 2, height / 2, "#ff9d96");
}

/** A sensor's own picture: boresight up, left is left. */
export class Fan {
  constructor(canvas) {
    this.canvas = canvas;
    this.ground = new Ground();
  }

  draw(image, reach, marks, stale) {
    const { canvas } = this;
    const full = image && Math.max(Math.abs(image.bearingFirst), Math.abs(image.bearingFirst + image.bearingStep * image.bearings)) > 1.7;
    canvas.style.aspectRatio = full ? "1" : "1.86";
    fit(canvas, 1.5);
    const [width, height] = [canvas.width, canvas.height];
    const dot = width / Math.max(canvas.clientWidth, 1);
    const margin = 15 * dot;
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    const origin = [Math.round(width / 2), full ? Math.round(height / 2) : Math.round(height - margin)];
    const radius = Math.min(width / 2 - margin, full ? height / 2 - margin : origin[1] - margin);
    const scale = radius / reach;
    context.font = `${11 * dot}px system-ui, sans-serif`;
    context.dotSize = dot;
    if (!image) {
      label(context, stale || "no image yet", width / 2, height / 2, "#9fb0be");
      return;
    }
    context.drawImage(this.ground.draw([image], [null], width, height, origin, scale), 0, 0);
    this.rings(context, origin, scale, reach, full, dot);
    for (const mark of marks) {
      const [x, y] = [origin[0] - mark.range * scale * Math.sin(mark.bearing), origin[1] - mark.range * scale * Math.cos(mark.bearing)];
      context.beginPath();
      context.arc(x, y, 8 * dot, 0, 2 * Math.PI);
      context.lineWidth = 2.5 * dot;
      context.strokeStyle = mark.colour;
      context.stroke();
    }
    if (stale) veil(context, stale, width, height, dot);
  }

  rings(context, origin, scale, reach, full, dot) {
    const [from, to] = full ? [0, 2 * Math.PI] : [Math.PI, 2 * Math.PI];
    context.lineWidth = dot;
    context.strokeStyle = "rgba(232, 238, 243, .2)";
    for (let range = 1; range <= reach + 1e-6; range++) {
      context.beginPath();
      context.arc(...origin, range * scale, from, to);
      context.stroke();
    }
    for (let range = 1; range < reach - 0.3; range += reach > 6 ? 2 : 1) label(context, `${range} m`, origin[0], origin[1] - range * scale, "#cdd8e1");
    for (const degrees of [-60, -30, 30, 60]) {
      const [sin, cos] = [Math.sin(degrees * Math.PI / 180), Math.cos(degrees * Math.PI / 180)];
      const far = reach * scale + 8 * dot;
      context.fillStyle = getComputedStyle(this.canvas).color;
      context.textAlign = degrees > 0 ? "right" : "left";
      context.textBaseline = "middle";
      context.fillText(`${Math.abs(degrees)}°`, origin[0] - far * sin, origin[1] - far * cos);
    }
  }
}
