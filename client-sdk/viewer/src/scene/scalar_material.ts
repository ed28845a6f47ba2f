// SPDX-License-Identifier: Apache-2.0
import { ClampToEdgeWrapping, DataTexture, LinearFilter, MeshStandardMaterial, SRGBColorSpace, type MeshStandardMaterialParameters } from "three";
import { colourAt, type ColourMap } from "./colour_map";

const kWidth = 256;

function texture(map: ColourMap): DataTexture {
  const data = new Uint8Array(kWidth * 4);
  for (let i = 0; i < kWidth; ++i)
    data.set([...colourAt(map, i / (kWidth - 1)).map((v) => Math.round(v * 255)), 255], 4 * i);
  const result = new DataTexture(data, kWidth, 1);
  result.colorSpace = SRGBColorSpace;
  result.magFilter = result.minFilter = LinearFilter;
  result.wrapS = result.wrapT = ClampToEdgeWrapping;
  result.needsUpdate = true;
  return result;
}

/**
 * Lit like any surface and coloured by the attribute `value` through a colour map. The number is
 * interpolated across a triangle, then looked up: colours in between are those of the legend.
 */
export class ScalarMaterial extends MeshStandardMaterial {
  readonly #uniforms;

  constructor(map: ColourMap, parameters: MeshStandardMaterialParameters) {
    super(parameters);
    const uniforms = (this.#uniforms = { scalarMap: { value: texture(map) }, scalarTop: { value: 1 } });
    this.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, uniforms);
      shader.vertexShader = shader.vertexShader
        .replace("#include <common>", "#include <common>\nattribute float value;\nvarying float vValue;")
        .replace("#include <begin_vertex>", "#include <begin_vertex>\nvValue = value;");
      shader.fragmentShader = shader.fragmentShader
        .replace("#include <common>", "#include <common>\nuniform sampler2D scalarMap;\nuniform float scalarTop;\nvarying float vValue;")
        .replace("#include <color_fragment>", `#include <color_fragment>
          float scalarShare = clamp(vValue / scalarTop, 0.0, 1.0);
          diffuseColor.rgb *= texture2D(scalarMap, vec2((scalarShare * ${kWidth - 1}.0 + 0.5) / ${kWidth}.0, 0.5)).rgb;`);
    };
  }

  set scalarMap(map: ColourMap) {
    this.#uniforms.scalarMap.value.dispose();
    this.#uniforms.scalarMap.value = texture(map);
  }

  /** The value at the end of the map. */
  set scalarTop(top: number) {
    this.#uniforms.scalarTop.value = top;
  }
}
