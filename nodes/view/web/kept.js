// The solids' picture where a processor draws: to present a picture of WebGL costs it more than all
// the rest. So colours and depths are read back once, and a frame changes the patch around the
// device only. While the camera turns, the picture is as coarse as its time demands.
import { composed } from "./compose.js";

const SHARES = [1, 0.71, 0.5, 0.35, 0.25]; // of the pixels along a side
const LONG = 18, SHORT = 6; // time of a picture beyond which the next is coarser, or finer [ms]

export class Kept {
  constructor() {
    Object.assign(this, { canvas: document.createElement("canvas"), base: document.createElement("canvas"), step: 2, stale: true, last: [0, 0, 0, 0], solids: null });
  }

  // Pixels along a side as a part of all, while the picture moves; at least a given one.
  share(least) { return Math.max(least, SHARES[this.step]); }

  // Choose the next picture's share by the time of one that moved [ms].
  pace(time) {
    if (time > LONG) this.step = Math.min(this.step + 1, SHARES.length - 1);
    else if (time < SHORT) this.step = Math.max(this.step - 1, 0);
  }

  // Replace the picture of the solids: width, height, colours times alpha and depths.
  take({ width, height, colours, depths }) {
    const image = new ImageData(width, height), { data } = image;
    for (let row = 0; row < height; row++) data.set(colours.subarray(4 * width * row, 4 * width * (row + 1)), 4 * width * (height - 1 - row));
    for (let k = 3; k < data.length; k += 4) {
      const alpha = data[k];
      if (alpha === 255 || alpha === 0) continue;
      for (let n = k - 3; n < k; n++) data[n] = (255 * data[n]) / alpha;
    }
    this.solids = { width, height, image, depths };
    // To set a size, even the same, costs a new canvas.
    if (this.base.width !== width || this.base.height !== height) Object.assign(this.base, { width, height });
    this.base.getContext("2d").putImageData(image, 0, 0);
    this.stale = true;
  }

  // Draw device and proxy in place of those of the last frame; a patch of null is none.
  put(patch, view, balls) {
    const { canvas, base, stale, last: [left, bottom, wide, high] } = this, g = canvas.getContext("2d");
    g.save();
    if (!stale) {
      g.beginPath();
      g.rect(left, canvas.height - bottom - high, wide, high);
      g.clip();
    }
    g.clearRect(0, 0, canvas.width, canvas.height);
    g.drawImage(base, 0, 0, canvas.width, canvas.height);
    g.restore();
    this.stale = false;
    this.last = patch ?? [0, 0, 0, 0];
    const [x, y, width, height] = this.last;
    if (width && height) g.putImageData(composed(this.solids, canvas, view, balls, patch), x, canvas.height - y - height);
  }
}
