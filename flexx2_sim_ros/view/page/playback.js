// Recordings: a column for each camera, a slider over time, and what depth is compared with.
import { signed, unpack } from './draw.js';
import { find, Panel } from './panel.js';
import { Region } from './region.js';

const PERCENT = 100, MILLIMETRES = 1000, RETRY_MS = 1000, SAME_SECONDS = 0.0005, WORST = 0.01;

class Recorded extends Panel {
  constructor(recording, camera, { name, usecase, start, stamps, references, notes }, planes) {
    super(name);
    this.address = { recording, camera };
    this.start = start;
    this.stamps = stamps;
    this.wanted = null;
    this.busy = false;
    this.differences = new Int32Array(0);
    this.part.numbers.hidden = true;
    this.part['recorded-numbers'].hidden = false;
    this.part.answer.hidden = true;
    this.part.mode.textContent = usecase || 'unknown';
    this.part.notes.textContent = notes.join('; ');
    this.part['choice-name'].textContent = 'compare with';
    this.part.choice.setAttribute('aria-label', 'compare with');
    this.part.choice.replaceChildren(...references.map(([key, text]) => new Option(text, key)));
    this.part.choice.disabled = !references.length;
    if (references.some(([key]) => key === 'effects')) this.part.choice.value = 'effects';
    this.part.choice.addEventListener('change', () => { this.show(this.number); });
    find('cameras').append(this.section);
    if (planes) this.region = new Region(this, recording, planes);
  }

  drawn() {
    this.region?.draw();
  }

  // The newest request counts; one at a time is sent.
  show(number) {
    this.number = number;
    this.wanted = number;
    if (!this.busy) this.load();
  }

  async load() {
    this.busy = true;
    while (this.wanted !== null) {
      const number = this.wanted;
      const { value, selectedOptions } = this.part.choice;
      this.wanted = null;
      try {
        const answer = await fetch(`frame?${new URLSearchParams({ ...this.address, number, reference: value })}`);
        connected(true);
        if (answer.ok) this.accept(number, unpack(await answer.arrayBuffer()), selectedOptions[0]?.text);
        else this.part['recorded-problem'].textContent = await answer.text();
      } catch {
        connected(false);
        clearTimeout(this.retry);
        this.retry = setTimeout(() => this.show(this.number), RETRY_MS);
      }
    }
    this.busy = false;
  }

  accept(number, frame, reference) {
    this.part['recorded-problem'].textContent = '';
    this.label('recorded depth', reference ?? 'no reference');
    this.part['difference-name'].textContent = `recorded − ${short(reference)}`;
    this.part['cloud-name'].textContent = 'recorded points';
    this.part.number.textContent = `${number + 1} / ${this.stamps.length}`;
    this.part.time.textContent = `${this.stamps[number].toFixed(3)} s`;
    this.part['recorded-invalid'].textContent = `${(PERCENT * invalid(frame.simulated)).toFixed(1)} %`;
    if (this.differences.length < frame.simulated.length) this.differences = new Int32Array(frame.simulated.length);
    frame.worst = {};
    for (const [kind, other] of [['difference', frame.clean], ['gap', frame.without]]) {
      const { text, worst } = differ(frame, other, this.differences);
      this.part[`${kind}-numbers`].textContent = text;
      frame.worst[kind] = worst;
    }
    this.take(frame);
  }

  remove() {
    clearTimeout(this.retry);
    super.remove();
  }

  // The latest frame at a stamp, in seconds.
  at(stamp) {
    return Math.max(0, after(this.stamps, stamp - this.start + SAME_SECONDS) - 1);
  }
}

const short = (reference) => (reference ?? 'reference').replace(' depth', '').replace(/^simulated with.*/, 'diagnosed');

function connected(is) {
  const state = find('connection');
  state.textContent = is ? 'recording' : 'connection lost';
  state.className = is ? '' : 'off';
  document.body.classList.toggle('lost', !is);
}

