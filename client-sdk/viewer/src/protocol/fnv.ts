// SPDX-License-Identifier: Apache-2.0
const kOffset = 0xcbf29ce484222325n;
const kPrime = 0x100000001b3n;

/** Returns the key of a tool's poses and forces: the 64-bit FNV-1a hash of its name in UTF-8. */
export function toolId(name: string): bigint {
  let hash = kOffset;
  for (const byte of new TextEncoder().encode(name)) hash = BigInt.asUintN(64, (hash ^ BigInt(byte)) * kPrime);
  return hash;
}
