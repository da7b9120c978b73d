// Depth and differences as colours.
import { DEPTH, DIFFERENCE, INVALID } from './colours.js';

const pixel = ([r, g, b]) => (255 << 24 | b << 16 | g << 8 | r) >>> 0;
export const depthColours = Uint32Array.from(DEPTH, pixel);
const differenceColours = Uint32Array.from(DIFFERENCE, pixel);
const invalid = pixel(INVALID);
const line = pixel([255, 255, 255]);
const mark = pixel([0, 158, 115]);  // Okabe and Ito's bluish green

// A message of the server's, as packing.py describes it.
export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const frame = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const size = frame.width * frame.height;
  let at = 4 + length;
  for (const kind of ['simulated', 'clean', 'without']) {
    const there = kind === 'simulated' || frame[kind];
    frame[kind] = there ? new Uint16Array(buffer, at, size) : null;
    if (there) at += 2 * size;
  }
  return frame;
}

// The pixels of a canvas, kept from frame to frame.
function surface(canvas, width, height) {
  if (!canvas.surface || canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
    const image = new ImageData(width, height);
    canvas.surface = { image, words: new Uint32Array(image.data.buffer), context: canvas.getContext('2d') };
  }
  return canvas.surface;
}

// `wiped` is the share of the image, from the left, that shows `under` instead, up to a line.
export function drawDepth(canvas, frame, depth, most, under = null, wiped = 0) {
  const { image, words, context } = surface(canvas, frame.width, frame.height);
  const factor = 256 * frame.unit / most;
  const column = under ? Math.round(wiped * frame.width) : 0;
  for (let i = 0; i < words.length; i++) {
    const u = i % frame.width;
    const shown = u < column ? under : depth;
    const steps = shown ? shown[i] : 0;
    words[i] = steps ? depthColours[Math.min(255, steps * factor | 0)] : invalid;
    if (column && u === column) words[i] = line;
  }
  context.putImageData(image, 0, 0);
}

// Of depth and `other`. Pixels that differ by `worst` steps or more are marked.
export function drawDifference(canvas, frame, other, most, worst = Infinity) {
  const { image, words, context } = surface(canvas, frame.width, frame.height);
  const { simulated } = frame;
  const factor = 127 * frame.unit / most;
  for (let i = 0; i < words.length; i++) {
    if (!(other && other[i] && simulated[i])) words[i] = invalid;
    else {
      const steps = simulated[i] - other[i];
      words[i] = Math.abs(steps) >= worst ? mark
        : differenceColours[Math.max(1, Math.min(255, Math.round(128 + factor * steps)))];
    }
  }
  context.putImageData(image, 0, 0);
}

export function drawBars(depthBar, differenceBar) {
  for (const [bar, colours] of [[depthBar, depthColours], [differenceBar, differenceColours]]) {
    const { image, words, context } = surface(bar, 256, 1);
    words.set(colours);
    context.putImageData(image, 0, 0);
  }
}

export const signed = (value) => `${value < 0 ? '−' : '+'}${Math.abs(value).toFixed(1)}`;

// What is under the pointer, in words.
export function read(frame, kind, u, v) {
  const at = v * frame.width + u;
  const metres = (image) => (image && image[at] ? image[at] * frame.unit : NaN);
  const other = { difference: 'clean', gap: 'without' }[kind];
  const value = other ? 1000 * (metres(frame.simulated) - metres(frame[other])) : metres(frame[kind]);
  const text = Number.isNaN(value) ? 'invalid' : other ? `${signed(value)} mm` : `${value.toFixed(3)} m`;
  return `(${u}, ${v}) ${text}`;
}