// How many stamps are at a time or before it.
function after(stamps, time) {
  let low = 0, high = stamps.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (stamps[middle] <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}

function invalid(image) {
  let count = 0;
  for (const steps of image) count += !steps;
  return count / image.length;
}

// Of the pixels that both images have: numbers in words, and how many steps the worst are apart.
// `room` is for the differences of all pixels.
function differ({ simulated, unit }, other, room) {
  let count = 0, sum = 0;
  for (let i = 0; other && i < other.length; i++) {
    if (simulated[i] && other[i]) room[count++] = simulated[i] - other[i];
  }
  if (!count) return { text: '', worst: Infinity };
  const steps = room.subarray(0, count), millimetres = MILLIMETRES * unit;
  const median = millimetres * steps.sort()[count >> 1];
  for (let i = 0; i < count; i++) sum += steps[i] = Math.abs(steps[i]);
  const worst = Math.max(1, steps.sort()[Math.floor((1 - WORST) * count)]);
  return {
    text: `median ${signed(median)}, size ${(millimetres * sum / count).toFixed(1)}, `
      + `worst ${PERCENT * WORST} % from ${(millimetres * worst).toFixed(0)} mm; ${(PERCENT * invalid(other)).toFixed(1)} % invalid`,
    worst,
  };
}

// The columns, the slider and the keys.
class Player {
  constructor(recordings, planes) {
    this.recordings = recordings;
    this.planes = planes;
    this.panels = [];
    this.number = 0;
    this.playing = null;
    this.slider = find('time-slider');
    this.button = find('play');
    this.slider.addEventListener('input', () => { this.pause(); this.go(Number(this.slider.value)); });
    this.button.addEventListener('click', () => this.toggle());
    find('earlier').addEventListener('click', () => this.step(-1));
    find('later').addEventListener('click', () => this.step(1));
    find('rate').addEventListener('change', () => { if (this.playing) this.play(); });
    addEventListener('keydown', (event) => this.key(event));
    document.addEventListener('visibilitychange', () => { if (document.hidden) this.pause(); });
    const choice = find('recording');
    choice.replaceChildren(...recordings.map(({ name }, at) => new Option(name, at)));
    choice.addEventListener('change', () => this.open(Number(choice.value)));
    find('recording-label').hidden = recordings.length < 2;
  }

  open(at) {
    this.pause();
    for (const panel of this.panels) panel.remove();
    this.panels = this.recordings[at].cameras.map((camera, number) => new Recorded(at, number, camera, this.planes));
    this.stamps = this.panels[0].stamps;
    this.slider.max = this.stamps.length - 1;
    this.go(0);
  }

  // Show a frame of the first camera, and what the others have recorded at its time.
  go(number) {
    this.number = Math.max(0, Math.min(this.stamps.length - 1, number));
    const time = this.stamps[this.number];
    const text = `frame ${this.number + 1} of ${this.stamps.length}, ${time.toFixed(2)} s`;
    this.slider.value = this.number;
    this.slider.setAttribute('aria-valuetext', text);
    find('time-text').textContent = text;
    for (const [at, panel] of this.panels.entries()) panel.show(at ? panel.at(this.panels[0].start + time) : this.number);
  }

  step(count) {
    this.pause();
    this.go(this.number + count);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.number === this.stamps.length - 1) this.go(0);
    const playing = { since: performance.now(), from: this.stamps[this.number], rate: Number(find('rate').value) };
    this.playing = playing;
    this.tell('pause');
    const tick = () => {
      if (this.playing !== playing) return;
      const time = playing.from + playing.rate * (performance.now() - playing.since) / 1000;
      const number = after(this.stamps, time) - 1;
      if (number > this.number) this.go(number);
      if (this.number === this.stamps.length - 1) this.pause();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    this.playing = null;
    this.tell('play');
  }

  tell(action) {
    this.button.dataset.action = action;
    this.button.setAttribute('aria-label', action);
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    // Of a control that has the focus, keys are its own; but a slider does nothing on space.
    if (event.target.closest(event.code === 'Space' ? 'select, button, summary, [type=checkbox]' : 'select, input')) return;
    const actions = {
      Space: () => this.toggle(),
      ArrowLeft: () => this.step(-1),
      ArrowRight: () => this.step(1),
      Home: () => this.step(-this.stamps.length),
      End: () => this.step(this.stamps.length),
    };
    if (!(event.code in actions)) return;
    event.preventDefault();
    actions[event.code]();
  }
}

export function playback({ headline, recordings, planes }) {
  document.body.classList.add('recorded');
  find('time').hidden = false;
  find('nothing').remove();
  find('headline').textContent = headline;
  find('about').hidden = !headline && recordings.length < 2;
  find('mark-label').hidden = false;
  find('wipe-name').textContent = 'wipe';
  find('wipe').setAttribute('aria-label', 'wipe between recorded depth and what it is compared with');
  find('difference-scale-name').textContent = 'difference';
  new Player(recordings, planes).open(0);
}
