// The robot from above, forward is up: what all sensors hear, the control regions, walls, the echo behind the command, the command.

import { Ground, INK, fit, label, veil } from "/scape.js";

const WALL = "#7cc0ff";
const COMMAND = "#4cc9dc";
const DRIVEN = "#ffb454";
const REFLECTOR = "#f4f1a6";
const OBSTACLE = "#ff6b8b";
/** Layers on the dark picture, whatever the theme. */
export const TONES = {
  collision_avoidance: "#f0883e", obstacle_avoidance: "#f2c744", flow_following: "#58a6ff",
  corridor_following: "#3fcf9f", pass_through: "#b8c4ce", stopped: "#d08be0",
};
/** How far ahead the command is drawn. */
const AHEAD_S = 2;
const FINENESS_MAX = 460;

export class Plan {
  constructor(canvas) {
    this.canvas = canvas;
    this.ground = new Ground();
    this.reach = 2.5;
    this.shown = { echoes: true, detections: true, collision_avoidance: true, obstacle_avoidance: true, corridor_following: true, flow_following: true };
  }

  draw(robot, state, images, stale) {
    const { canvas } = this;
    fit(canvas);
    const [width, height] = [canvas.width, canvas.height];
    const dot = width / Math.max(canvas.clientWidth, 1);
    const context = canvas.getContext("2d");
    context.fillStyle = "#0a0e13";
    context.fillRect(0, 0, width, height);
    if (!robot) return;
    const origin = [width / 2, height / 2];
    const scale = Math.min(width, height) / (2 * this.reach);
    Object.assign(this, { context, dot, origin, scale });
    context.dotSize = dot;
    context.font = `${11.5 * dot}px system-ui, sans-serif`;
    if (this.shown.echoes) this.drawEchoes(robot, images, width, height);
    this.drawRings(robot);
    this.drawRegions(robot);
    if (state?.cues && this.shown.flow_following) this.drawWalls(robot, state.cues);
    if (state && this.shown.detections) this.drawDetections(state);
    this.drawRobot(robot);
    if (state?.command) {
      this.drawCause(robot, state.command);
      this.drawCommand(robot, state);
    }
    if (stale) veil(context, stale, width, height, dot);
  }

  at(x, y) {
    return [this.origin[0] - y * this.scale, this.origin[1] - x * this.scale];
  }

  drawEchoes(robot, images, width, height) {
    const share = Math.min(1, FINENESS_MAX / width);
    const [w, h] = [Math.round(width * share), Math.round(height * share)];
    const picture = this.ground.draw(images, robot.sensors, w, h, [w / 2, h / 2], this.scale * share);
    this.context.imageSmoothingEnabled = true;
    this.context.drawImage(picture, 0, 0, width, height);
  }

  drawRings(robot) {
    const { context, dot } = this;
    const step = this.reach > 3.5 ? 2 : this.reach > 1.2 ? 1 : 0.5;
    context.strokeStyle = "rgba(232, 238, 243, .16)";
    context.lineWidth = dot;
    for (let ring = step; ring < this.reach * 1.5; ring += step) {
      context.beginPath();
      context.arc(...this.origin, ring * this.scale, 0, 2 * Math.PI);
      context.stroke();
      if (ring < this.reach * 0.97) label(context, `${ring} m`, ...this.at(-ring * 0.98, 0), "#cdd8e1");
    }
    label(context, "ahead", this.origin[0], 12 * dot, "#9fb0be");
  }

  drawRegions(robot) {
    const { context, dot } = this;
    if (this.shown.flow_following) {
      context.strokeStyle = "rgba(88, 166, 255, .3)";
      context.lineWidth = dot;
      for (const fan of robot.flow_lines) {
        const count = Math.floor((fan.lateral_m[1] - fan.lateral_m[0]) / fan.step_m + 1e-9);
        for (let index = 0; index <= count; index += count > 40 ? 2 : 1) {
          const lateral = fan.lateral_m[0] + index * fan.step_m;
          this.path([[fan.x_m[0], lateral], [fan.x_m[1], lateral]]);
          context.stroke();
        }
      }
    }
    for (const region of robot.regions) {
      if (!this.shown[region.layer]) continue;
      context.strokeStyle = TONES[region.layer];
      context.fillStyle = TONES[region.layer];
      context.lineWidth = 2 * dot;
      for (const outline of region.outlines_m) {
        this.path(outline);
        context.closePath();
        context.globalAlpha = 0.1;
        context.fill();
        context.globalAlpha = 0.9;
        context.stroke();
        context.globalAlpha = 1;
      }
    }
  }

  path(points) {
    this.context.beginPath();
    points.forEach(([x, y], index) => this.context[index ? "lineTo" : "moveTo"](...this.at(x, y)));
  }

