// The sliders of one camera's effects: what the node says, and requests of strengths.
const MOST = 4, STEP = 0.1;
const ANSWER_MS = 1000;

export class Effects {
  constructor(part, ask) {
    this.part = part;
    this.ask = ask;
    this.rows = new Map();
  }

  // Shows the strengths by effect; a slider that somebody holds stays where it is.
  tell(strengths) {
    const names = Object.keys(strengths);
    this.part.effects.hidden = !names.length;
    for (const name of names) {
      const { slider, output } = this.rows.get(name) ?? this.add(name);
      if (!slider.held && performance.now() > slider.busy) slider.value = strengths[name];
      output.textContent = Number(slider.value).toFixed(1);
    }
    const on = names.filter((name) => strengths[name] > 0);
    this.part['effects-on'].textContent = on.length ? `on: ${on.join(', ')}` : 'all off';
  }

  add(name) {
    const label = document.createElement('label');
    const text = document.createElement('span');
    const slider = document.createElement('input');
    const output = document.createElement('output');
    text.textContent = name.replaceAll('_', ' ');
    Object.assign(slider, { type: 'range', min: 0, max: MOST, step: STEP, value: 0, busy: 0 });
    slider.dataset.effect = name;
    slider.setAttribute('aria-label', `strength of ${text.textContent}`);
    slider.addEventListener('input', () => { slider.held = true; output.textContent = Number(slider.value).toFixed(1); });
    for (const end of ['pointerup', 'pointercancel']) {
      slider.addEventListener(end, () => { slider.held = false; });
    }
    slider.addEventListener('change', () => {
      slider.held = false;
      slider.busy = performance.now() + ANSWER_MS;  // The node's answer takes a moment.
      this.ask(name, Number(slider.value));
    });
    label.append(text, slider, output);
    this.part.sliders.append(label);
    const row = { slider, output };
    this.rows.set(name, row);
    return row;
  }
}
