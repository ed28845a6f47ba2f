// SPDX-License-Identifier: Apache-2.0
import { DataTexture, LinearFilter, MeshMatcapMaterial, SRGBColorSpace } from "three";

const kSize = 96;

/** From top to bottom of the sphere: a bright sky, a dark horizon, what the floor throws back. */
const kBands = [
  [0, 0.98], [0.24, 0.86], [0.46, 0.72], [0.6, 0.5], [0.7, 0.58], [0.86, 0.36], [1, 0.2],
] as const;
/** Soft lights: place on the sphere, size, and colour added. */
const kLights = [
  { x: 0.34, y: 0.27, size: 0.2, colour: [0.55, 0.55, 0.54] },
  { x: 0.75, y: 0.42, size: 0.15, colour: [0.22, 0.25, 0.3] },
  { x: 0.3, y: 0.82, size: 0.26, colour: [0.16, 0.1, 0.06] },
] as const;
const kTint = [0.96, 0.98, 1] as const;

function band(y: number): number {
  for (let i = 1; i < kBands.length; ++i) {
    const [at, value] = kBands[i]!;
    const [before, valueBefore] = kBands[i - 1]!;
    if (y <= at) return valueBefore + ((y - before) / (at - before)) * (value - valueBefore);
  }
  return kBands.at(-1)![1];
}

/**
 * Returns polished steel under soft lights as a matcap: what a sphere of it looks like. It costs one
 * look-up a pixel and needs no environment, which takes seconds to prepare where there is no GPU.
 */
function steelTexture(): DataTexture {
  const data = new Uint8Array(4 * kSize * kSize);
  for (let row = 0; row < kSize; ++row)
    for (let column = 0; column < kSize; ++column) {
      const [x, y] = [column / (kSize - 1), 1 - row / (kSize - 1)];
      for (let k = 0; k < 3; ++k) {
        let value = band(y) * kTint[k]!;
        for (const light of kLights) value += light.colour[k]! * Math.exp(-((x - light.x) ** 2 + (y - light.y) ** 2) / light.size ** 2);
        data[4 * (row * kSize + column) + k] = 255 * Math.min(1, value);
      }
      data[4 * (row * kSize + column) + 3] = 255;
    }
  const texture = new DataTexture(data, kSize, kSize);
  texture.colorSpace = SRGBColorSpace;
  texture.magFilter = texture.minFilter = LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

const kSteel = steelTexture();

export const steel = (): MeshMatcapMaterial => new MeshMatcapMaterial({ matcap: kSteel });
