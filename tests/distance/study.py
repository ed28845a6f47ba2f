#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What distance does to the force at the hand: both ways to render, over a relay with delay and loss.

    /usr/bin/python3 study.py --build build/release --docs docs    # `make distance`

Plays two motions with `sutured serve` on one host and `suture device` on another (two network namespaces,
tests/support/two_hosts_main.cpp), for each delay and for either renderer, and writes results/distance.md and
images/distance.png. What stands below the line "## Reading it" of that file is kept.

Force error at play time t: the force that the hand was being given at t, less that of `sutured run --rate 1000` at
t, which solves everything anew each millisecond with the hand's pose of that time and knows no network. It is taken
each millisecond from the reference's first force to its last.
"""
import argparse
import csv
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile

try:
    import numpy as np
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib import pyplot
except ImportError as error:
    sys.exit(f"distance: {error}; install python3-matplotlib and python3-numpy (`make distance` does)")

SCENE = "server/scenes/anastomosis/scene.toml"
BITE = "server/scenes/anastomosis/one_bite.csv"
DELAYS_MS = [0, 2, 5, 20, 50]      # one way
JITTER = 0.2                       # of the delay, either way
LOSS_PERCENT = 1                   # each way
SEED = 1
RENDERERS = ["server", "device"]
SHOWN_MS = 20                      # the delay whose forces are drawn
SHOWN_S = {"bite": (2.6, 3.8), "press": (1.0, 2.2)}
TOOL = {"bite": "driver", "press": "probe"}
KEPT_FROM = "## Reading it"
FORCE = ["fx_n", "fy_n", "fz_n"]


class Fault(Exception):
    """What went wrong; one line."""


def press():
    """A probe that goes down on the proximal vessel's side and presses: 2 Hz, 0.2 to 0.8 mm deep, a few mm/s."""
    rows = ["time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw"]
    for k in range(401):
        t = 0.01 * k
        depth = 0.5e-3 - 0.3e-3 * np.cos(2 * np.pi * 2.0 * (t - 0.6)) if t >= 0.6 else (t / 0.6 - 1) * 4e-3 + 0.2e-3
        rows.append(f"{t:.2f},probe,{8e-3 - depth:.9f},0,{-8e-3 + 2e-4 * np.sin(8 * t):.9f},0,0,0,1,0")
    return "\n".join(rows) + "\n"


def columns(path, names, tool):
    with open(path, encoding="utf-8", newline="") as file:
        rows = [[float(row[name]) for name in names] for row in csv.DictReader(file) if row["tool"] == tool]
    if not rows:
        raise Fault(f"{path}: holds nothing of the tool {tool}")
    return np.array(rows).T


def end(process):
    """Ends a program and returns what it said."""
    process.send_signal(signal.SIGTERM)
    return process.communicate(timeout=30)[0]


def await_line(process, text):
    for line in process.stdout:
        if text in line:
            return
    raise Fault(f"{process.args[0]} ended with {process.wait()} before it said \"{text}\"")


