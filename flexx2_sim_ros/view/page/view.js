// The page: the scales at the top; live cameras or recordings below.
import { drawBars } from './draw.js';
import { live } from './live.js';
import { drawAll, find, scale } from './panel.js';
import { playback } from './playback.js';
import { RECORDED } from './recorded.js';

for (const [id, apply] of [
  ['depth-range', (value) => { scale.depthMost = value; find('depth-most').textContent = `${value.toFixed(1)} m`; }],
  ['wipe', (value) => { scale.wiped = value / 100; }],
  ['difference-range', (value) => {
    scale.differenceMost = value / 1000;
    find('difference-least').textContent = `−${value} mm`;
    find('difference-most').textContent = `+${value} mm`;
  }],
]) {
  find(id).addEventListener('input', ({ target }) => {
    apply(Number(target.value));
    drawAll();
  });
}
find('mark').addEventListener('change', ({ target }) => {
  scale.marked = target.checked;
  drawAll();
});
drawBars(find('depth-bar'), find('difference-bar'));
if (RECORDED) playback(RECORDED);
else live();
