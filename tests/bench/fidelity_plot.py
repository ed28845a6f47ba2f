#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws what `sutured_bench --fidelity DIR` left, and renews the tables of the page about it.

    /usr/bin/python3 fidelity_plot.py DIR PAGE.md PLOT.svg

Above, the force of the full re-solve and of the model, along the direction in which it varies most;
below, how far the model, a held force and a linear one are off, in % of the peak.
"""
import sys

try:
    import matplotlib
    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "sutured"     # the same curves give the same file
    from matplotlib import pyplot
    import numpy as np
except ImportError as error:
    sys.exit(f"fidelity_plot: {error}; install python3-matplotlib and python3-numpy")

MOTIONS = ["needle", "sideways", "tip", "thread", "two_hands"]
BEGIN, END = "<!-- tables: make fidelity -->", "<!-- end of tables -->"
EVERY = 8                                               # ms between drawn points


def draw(folder, path):
    figure, axes = pyplot.subplots(2, len(MOTIONS), figsize=(14, 5), sharex="col",
                                   layout="constrained")
    for column, name in enumerate(MOTIONS):
        table = np.genfromtxt(f"{folder}/{name}.csv", delimiter=",", skip_header=1)
        time, truth, model, held, linear = table[:, 0], *(table[:, i:i + 3] for i in (1, 4, 7, 10))
        peak = np.linalg.norm(truth, axis=1).max()
        direction = np.linalg.svd(truth - truth.mean(axis=0), full_matrices=False)[2][0]
        direction *= np.sign(direction @ truth[np.abs(truth @ direction).argmax()])
        upper, lower = axes[0, column], axes[1, column]
        upper.plot(time[::EVERY], (truth @ direction)[::EVERY], color="#333333", linewidth=2.2,
                   label="full re-solve")
        upper.plot(time[::EVERY], (model @ direction)[::EVERY], color="#d9483b", linewidth=0.9,
                   label="model, one frame late")
        upper.set_title(name)
        for values, colour, label in ((held, "#b9c0c8", "held"), (linear, "#6f9fd8", "linear in time"),
                                      (model, "#d9483b", "model")):
            error = 100 * np.linalg.norm(values - truth, axis=1) / peak
            lower.semilogy(time[::EVERY], np.maximum(error, 1e-2)[::EVERY], color=colour,
                           linewidth=0.9, label=label)
        lower.set_ylim(1e-2, 100)
        lower.set_xlabel("s")
    axes[0, 0].set_ylabel("force, N")
    axes[1, 0].set_ylabel("error, % of the peak")
    axes[0, 0].legend(fontsize=7)
    axes[1, 0].legend(fontsize=7)
    figure.savefig(path, metadata={"Date": None})


def renew(folder, page):
    with open(f"{folder}/tables.md", encoding="utf-8") as file:
        tables = file.read().strip()
    with open(page, encoding="utf-8") as file:
        text = file.read()
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        sys.exit(f"fidelity_plot: {page} has no `{BEGIN}` and `{END}`")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    with open(page, "w", encoding="utf-8") as file:
        file.write(f"{before}{BEGIN}\n{tables}\n{END}{after}")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    draw(sys.argv[1], sys.argv[3])
    renew(sys.argv[1], sys.argv[2])