def play(build, folder, options, surgeon, tool, renderer):
    """One play; returns the summary of its device, and the log's path."""
    hosts = subprocess.Popen([f"{build}/tests/support/two_hosts", *options], stdout=subprocess.PIPE, text=True)
    try:
        enter = {}
        for line in hosts.stdout:
            if line.startswith(("a: ", "b: ")):
                enter[line[0]] = line[3:].split()
            if line.startswith("ready"):
                break
        if len(enter) != 2:
            raise Fault("no two hosts on this machine; the reason stands above")
        server = subprocess.Popen([*enter["a"], f"{build}/server/sutured", "serve", SCENE,
                                   "--interface", "eth0", "--unsecured-network"],
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        try:
            await_line(server, "serving scene")
            log, summary = os.path.join(folder, "log.csv"), os.path.join(folder, "summary.json")
            device = subprocess.run([*enter["b"], f"{build}/client-sdk/cli/suture", "device", "--surgeon", surgeon,
                                     "--render", renderer, "--log", log, "--summary", summary, "--timeout", "30",
                                     "--interface", "eth0", "--peer", "10.0.0.1", "--unsecured-network", "--quiet"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            if device.returncode != 0:
                raise Fault(f"suture device ended with {device.returncode}: {device.stdout}")
        finally:
            end(server)
        with open(summary, encoding="utf-8") as file:
            return json.load(file)["tools"][tool], log
    finally:
        end(hosts)


def given(log, tool, times_s):
    """The force that the hand is being given at each of these play times: that of the last tick."""
    data = columns(log, ["time_s", *FORCE], tool)
    newest = np.searchsorted(data[0], times_s, side="right") - 1
    felt_n = data[1:4][:, np.maximum(newest, 0)]
    felt_n[:, newest < 0] = 0.0
    return felt_n


def cases():
    yield "cable", ["--cable"]
    for delay in DELAYS_MS:
        yield delay, ["--delay-ms", str(delay), "--jitter-ms", str(JITTER * delay), "--loss-percent",
                      str(LOSS_PERCENT), "--seed", str(SEED)]


def study(build, motion):
    """Plays one motion in all cases; returns its results, and what to draw."""
    tool = TOOL[motion]
    with tempfile.TemporaryDirectory() as folder:
        surgeon = BITE
        if motion == "press":
            surgeon = f"{folder}/press.csv"
            with open(surgeon, "w", encoding="utf-8") as file:
                file.write(press())
        run = subprocess.run([f"{build}/server/sutured", "run", SCENE, "--surgeon", surgeon, "--rate", "1000", "--out",
                              f"{folder}/reference", "--quiet"])
        if run.returncode != 0:
            raise Fault("the reference run failed")
        reference = columns(f"{folder}/reference/tools.csv", ["time_s", *FORCE], tool)
        times_s, reference_n = reference[0], reference[1:]
        magnitude_n = np.linalg.norm(reference_n, axis=0)
        peak_n = float(magnitude_n.max())
        touching = np.flatnonzero(magnitude_n > 0.0)
        window = slice(touching[0], touching[-1] + 1)
        results, curves = [], {"reference": magnitude_n}
        for delay, options in cases():
            for renderer in RENDERERS:
                summary, log = play(build, folder, options, surgeon, tool, renderer)
                felt_n = given(log, tool, times_s)
                error = np.linalg.norm(felt_n - reference_n, axis=0)[window] / peak_n * 100.0
                if delay == SHOWN_MS:
                    curves[renderer] = np.linalg.norm(felt_n, axis=0)
                results.append({"delay": delay, "renderer": renderer, "rms": float(np.sqrt(np.mean(error ** 2))),
                                "p50": float(np.quantile(error, 0.5)), "p95": float(np.quantile(error, 0.95)),
                                "max": float(error.max()),
                                "round_trip_ms": [1e-3 * summary["round_trip_us"][key] for key in ("p50", "p99")],
                                "lost": 100.0 - summary["answered_pct"]})
                print("{0:6} {delay!s:>6} {renderer:7} error p50 {p50:.1f} %, p95 {p95:.1f} %, rms {rms:.1f} %, "
                      "max {max:.1f} %".format(motion, **results[-1]), flush=True)
    return {"times_s": times_s, "curves": curves, "results": results, "peak_n": peak_n}


def draw(path, studies):
    figure, rows = pyplot.subplots(2, 2, figsize=(11, 7), gridspec_kw={"width_ratios": [3, 2]})
    colours = {"reference": "#222222", "server": "#d9483b", "device": "#1f4fa3"}
    for (motion, found), (left, right) in zip(studies.items(), rows):
        begin_s, end_s = SHOWN_S[motion]
        shown = (found["times_s"] >= begin_s) & (found["times_s"] <= end_s)
        for name, colour in colours.items():
            label = "1 kHz, no network" if name == "reference" else f"by the {name}, {SHOWN_MS} ms each way"
            left.plot(found["times_s"][shown], found["curves"][name][shown], label=label, color=colour,
                      lw=2.2 if name == "reference" else 1.2)
        left.set_title(motion, loc="left", fontsize=10)
        left.set_xlabel("play time, s")
        left.set_ylabel("force at the hand, N")
        for renderer in RENDERERS:
            points = [(r["delay"], r["rms"]) for r in found["results"]
                      if r["renderer"] == renderer and r["delay"] != "cable"]
            right.plot(*zip(*points), "o-", color=colours[renderer], label=f"rendered by the {renderer}")
        right.set_xlabel("delay one way, ms")
        right.set_ylabel("force error, RMS, % of the peak")
        right.set_ylim(bottom=0)
        for axes in (left, right):
            axes.legend(frameon=False, fontsize=8)
            axes.spines[["top", "right"]].set_visible(False)
            axes.grid(alpha=0.25)
    figure.tight_layout()
    os.makedirs(os.path.dirname(path), exist_ok=True)
    figure.savefig(path, dpi=100)


def processor():
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.startswith("model name"):
                return line.split(": ", 1)[1].strip()
    return platform.machine()


def commit():
    git = subprocess.run(["git", "describe", "--always", "--dirty"], stdout=subprocess.PIPE, text=True)
    return git.stdout.strip() or "unknown"


def write(path, studies):
    kept = ""
    if os.path.exists(path):
        with open(path, encoding="utf-8") as file:
            text = file.read()
        kept = text[text.find(KEPT_FROM):] if KEPT_FROM in text else ""
    bite_n, press_n = studies["bite"]["peak_n"], studies["press"]["peak_n"]
    lines = [
        "# Distance", "",
        "What reaches the hand when server and device are apart. `make distance` makes this page and its plot; what stands",
        f"below \"{KEPT_FROM[3:]}\" is kept. The run below: {processor()}, {os.cpu_count()} processors, commit {commit()}.", "",
        "`sutured serve` with the anastomosis scene (250 Hz) and `suture device` run on two hosts: network namespaces, with a",
        f"relay between them that is their only way. Delays are one way; around each they spread evenly by ± {100 * JITTER:.0f} % and keep",
        f"the order; {LOSS_PERCENT} % of packets is lost each way, from a fixed seed. *Cable* is the same pair with nothing between but",
        "a cable. *Bite* is `one_bite.csv`: a needle through both vessels, with four punctures. *Press* is a probe on the side",
        "of a vessel, 0.2 to 0.8 mm deep at 2 Hz.", "",
        "- **Round trip**: from a pose's stamp to the arrival of its force, on the device's clock; *lost*: poses that no",
        "  force answered. Both also where the device renders: the server answers it all the same.",
        "- **Force error** at play time t: the force that the hand was being given at t, less that of `sutured run --rate",
        "  1000` at t, which solves everything anew each millisecond with the pose of that time and knows no network. Each",
        f"  millisecond, from the first force to the last; in % of the reference's peak (bite {bite_n:.3f} N, press {press_n:.3f} N). It holds",
        "  what the scene's rate of 250 Hz costs, and a puncture that comes some milliseconds later, not only the network."]
    for motion, found in studies.items():
        lines += ["", f"| {motion.capitalize()}: delay, ms | Rendered by | Round trip p50, p99, ms | Lost, % | Error RMS, % | p50, % | p95, % | max, % |",
                  "|---|---|---|---|---|---|---|---|"]
        for result in found["results"]:
            lines.append("| {delay} | {renderer} | {0:.2f}, {1:.2f} | {lost:.1f} | {rms:.1f} | {p50:.1f} | {p95:.1f} | "
                         "{max:.1f} |".format(*result["round_trip_ms"], **result))
    lines += ["", f"![Force over time at {SHOWN_MS} ms each way, and RMS error over delay](../images/distance.png)", "", ""]
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + kept)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", help="build folder")
    parser.add_argument("--docs", default="docs", help="folder of results/ and images/")
    arguments = parser.parse_args()
    try:
        studies = {motion: study(arguments.build, motion) for motion in TOOL}
        draw(os.path.join(arguments.docs, "images", "distance.png"), studies)
        write(os.path.join(arguments.docs, "results", "distance.md"), studies)
    except (Fault, OSError, ValueError) as error:
        sys.exit(f"distance: {error}")


if __name__ == "__main__":
    main()