  drawWalls(robot, cues) {
    const { context, dot } = this;
    const ends = robot.flow_lines.map((fan) => fan.x_m).flat();
    const half = Math.max(0.5, Math.min(this.reach * 0.45, Math.max(...ends.map(Math.abs), 0) * 2));
    for (const wall of cues.walls) {
      const sure = wall.strength >= cues.wall_threshold_single;
      context.strokeStyle = WALL;
      context.lineWidth = 4 * dot;
      context.lineCap = "round";
      context.setLineDash(sure ? [] : [9 * dot, 9 * dot]);
      this.path([[-half, wall.lateral_m], [half, wall.lateral_m]]);
      context.stroke();
      context.setLineDash([]);
      context.lineCap = "butt";
      const [x, y] = this.at(-half - 0.09 * this.reach / 2.5, wall.lateral_m);
      label(context, `wall ${Math.abs(wall.lateral_m).toFixed(2)} m`, x, y, WALL);
    }
  }

  /** Map, what is known to be free, reflectors, objects, and the way round an obstacle; all in the robot's frame. */
  drawDetections({ scan, obstacle, objects, now_ms }) {
    const fresh = (part) => part && now_ms - part.emitted_ms < 1000;
    if (fresh(objects)) this.drawMap(objects);
    if (fresh(scan)) this.drawScan(scan);
    if (fresh(objects)) objects.objects.forEach((object) => this.drawObject(object));
    if (fresh(obstacle)) this.drawObstacle(obstacle);
  }

  drawMap({ occupied, cell_m, cell_angle_rad }) {
    const { context } = this;
    const side = cell_m * this.scale;
    context.fillStyle = "rgba(255, 138, 101, .22)";
    for (const [x, y] of occupied) {
      context.save();
      context.translate(...this.at(x, y));
      context.rotate(-cell_angle_rad);
      context.fillRect(-side / 2, -side / 2, side, side);
      context.restore();
    }
  }

  drawScan({ first_rad, step_rad, near_m, free_m, peaks }) {
    const { context, dot } = this;
    context.fillStyle = "rgba(63, 207, 159, .07)";
    free_m.forEach((far, index) => {
      if (far <= near_m) return;
      const [from, to] = [first_rad + (index - 0.5) * step_rad, first_rad + (index + 0.5) * step_rad];
      const corner = (range, angle) => [range * Math.cos(angle), range * Math.sin(angle)];
      this.path([corner(near_m, from), corner(far, from), corner(far, to), corner(near_m, to)]);
      context.fill();
    });
    context.fillStyle = REFLECTOR;
    for (const [x, y] of peaks) {
      context.beginPath();
      context.arc(...this.at(x, y), 2.5 * dot, 0, 2 * Math.PI);
      context.fill();
    }
  }

  drawObject({ x_m, y_m, long_m, wide_m, angle_rad, score }) {
    const { context, dot } = this;
    context.save();
    context.translate(...this.at(x_m, y_m));
    context.rotate(-Math.PI / 2 - angle_rad);
    context.globalAlpha = 0.3 + 0.7 * score;
    context.strokeStyle = REFLECTOR;
    context.lineWidth = 1.5 * dot;
    context.beginPath();
    context.ellipse(0, 0, Math.max(long_m * this.scale, 3 * dot), Math.max(wide_m * this.scale, 3 * dot), 0, 0, 2 * Math.PI);
    context.stroke();
    context.restore();
  }

  drawObstacle({ follower, detected, place, route }) {
    const { context, dot } = this;
    if (!follower || follower === "IDLE") return;
    if (detected && place) {
      const [x, y] = this.at(...place);
      context.strokeStyle = OBSTACLE;
      context.lineWidth = 3 * dot;
      context.strokeRect(x - 7 * dot, y - 7 * dot, 14 * dot, 14 * dot);
      label(context, follower.toLowerCase(), x, y - 16 * dot, OBSTACLE);
    }
    if (route.length < 2) return;
    context.strokeStyle = OBSTACLE;
    context.lineWidth = 2 * dot;
    context.setLineDash([6 * dot, 4 * dot]);
    this.path(route);
    context.stroke();
    context.setLineDash([]);
  }

