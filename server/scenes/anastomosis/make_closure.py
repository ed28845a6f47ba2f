#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes closure20.toml and closure50.toml: both vessels sewn together before the first step, and
pulled together by a thread whose length is a given function of time, as in the paper's figure 5.

Bite k lies at the angle 4 + k 720 / n degrees, 2 mm from the rim: of the proximal vessel where k is
even, in from outside and out into the lumen, of the distal one where k is odd, in from the lumen
and out. The places are given as points and taken at the nearest point of the surface.

The length counts what lies outside the tissue: the n / 2 - 1 pieces across the gap. Each gets
shorter at 5 mm/s, by 1.8 mm (1.75 mm where there are 50), the gap being 1.5 mm wide: the rest is what the tissue
gives way under the tension.

    python3 make_closure.py            writes both files beside itself
    python3 make_closure.py --check    fails where a file is not what would be written
"""
import argparse
import math
import pathlib
import sys

HERE = pathlib.Path(__file__).resolve().parent
OUTER = {"proximal": 0.006, "distal": 0.005}
WALL = 0.0015
GAP = 0.0015
FROM_RIM = 0.002
SHORTENING = {20: 0.0018, 50: 0.00175}  # per piece
SPEED = 0.005                          # of that
TENSION = {20: 0.113, 50: 0.057}       # then, newtons: what the gap takes to close

HEAD = """\
# SPDX-License-Identifier: GPL-3.0-or-later
# The vessels of scene.toml, sewn all around by {n} punctures, and pulled together: the paper's
# figure 5. Nobody holds the thread; its length follows `length_program_m`. Written by
# make_closure.py:
#
#     sutured run closure{n}.toml --duration 1 --out DIR
#
# The gap is closed after {closed:.2f} s, at {tension} N. See README.md.
name = "closure{n}"
rate_hz = 250
"""

TISSUE = """
[[tissue]]
name = "{name}"
mesh = "vessels.msh"             # made from vessels.geo by `make meshes`
volumes = ["{name}"]
scale = 0.001                    # the file is in millimetres
young_modulus_pa = 2.0e5
poisson_ratio = 0.45
fixed = ["{name}_end"]
"""

WOUND = """
[[wound]]                        # the quality figures measure the gap between these
name = "anastomosis"
edges = [{ tissue = "proximal", group = "proximal_rim" }, { tissue = "distal", group = "distal_rim" }]
"""


def punctures(n):
    """Yields (tissue, point) from the tail to the head."""
    bites = n // 2
    for k in range(bites):
        name = "distal" if k % 2 else "proximal"
        angle = math.radians(4.0 + 360.0 / bites * k)
        z = (GAP / 2 + FROM_RIM) * (1 if k % 2 else -1)
        radii = (OUTER[name], OUTER[name] - WALL)
        for radius in reversed(radii) if k % 2 else radii:
            yield name, (radius * math.cos(angle), radius * math.sin(angle), z)


def text(n):
    points = list(punctures(n))
    # The facets of the mesh lie inside the circles, so this is not quite the length at rest: 0.1 %.
    across = sum(math.dist(a[1], b[1]) for a, b in list(zip(points, points[1:]))[1::2])
    closed_s = SHORTENING[n] / SPEED
    closed = across - (n // 2 - 1) * SHORTENING[n]
    lines = [HEAD.format(n=n, closed=closed_s, tension=TENSION[n])]
    lines += [TISSUE.format(name=name) for name in OUTER]
    lines.append(WOUND)
    lines.append('\n[[thread]]\nname = "suture"\nends = "none"\nmodel = "outside"\n'
                 f"length_program_m = [[0.0, {across:.6f}], [{closed_s:.2f}, {closed:.6f}]]\n"
                 "punctures = [\n")
    for name, point in points:
        x, y, z = (f"{round(c, 6) + 0.0:.6f}" for c in point)
        lines.append(f'  {{ tissue = "{name}", point_m = [{x}, {y}, {z}] }},\n')
    lines.append("]\n")
    return "".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args().check
    for n in SHORTENING:
        path = HERE / f"closure{n}.toml"
        if not check:
            path.write_text(text(n), encoding="utf-8")
        elif path.read_text(encoding="utf-8") != text(n):
            sys.exit(f"{path.name} is not what make_closure.py writes; run it")


if __name__ == "__main__":
    main()
