// The point cloud: a few lines of software rendering, the same on every machine.
import { depthColours } from './draw.js';
import { Rays } from './rays.js';

const WIDTH = 448, HEIGHT = 344, FOCAL = 400;
const BACKGROUND = 0xff0f0c0b;
const SIDE = { yaw: 0.5, pitch: 0.3 };
const ALONG = { yaw: 0, pitch: 0 };

export class Cloud {
  constructor(canvas, changed) {
    canvas.width = WIDTH;
    canvas.height = HEIGHT;
    this.context = canvas.getContext('2d');
    this.image = new ImageData(WIDTH, HEIGHT);
    this.words = new Uint32Array(this.image.data.buffer);
    this.near = new Float32Array(WIDTH * HEIGHT);
    this.rays = new Rays();
    this.look = { ...SIDE, distance: 0, centre: null };
    const change = () => { changed(); };
    canvas.addEventListener('pointerdown', (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener('pointermove', (event) => {
      if (!event.buttons) return;
      this.look.yaw -= 0.008 * event.movementX;
      this.look.pitch = Math.max(-1.5, Math.min(1.5, this.look.pitch + 0.008 * event.movementY));
      change();
    });
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.look.distance = Math.max(0.3, Math.min(20, this.look.distance * Math.exp(0.001 * event.deltaY)));
      change();
    }, { passive: false });
    canvas.addEventListener('dblclick', () => {
      Object.assign(this.look, this.look.yaw || this.look.pitch ? ALONG : SIDE, { centre: null });
      change();
    });
  }

  // From the optical frame (x right, y down, z forward) to that of an eye which circles a point
  // on the axis: twelve numbers, row by row.
  aim() {
    const { yaw, pitch, distance, centre } = this.look;
    const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
    return [cy, 0, -sy, sy * centre,
      -sp * sy, cp, -sp * cy, sp * cy * centre,
      cp * sy, sp, cp * cy, distance - cp * cy * centre];
  }

  // The point is behind most of what is seen; it stays there while the robot walks.
  settle({ simulated, unit }) {
    const depths = simulated.filter((steps, at) => steps && at % 16 === 0).sort();
    if (!depths.length) return;
    this.look.centre = unit * depths[Math.floor(0.65 * depths.length)];
    this.look.distance = (this.look.yaw ? 2 : 1) * this.look.centre;
  }

  draw(frame, most) {
    const { words, near, image, context } = this;
    words.fill(BACKGROUND);
    near.fill(Infinity);
    if (!this.look.centre) this.settle(frame);
    const [a, b, c, d, e, f, g, h, i, j, k, l] = this.aim();
    const { simulated, unit } = frame, { x, y } = this.rays.of(frame);
    const factor = 256 / most;
    for (let at = 0; at < simulated.length; at++) {
      if (!simulated[at]) continue;
      const z = simulated[at] * unit, rx = x[at], ry = y[at];
      const depth = z * (i * rx + j * ry + k) + l;
      if (!(depth >= 0.05)) continue;  // nor where there is no ray
      const scale = FOCAL / depth;
      const px = WIDTH / 2 + scale * (z * (a * rx + b * ry + c) + d) | 0;
      const py = HEIGHT / 2 + scale * (z * (e * rx + f * ry + g) + h) | 0;
      if (px < 0 || py < 0 || px >= WIDTH - 1 || py >= HEIGHT - 1) continue;
      const colour = depthColours[Math.min(255, z * factor | 0)];
      const to = py * WIDTH + px;
      for (let there = to, n = 0; n < 4; n++, there += n === 2 ? WIDTH - 1 : 1) {
        if (depth < near[there]) {
          near[there] = depth;
          words[there] = colour;
        }
      }
    }
    context.putImageData(image, 0, 0);
    this.drawCamera(frame);
  }

  // The camera's view as a pyramid, 0.2 m long.
  drawCamera(frame) {
    const { width, height } = frame, { x, y } = this.rays.of(frame);
    const [a, b, c, d, e, f, g, h, i, j, k, l] = this.aim();
    const project = (px, py, z) => {
      const depth = i * px + j * py + k * z + l;
      return depth >= 0.05 ? [WIDTH / 2 + FOCAL * (a * px + b * py + c * z + d) / depth,
        HEIGHT / 2 + FOCAL * (e * px + f * py + g * z + h) / depth] : null;
    };
    const last = width * height - 1;
    const eye = project(0, 0, 0);
    const corners = [0, width - 1, last, last - width + 1].map((at) => project(0.2 * x[at], 0.2 * y[at], 0.2));
    if (!eye || corners.includes(null)) return;
    const { context } = this;
    context.strokeStyle = '#dfe5ee';
    context.lineWidth = 1;
    context.beginPath();
    corners.forEach((corner, at) => {
      const next = corners[(at + 1) % 4];
      context.moveTo(...eye);
      context.lineTo(...corner);
      context.lineTo(...next);
    });
    context.stroke();
  }
}
