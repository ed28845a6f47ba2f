// SPDX-License-Identifier: Apache-2.0

export interface SplitMesh {
  /** Per drawn vertex: the surface vertex that it follows. */
  source: Uint32Array;
  /** Three drawn vertices per triangle. */
  index: Uint32Array;
}

/**
 * Gives each side of a sharp edge vertices of its own, so that light changes there at once and is
 * smooth elsewhere. Around each vertex, triangles whose normals differ by less than `crease_rad` from
 * one to the next belong together.
 */
export function splitCreases(position: ArrayLike<number>, triangle: ArrayLike<number>, crease_rad = 0.8): SplitMesh {
  const triangles = triangle.length / 3;
  const normals = faceNormals(position, triangle);
  const around: number[][] = Array.from({ length: position.length / 3 }, () => []);
  for (let corner = 0; corner < triangle.length; ++corner) around[triangle[corner]!]!.push(corner);

  const source: number[] = [];
  const index = new Uint32Array(triangles * 3);
  const least = Math.cos(crease_rad);
  around.forEach((corners, vertex) => {
    const left = new Set(corners);
    while (left.size > 0) {
      const first = left.values().next().value as number;
      left.delete(first);
      const group = [first];
      for (const corner of group)
        for (const other of [...left])
          if (cosine(normals, Math.floor(corner / 3), Math.floor(other / 3)) > least) {
            left.delete(other);
            group.push(other);
          }
      for (const corner of group) index[corner] = source.length;
      source.push(vertex);
    }
  });
  return { source: Uint32Array.from(source), index };
}

function cosine(normals: Float64Array, a: number, b: number): number {
  return normals[3 * a]! * normals[3 * b]! + normals[3 * a + 1]! * normals[3 * b + 1]! + normals[3 * a + 2]! * normals[3 * b + 2]!;
}

function faceNormals(p: ArrayLike<number>, t: ArrayLike<number>): Float64Array {
  const normals = new Float64Array(t.length);
  for (let i = 0; i < t.length; i += 3) {
    const [a, b, c] = [3 * t[i]!, 3 * t[i + 1]!, 3 * t[i + 2]!];
    const [ux, uy, uz] = [p[b]! - p[a]!, p[b + 1]! - p[a + 1]!, p[b + 2]! - p[a + 2]!];
    const [vx, vy, vz] = [p[c]! - p[a]!, p[c + 1]! - p[a + 1]!, p[c + 2]! - p[a + 2]!];
    const [x, y, z] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    const n = Math.hypot(x, y, z) || 1;
    normals.set([x / n, y / n, z / n], i);
  }
  return normals;
}