  drawRobot(robot) {
    const { context, dot } = this;
    context.lineWidth = 2 * dot;
    context.strokeStyle = INK;
    context.fillStyle = "rgba(20, 28, 36, .85)";
    context.beginPath();
    context.arc(...this.origin, robot.radius_m * this.scale, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
    for (const sensor of robot.sensors) {
      const along = (ahead, left) => this.at(
        sensor.x_m + ahead * Math.cos(sensor.heading_rad) - left * Math.sin(sensor.heading_rad),
        sensor.y_m + ahead * Math.sin(sensor.heading_rad) + left * Math.cos(sensor.heading_rad),
      );
      context.fillStyle = INK;
      context.beginPath();
      [[-0.05, -0.058], [0, -0.058], [0, 0.058], [-0.05, 0.058]].forEach(([a, l], i) => context[i ? "lineTo" : "moveTo"](...along(a, l)));
      context.fill();
      // Beside the boresight, where the command's arrow does not lie.
      const [x, y] = along(22 * dot / this.scale, Math.abs(sensor.heading_rad) < 0.4 ? 30 * dot / this.scale : 0);
      label(context, sensor.name, x, y);
    }
  }

  drawCause(robot, command) {
    const { cause } = command;
    const sensor = cause && robot.sensors[cause.sensor_index];
    if (!sensor || cause.range_m === null) return;
    const { context, dot } = this;
    const angle = sensor.heading_rad + cause.bearing_rad;
    const to = this.at(sensor.x_m + cause.range_m * Math.cos(angle), sensor.y_m + cause.range_m * Math.sin(angle));
    context.strokeStyle = TONES[command.layer] || INK;
    context.lineWidth = 2 * dot;
    context.setLineDash([4 * dot, 4 * dot]);
    context.beginPath();
    context.moveTo(...this.at(sensor.x_m, sensor.y_m));
    context.lineTo(...to);
    context.stroke();
    context.setLineDash([]);
    context.lineWidth = 3 * dot;
    context.beginPath();
    context.arc(...to, 9 * dot, 0, 2 * Math.PI);
    context.stroke();
    // Away from the robot, where no sensor's name stands.
    const [dx, dy] = [to[0] - this.origin[0], to[1] - this.origin[1]];
    const away = 27 * dot / Math.max(Math.hypot(dx, dy), 1);
    label(context, `${cause.range_m.toFixed(2)} m`, to[0] + 1.25 * dx * away, to[1] + dy * away, TONES[command.layer] || INK);
  }

  /** The way of the next two seconds, as commanded and as the platform is told. */
  drawCommand(robot, state) {
    const { command, controller } = state;
    this.drawWay(command.linear_m_s, command.angular_rad_s, COMMAND, 4, []);
    if (controller && controller.linear_m_s !== null) {
      this.drawWay(controller.linear_m_s, controller.angular_rad_s, DRIVEN, 2, [2, 4]);
    }
    if (Math.abs(command.linear_m_s) < 0.005 && Math.abs(command.angular_rad_s) < 0.02) return;
    if (Math.abs(command.linear_m_s) < 0.02) this.drawTurn(robot, command.angular_rad_s);
  }

  drawWay(linear, angular, colour, wide, dashes) {
    if (linear === null || angular === null || Math.abs(linear) < 0.005) return;
    const { context, dot } = this;
    const points = [];
    for (let index = 0; index <= 24; index++) {
      const time = AHEAD_S * index / 24;
      const turn = angular * time;
      const chord = Math.abs(angular) < 1e-6 ? linear * time : 2 * linear / angular * Math.sin(turn / 2);
      points.push([chord * Math.cos(turn / 2), chord * Math.sin(turn / 2)]);
    }
    context.strokeStyle = colour;
    context.lineWidth = wide * dot;
    context.setLineDash(dashes.map((dash) => dash * dot));
    this.path(points);
    context.stroke();
    context.setLineDash([]);
    if (!dashes.length) this.drawHead(points[22], points[24], colour);
  }

  drawTurn(robot, angular) {
    const { context, dot } = this;
    const radius = robot.radius_m + 0.07;
    const span = Math.max(-2.4, Math.min(2.4, angular * AHEAD_S));
    const points = Array.from({ length: 25 }, (_, index) => {
      const angle = span * index / 24;
      return [radius * Math.cos(angle), radius * Math.sin(angle)];
    });
    context.strokeStyle = COMMAND;
    context.lineWidth = 4 * dot;
    this.path(points);
    context.stroke();
    this.drawHead(points[22], points[24], COMMAND);
  }

  drawHead(from, to, colour) {
    const [[x0, y0], [x1, y1]] = [this.at(...from), this.at(...to)];
    const angle = Math.atan2(y1 - y0, x1 - x0);
    const size = 11 * this.dot;
    const { context } = this;
    context.fillStyle = colour;
    context.beginPath();
    context.moveTo(x1 + size * Math.cos(angle), y1 + size * Math.sin(angle));
    for (const side of [2.5, -2.5]) context.lineTo(x1 + size * Math.cos(angle + side), y1 + size * Math.sin(angle + side));
    context.fill();
  }
}
