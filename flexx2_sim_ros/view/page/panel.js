// One camera's column: its images, what is under the pointer, and the point cloud.
import { Cloud } from './cloud.js';
import { drawDepth, drawDifference, read } from './draw.js';

export const find = (id) => document.getElementById(id);
// What the sliders at the top set, for all columns.
export const scale = { depthMost: 4, differenceMost: 0.03, wiped: 0, marked: true };
const IMAGES = ['clean', 'simulated', 'difference', 'without', 'gap'];

let drawing = false;
const panels = new Set();

export function drawSoon() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    for (const panel of panels) panel.draw();
  });
}

export function drawAll() {
  for (const panel of panels) panel.dirty = true;
  drawSoon();
}

export class Panel {
  constructor(name) {
    this.name = name;
    this.frame = null;
    this.dirty = false;
    this.section = find('camera').content.firstElementChild.cloneNode(true);
    this.section.dataset.camera = name;
    this.part = {};
    for (const element of this.section.querySelectorAll('[data-part]')) this.part[element.dataset.part] = element;
    this.section.querySelector('h2').textContent = name;
    this.cloud = new Cloud(this.part.cloud, () => { this.dirty = true; drawSoon(); });
    for (const kind of IMAGES) {
      const canvas = this.part[kind];
      canvas.addEventListener('pointermove', (event) => { this.pointer = { kind, x: event.offsetX, y: event.offsetY }; this.readOut(); });
      canvas.addEventListener('pointerleave', () => { this.pointer = null; this.readOut(); });
    }
    this.part.uncovered.addEventListener('change', () => { this.dirty = true; drawSoon(); });
    panels.add(this);
  }

  remove() {
    panels.delete(this);
    this.section.remove();
  }

  // What the images are called: depth, and what it is compared with.
  label(depth, reference) {
    this.part['depth-name'].textContent = depth;
    this.part['clean-name'].textContent = reference;
  }

  take(frame) {
    this.frame = frame;  // One that has not been drawn yet is given up: the newest counts.
    this.dirty = true;
    drawSoon();
  }

  draw() {
    if (!this.dirty || !this.frame) return;
    this.dirty = false;
    const { depthMost, differenceMost, wiped, marked } = scale;
    const { worst = {}, clean, without } = this.frame;
    // The line moves over all images but the one that it uncovers.
    const uncovered = without ? this.part.uncovered.value : 'clean';
    for (const kind of without ? ['simulated', 'without', 'clean'] : ['simulated', 'clean']) {
      drawDepth(this.part[kind], this.frame, this.frame[kind], depthMost, kind === uncovered ? null : this.frame[uncovered], wiped);
    }
    drawDifference(this.part.difference, this.frame, clean, differenceMost, marked ? worst.difference : Infinity);
    this.section.classList.toggle('paired', Boolean(without));
    if (without) drawDifference(this.part.gap, this.frame, without, differenceMost, marked ? worst.gap : Infinity);
    this.part['uncovered-label'].hidden = !without;
    this.cloud.draw(this.frame, depthMost);
    this.readOut();
    this.drawn();
  }

  // Called after each drawing.
  drawn() {}

  readOut() {
    for (const kind of IMAGES) {
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
}
