// The page: one column for each camera, fed by a websocket.
import { Cloud } from './cloud.js';
import { drawBars, drawDepth, drawDifference, read, unpack } from './draw.js';
import { driving } from './drive.js';
import { Effects } from './effects.js';

const RETRY_MS = 1000;
const find = (id) => document.getElementById(id);
const cameras = new Map();
let socket = null;
let depthMost = 4, differenceMost = 0.03, wiped = 0;
let drawing = false;
let obeyed = true;

const send = (message) => { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };

class Camera {
  constructor(name) {
    this.name = name;
    this.frame = null;
    this.undrawn = 0;
    this.dirty = false;
    this.answer = null;
    this.drawn = [];
    this.section = find('camera').content.firstElementChild.cloneNode(true);
    this.section.dataset.camera = name;
    this.part = {};
    for (const element of this.section.querySelectorAll('[data-part]')) this.part[element.dataset.part] = element;
    this.section.querySelector('h2').textContent = name;
    this.cloud = new Cloud(this.part.cloud, () => { this.dirty = true; drawSoon(); });
    this.part.usecase.addEventListener('change', ({ target }) => {
      send({ usecase: [name, target.value] });
      target.blur();
    });
    this.effects = new Effects(this.part, (effect, strength) => send({ effect: [name, effect, strength] }));
    for (const kind of ['clean', 'simulated', 'difference']) {
      const canvas = this.part[kind];
      canvas.addEventListener('pointermove', (event) => { this.pointer = { kind, x: event.offsetX, y: event.offsetY }; this.readOut(); });
      canvas.addEventListener('pointerleave', () => { this.pointer = null; this.readOut(); });
    }
    find('nothing')?.remove();
    const after = [...find('cameras').children].find((other) => other.dataset.camera > name);
    find('cameras').insertBefore(this.section, after ?? null);
  }

  take(frame) {
    this.frame = frame;  // One that has not been drawn yet is given up: the newest counts.
    this.undrawn += 1;
    this.dirty = true;
    drawSoon();
  }

  draw() {
    if (!this.dirty || !this.frame) return;
    this.dirty = false;
    drawDepth(this.part.clean, this.frame, this.frame.clean, depthMost);
    drawDepth(this.part.simulated, this.frame, this.frame.simulated, depthMost, this.frame.clean, wiped);
    drawDifference(this.part.difference, this.frame, differenceMost);
    this.cloud.draw(this.frame, depthMost);
    this.readOut();
    if (this.undrawn) this.drawn.push(performance.now());
    for (; this.undrawn; this.undrawn -= 1) send({ drawn: this.name });
  }

  readOut() {
    for (const kind of ['clean', 'simulated', 'difference']) {
      const canvas = this.part[kind];
      let text = kind === 'simulated' || !this.frame || this.frame.clean ? '' : 'not available';
      if (this.pointer?.kind === kind && this.frame) {
        const u = Math.floor(this.pointer.x / canvas.clientWidth * this.frame.width);
        const v = Math.floor(this.pointer.y / canvas.clientHeight * this.frame.height);
        if (u >= 0 && v >= 0 && u < this.frame.width && v < this.frame.height) text = read(this.frame, kind, u, v);
      }
      canvas.parentElement.querySelector('.read').textContent = text;
    }
  }

  tell(status) {
    const number = (value, digits, unit) => (value === null ? '–' : `${value.toFixed(digits)} ${unit}`);
    const now = performance.now();
    this.drawn = this.drawn.filter((time) => now - time < 2000);
    const seconds = this.drawn.length > 1 ? (this.drawn.at(-1) - this.drawn[0]) / 1000 : Infinity;
    this.part.clean_hz.textContent = number(status.clean_hz, 1, 'Hz');
    this.part.hz.textContent = number(status.hz, 1, 'Hz');
    this.part.latency.textContent = number(status.latency_ms, 1, 'ms');
    this.part.invalid.textContent = number(status.invalid === null ? null : 100 * status.invalid, 1, '%');
    this.part.drawn.textContent = number((this.drawn.length - 1) / seconds || 0, 0, 'Hz');
    this.part.problem.textContent = status.problem;
    this.section.classList.toggle('stale', status.stale);
    this.section.querySelector('h2').title = status.node;
    this.offer(status);
    this.effects.tell(status.strengths ?? {});
    // An answer that was there before this page was to somebody else.
    const { number: latest = 0 } = status.answer;
    this.answer ??= latest;
    if (latest !== this.answer) {
      this.answer = latest;
      const element = this.section.querySelector('.answer');
      element.textContent = status.answer.text;
      element.title = status.answer.text;
      element.classList.toggle('refused', !status.answer.ok);
    }
  }

  // What the node says, whatever was chosen here.
  offer({ usecase, usecases }) {
    const select = this.part.usecase;
    if (document.activeElement === select) return;
    if ([...select.options].map((option) => option.value).join() !== usecases.join()) {
      select.replaceChildren(...usecases.map((name) => new Option(name)));
    }
    select.value = usecase;
    select.disabled = !usecases.length;
  }
}

function drawSoon() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    for (const camera of cameras.values()) camera.draw();
  });
}

function camera(name) {
  if (!cameras.has(name)) cameras.set(name, new Camera(name));
  return cameras.get(name);
}

function tell(status) {
  obeyed = status.obeyed ?? obeyed;
  for (const one of status.cameras ?? []) camera(one.name).tell(one);
  if (!status.drive) return;
  const moving = drive.velocity();
  find('drive-topic').textContent = status.drive.topic;
  const state = find('drive-state');
  state.classList.toggle('moving', Boolean(moving) && status.drive.listeners > 0);
  const held = obeyed ? 'driving' : 'stopped by another page: release the key to drive on';
  state.textContent = status.drive.listeners ? (moving ? held : '') : 'no robot subscribes (start go1_cameras with motion:=cmd_vel)';
}

function connect() {
  // The query has the token, if there is one.
  socket = new WebSocket(`ws://${location.host}/live${location.search}`);
  socket.binaryType = 'arraybuffer';
  const state = find('connection');
  socket.onopen = () => {
    state.textContent = 'live';
    state.className = '';
    document.body.classList.remove('lost');
    for (const one of cameras.values()) one.undrawn = 0;
    obeyed = true;
  };
  socket.onmessage = ({ data }) => {
    if (typeof data === 'string') tell(JSON.parse(data));
    else {
      const frame = unpack(data);
      camera(frame.camera).take(frame);
    }
  };
  socket.onclose = () => {
    state.textContent = 'connection lost, reconnecting';
    state.className = 'off';
    document.body.classList.add('lost');
    drive.stop();
    setTimeout(connect, RETRY_MS);
  };
}

const drive = driving(find('pad'), find('speed'), find('speed-text'), (velocity) => send({ drive: velocity }));
for (const [id, apply] of [
  ['depth-range', (value) => { depthMost = value; find('depth-most').textContent = `${value.toFixed(1)} m`; }],
  ['wipe', (value) => { wiped = value / 100; }],
  ['difference-range', (value) => {
    differenceMost = value / 1000;
    find('difference-least').textContent = `−${value} mm`;
    find('difference-most').textContent = `+${value} mm`;
  }],
]) {
  find(id).addEventListener('input', ({ target }) => {
    apply(Number(target.value));
    for (const one of cameras.values()) one.dirty = true;
    drawSoon();
  });
}
drawBars(find('depth-bar'), find('difference-bar'));
connect();
