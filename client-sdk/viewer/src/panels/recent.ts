// SPDX-License-Identifier: Apache-2.0

export const kWindow_s = 20;
const kMost = 20 * 60 + 60;

/** The last seconds of some figures over time: a column per name, gaps where one is silent. */
export class Recent {
  readonly names: string[] = [];
  readonly times: number[] = [];
  readonly columns: (number | null)[][] = [];

  /** Takes `value` of `name` at `time_s`; figures of one moment share a row. */
  push(name: string, time_s: number, value: number): void {
    let column = this.names.indexOf(name);
    if (column < 0) {
      column = this.names.push(name) - 1;
      this.columns.push(this.times.map(() => null));
    }
    const last = this.times.at(-1);
    if (last !== undefined && time_s < last) this.clear();
    if (last === undefined || time_s > last || this.times.length === 0) {
      this.times.push(time_s);
      for (const each of this.columns) each.push(null);
    }
    this.columns[column]![this.times.length - 1] = value;
    const drop = this.times.findIndex((t) => t >= time_s - kWindow_s);
    const surplus = Math.max(drop, this.times.length - kMost, 0);
    if (surplus > 30) {
      this.times.splice(0, surplus);
      for (const each of this.columns) each.splice(0, surplus);
    }
  }

  /** Forgets the names as well. */
  forget(): void {
    this.clear();
    this.names.length = this.columns.length = 0;
  }

  clear(): void {
    this.times.length = 0;
    for (const each of this.columns) each.length = 0;
  }
}
