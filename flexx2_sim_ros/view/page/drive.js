// Keys and buttons to velocities. Whatever takes the keyboard away stops the robot; the space bar
// stops it whoever drives.
const ALIASES = { ArrowUp: 'KeyW', ArrowDown: 'KeyS', ArrowLeft: 'KeyA', ArrowRight: 'KeyD' };
// Forward, left, turn to the left: shares of the fastest.
const MOVES = {
  KeyW: [1, 0, 0], KeyS: [-1, 0, 0], KeyA: [0, 0, 1], KeyD: [0, 0, -1], KeyQ: [0, 1, 0], KeyE: [0, -1, 0],
};
const FASTEST = [0.8, 0.5, 1.5];
const STOP_KEY = 'Space';
const REPEAT_MS = 100;

export function driving(pad, speed, speedText, send) {
  const held = new Set();
  let timer = null;

  const velocity = () => FASTEST.map((most, axis) => {
    const sum = [...held].reduce((total, key) => total + MOVES[key][axis], 0);
    return Math.sign(sum) * most * Number(speed.value);
  });
  const say = () => {
    const share = Number(speed.value);
    speedText.textContent = `${(FASTEST[0] * share).toFixed(2)} m/s, ${(FASTEST[2] * share).toFixed(2)} rad/s`;
  };
  const change = () => {
    for (const button of pad.children) button.classList.toggle('held', held.has(button.dataset.key));
    send(velocity());
    if (held.size && timer === null) timer = setInterval(() => send(velocity()), REPEAT_MS);
    if (!held.size) {
      clearInterval(timer);
      timer = null;
    }
  };
  const halt = () => { held.clear(); change(); };
  const press = (key) => {
    if (key === STOP_KEY) halt();
    else if (!held.has(key)) { held.add(key); change(); }
  };
  const release = (key) => { if (held.delete(key)) change(); };
  const stop = () => { if (held.size) halt(); };

  addEventListener('keydown', (event) => {
    const key = ALIASES[event.code] ?? event.code;
    if (!(key in MOVES || key === STOP_KEY) || event.ctrlKey || event.altKey || event.metaKey) return;
    // Of a control that has the focus, keys are its own; but a slider does nothing on space.
    if (event.target.closest(key === STOP_KEY ? 'select' : 'select, input')) return;
    event.preventDefault();
    // A key that repeats was pressed before: after a stop it does not drive again.
    if (!event.repeat) press(key);
  });
  addEventListener('keyup', (event) => release(ALIASES[event.code] ?? event.code));
  addEventListener('blur', stop);
  document.addEventListener('visibilitychange', () => { if (document.hidden) stop(); });
  for (const button of pad.children) {
    button.addEventListener('pointerdown', (event) => {
      button.setPointerCapture(event.pointerId);
      press(button.dataset.key);
    });
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      button.addEventListener(end, () => release(button.dataset.key));
    }
  }
  // Once a control has been used, keys drive again.
  for (const control of document.querySelectorAll('input')) control.addEventListener('change', () => control.blur());
  speed.addEventListener('input', say);
  say();
  return { stop, velocity: () => (held.size ? velocity() : null) };
}
