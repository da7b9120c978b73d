// The outline of a plane, drawn on the recorded depth and saved to planes.yaml.
import { find } from './panel.js';

const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const FAST = 10, MOST = 100, LEAST = 3;

export class Region {
  // `planes` has the names of all planes, and the outlines by name in each recording.
  constructor(panel, recording, { names, outlines }) {
    Object.assign(this, { panel, recording, names, saved: outlines[recording], cursor: null, corners: [] });
    const { outline, plane, region, save, undo } = panel.part;
    this.canvas = outline;
    outline.hidden = region.hidden = false;
    this.list();
    plane.value = names[0] ?? 'plane';
    plane.addEventListener('input', () => this.open());
    undo.addEventListener('click', () => this.remove());
    save.addEventListener('click', () => this.save());
    outline.addEventListener('keydown', (event) => this.key(event));
    for (const name of ['focus', 'blur']) outline.addEventListener(name, () => this.draw());
    outline.addEventListener('pointermove', (event) => {
      panel.pointer = { kind: 'simulated', x: event.offsetX, y: event.offsetY };
      panel.readOut();
    });
    outline.addEventListener('pointerleave', () => { panel.pointer = null; panel.readOut(); });
    outline.addEventListener('click', ({ offsetX, offsetY }) => {
      const { width, height } = panel.frame;
      this.cursor = [offsetX / outline.clientWidth * width, offsetY / outline.clientHeight * height].map(Math.floor);
      this.add();
    });
    this.open();
  }

  list() {
    find('planes').replaceChildren(...this.names.map((name) => new Option(name, name)));
  }

  // What is saved of the plane that is chosen.
  open() {
    this.corners = [...(this.saved[this.panel.part.plane.value] ?? [])];
    this.tell(this.corners.length ? 'saved' : '');
  }

  tell(text, refused = false) {
    const state = this.panel.part['region-state'];
    const count = `${this.corners.length} corner${this.corners.length === 1 ? '' : 's'}`;
    state.textContent = text ? `${count}: ${text}` : count;
    state.classList.toggle('refused', refused);
    this.draw();
  }

  add() {
    if (this.corners.length < MOST) this.corners.push([...this.cursor]);
    this.tell('not saved');
  }

  remove() {
    this.corners.pop();
    this.tell('not saved');
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || !this.panel.frame) return;
    const { width, height } = this.panel.frame;
    this.cursor ??= [width >> 1, height >> 1];
    if (event.code in STEPS) {
      const step = event.shiftKey ? FAST : 1;
      this.cursor = STEPS[event.code].map((by, at) => Math.max(0, Math.min([width, height][at] - 1, this.cursor[at] + by * step)));
      this.tell(`cursor at ${this.cursor.join(', ')}`);
    } else if (event.code === 'Enter') this.add();
    else if (event.code === 'Backspace') this.remove();
    else if (event.code === 'KeyS') this.save();
    else return;
    event.preventDefault();
    event.stopPropagation();  // The arrow keys are not those of the player here.
  }

  async save() {
    const name = this.panel.part.plane.value.trim(), { corners } = this;
    if (!name) return this.tell('give the plane a name', true);
    if (corners.length < LEAST) return this.tell(`needs ${LEAST} or more`, true);
    try {
      const answer = await fetch('outline', { method: 'POST', body: JSON.stringify({ outline: [this.recording, name, corners] }) });
      if (!answer.ok) return this.tell(await answer.text(), true);
    } catch {
      return this.tell('not saved: connection lost', true);
    }
    this.saved[name] = [...corners];
    if (!this.names.includes(name)) this.names.push(name);
    this.list();
    return this.tell(`saved as ${name}`);
  }

  draw() {
    const { canvas, cursor } = this, { frame, part } = this.panel;
    if (!frame) return;
    canvas.width = canvas.clientWidth * devicePixelRatio;
    canvas.height = canvas.clientHeight * devicePixelRatio;
    const pen = canvas.getContext('2d');
    // Corners are centres of pixels.
    const at = ([u, v]) => [(u + 0.5) / frame.width * canvas.width, (v + 0.5) / frame.height * canvas.height];
    for (const [name, corners] of Object.entries(this.saved)) {
      if (name !== part.plane.value) line(pen, corners.map(at), '#c8ced8', 1);
    }
    line(pen, this.corners.map(at), '#ffffff', 2 * devicePixelRatio);
    pen.fillStyle = '#ffffff';
    for (const [x, y] of this.corners.map(at)) pen.fillRect(x - 4, y - 4, 8, 8);
    if (cursor && document.activeElement === canvas) {
      const [x, y] = at(cursor);
      line(pen, [[x - 12, y], [x + 12, y]], '#ffffff', 2);
      line(pen, [[x, y - 12], [x, y + 12]], '#ffffff', 2);
    }
  }
}

// A closed line, with a dark edge that shows on bright depth.
function line(pen, points, colour, width) {
  if (!points.length) return;
  pen.beginPath();
  for (const point of points) pen.lineTo(...point);
  pen.closePath();
  for (const [style, wide] of [['#000000', width + 3], [colour, width]]) {
    pen.strokeStyle = style;
    pen.lineWidth = wide;
    pen.stroke();
  }
}
