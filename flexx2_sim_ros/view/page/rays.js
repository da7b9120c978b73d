// The rays of a camera's pixels: x/z and y/z in the optical frame, row by row, what the lens
// distorts (plumb_bob, rational_polynomial) taken off; NaN where that cannot be inverted.
const ITERATIONS = { 5: 30, 8: 100 }, TOLERANCE_PX = 0.01;

export class Rays {
  // Computed anew only when the camera changes.
  of({ width, height, fx, fy, cx, cy, distortion }) {
    const camera = JSON.stringify([width, height, fx, fy, cx, cy, distortion]);
    if (camera === this.camera) return this;
    this.camera = camera;
    this.x = new Float32Array(width * height);
    this.y = new Float32Array(width * height);
    for (let v = 0, at = 0; v < height; v++) {
      for (let u = 0; u < width; u++, at++) {
        [this.x[at], this.y[at]] = straighten((u - cx) / fx, (v - cy) / fy, distortion, Math.max(fx, fy));
      }
    }
    return this;
  }
}

// Find the ray that the lens bends to (u, v): the distortion is small, so a fixed point is near.
function straighten(u, v, distortion, focal) {
  if (!distortion.some((coefficient) => coefficient)) return [u, v];
  let x = u, y = v;
  for (let n = 0; n < ITERATIONS[distortion.length]; n++) {
    const [bentX, bentY] = bend(x, y, distortion);
    x += u - bentX;
    y += v - bentY;
  }
  const [bentX, bentY] = bend(x, y, distortion);
  return Math.hypot(bentX - u, bentY - v) * focal < TOLERANCE_PX ? [x, y] : [NaN, NaN];
}

function bend(x, y, [k1, k2, p1, p2, k3, k4 = 0, k5 = 0, k6 = 0]) {
  const r2 = x * x + y * y;
  const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
  return [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
    y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y];
}
