// Live cameras: a column for each, fed by a websocket, and keys that drive the robot.
import { unpack } from './draw.js';
import { driving } from './drive.js';
import { Effects } from './effects.js';
import { find, Panel } from './panel.js';

const RETRY_MS = 1000;
const cameras = new Map();
let socket = null;
let drive = null;
let obeyed = true;

const send = (message) => { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };

class Camera extends Panel {
  constructor(name) {
    super(name);
    this.undrawn = 0;
    this.answer = null;
    this.times = [];
    this.part.choice.addEventListener('change', ({ target }) => {
      send({ usecase: [name, target.value] });
      target.blur();
    });
    this.effects = new Effects(this.part, (effect, strength) => send({ effect: [name, effect, strength] }));
    find('nothing')?.remove();
    const after = [...find('cameras').children].find((other) => other.dataset.camera > name);
    find('cameras').insertBefore(this.section, after ?? null);
  }

  take(frame) {
    this.undrawn += 1;
    super.take(frame);
  }

  drawn() {
    if (this.undrawn) this.times.push(performance.now());
    for (; this.undrawn; this.undrawn -= 1) send({ drawn: this.name });
  }

  tell(status) {
    const number = (value, digits, unit) => (value === null ? '–' : `${value.toFixed(digits)} ${unit}`);
    const now = performance.now();
    this.times = this.times.filter((time) => now - time < 2000);
    const seconds = this.times.length > 1 ? (this.times.at(-1) - this.times[0]) / 1000 : Infinity;
    this.part.clean_hz.textContent = number(status.clean_hz, 1, 'Hz');
    this.part.hz.textContent = number(status.hz, 1, 'Hz');
    this.part.latency.textContent = number(status.latency_ms, 1, 'ms');
    this.part.invalid.textContent = number(status.invalid === null ? null : 100 * status.invalid, 1, '%');
    this.part.drawn.textContent = number((this.times.length - 1) / seconds || 0, 0, 'Hz');
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
      const element = this.part.answer;
      element.textContent = status.answer.text;
      element.title = status.answer.text;
      element.classList.toggle('refused', !status.answer.ok);
    }
  }

  // What the node says, whatever was chosen here.
  offer({ usecase, usecases }) {
    const select = this.part.choice;
    if (document.activeElement === select) return;
    if ([...select.options].map((option) => option.value).join() !== usecases.join()) {
      select.replaceChildren(...usecases.map((name) => new Option(name)));
    }
    select.value = usecase;
    select.disabled = !usecases.length;
  }
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

// Show whatever the server has, and keep the connection.
export function live() {
  find('drive').hidden = false;
  drive = driving(find('pad'), find('speed'), find('speed-text'), (velocity) => send({ drive: velocity }));
  connect();
}
