// SPDX-License-Identifier: Apache-2.0
import { CanvasTexture, SRGBColorSpace, type Texture } from "three";

const kSize = 256;

/**
 * Returns polished steel under soft boxes as a matcap: what a sphere of it looks like. It costs one
 * look-up a pixel and needs no environment, which takes seconds to prepare where there is no GPU.
 */
export function steelMatcap(): Texture {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = kSize;
  const paint = canvas.getContext("2d")!;
  const ground = paint.createLinearGradient(0, 0, 0, kSize);
  for (const [at, colour] of [
    [0, "#f7fafd"], [0.22, "#c9d2dc"], [0.45, "#8f9ba8"], [0.56, "#59646f"], [0.66, "#7d8996"], [0.85, "#4a545f"], [1, "#20262d"],
  ] as const) ground.addColorStop(at, colour);
  paint.fillStyle = ground;
  paint.fillRect(0, 0, kSize, kSize);
  const light = (x: number, y: number, radius: number, colour: string) => {
    const glow = paint.createRadialGradient(x * kSize, y * kSize, 0, x * kSize, y * kSize, radius * kSize);
    glow.addColorStop(0, colour);
    glow.addColorStop(1, "rgb(255 255 255 / 0%)");
    paint.fillStyle = glow;
    paint.fillRect(0, 0, kSize, kSize);
  };
  light(0.34, 0.26, 0.24, "rgb(255 255 255 / 95%)");
  light(0.76, 0.4, 0.16, "rgb(226 238 255 / 55%)");
  light(0.3, 0.82, 0.3, "rgb(255 214 190 / 26%)");
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  return texture;
}
