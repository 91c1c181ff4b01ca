// The light of the solids, the same for each renderer.
export const LIGHT = [0.35, -0.5, 0.79].map((each, _, all) => each / Math.hypot(...all));
export const AMBIENT = 0.5;
