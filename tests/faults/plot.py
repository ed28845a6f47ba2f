#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the force at the hand around each injected fault.

    /usr/bin/python3 tests/faults/plot.py faults.csv faults.png

Reads what `sutured_faults` writes: fault, mode, time_ms since the last good sample, force_n.
"""
import csv
import sys

try:
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib import pyplot
except ImportError as error:
    sys.exit(f"plot: {error}; install python3-matplotlib (`make faults` does)")

COLOURS = {"server": "#1f4fa3", "device": "#d9483b"}
PROMISE_MS = 50.0
COLUMNS = 4


def main(source, target):
    curves = {}
    with open(source, encoding="utf-8") as file:
        for row in csv.DictReader(file):
            times, forces = curves.setdefault(row["fault"], {}).setdefault(row["mode"], ([], []))
            times.append(float(row["time_ms"]))
            forces.append(float(row["force_n"]))
    rows = -(-len(curves) // COLUMNS)
    figure, axes = pyplot.subplots(rows, COLUMNS, figsize=(13, 2.2 * rows), sharex=True, sharey=True,
                                   squeeze=False, layout="constrained")
    for axis in axes.flat[len(curves):]:
        axis.set_visible(False)
    for axis, (fault, modes) in zip(axes.flat, curves.items()):
        axis.axvspan(0.0, PROMISE_MS, color="#e8e8e8", zorder=0)
        for mode, (times, forces) in modes.items():
            axis.plot(times, forces, color=COLOURS[mode], linewidth=1.2, label=f"rendered by the {mode}",
                      linestyle="-" if mode == "server" else "--")
        axis.set_title(fault, fontsize=9)
        axis.tick_params(labelsize=8)
    axes[0][0].legend(fontsize=7, loc="center right")
    figure.supxlabel("ms since the last good sample (grey: the promised 50)", fontsize=9)
    figure.supylabel("force at the hand, N", fontsize=9)
    figure.savefig(target, dpi=90)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
