// SPDX-License-Identifier: Apache-2.0
import { readFileSync } from "node:fs";

declare const __IDL_FILE__: string;

/** The contract itself, as the server advertises it. */
export const idl = (): string => readFileSync(__IDL_FILE__, "utf8");
