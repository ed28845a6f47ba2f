#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes surgeon.csv: a hand that takes the needle and drives it through both vessel walls.

The needle's circle lies in the plane y = 0 around (11, 0, 0) mm with radius 8 mm. Going round by
increasing angle, its tip meets the proximal vessel's outer wall at 128.7 degrees, its lumen at
144.3, the distal lumen at 200.3 and the distal outer wall at 221.4. The hand is not perfect: it
wobbles by fractions of a millimetre and of a degree, smoothly and always alike.

    python3 make_surgeon.py > surgeon.csv
"""
import math

CENTRE = (0.011, 0.0, 0.0)
RADIUS = 0.008
START_DEG = 115.0     # of the tip; the scene puts the needle there
END_DEG = 246.0
GRIP_DEG = 150.0      # how far behind the tip the jaw holds
APPROACH_S, CLOSE_S, DRIVE_S, HOLD_S, OPEN_S, LEAVE_S = 1.0, 0.4, 5.0, 0.5, 0.3, 0.5
STEP_S = 0.01


def multiply(a, b):
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def about(axis, degrees):
    half = math.radians(degrees) / 2
    return tuple(math.sin(half) * c for c in axis) + (math.cos(half),)


def smooth(x):
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (10 - 15 * x + 6 * x * x)


def pose(tip_deg, wobble, t):
    """The jaw on the needle's circle while the tip is at `tip_deg`."""
    angle = math.radians(tip_deg - GRIP_DEG)
    position = (CENTRE[0] + RADIUS * math.cos(angle), CENTRE[1], CENTRE[2] - RADIUS * math.sin(angle))
    shake = (0.12e-3 * math.sin(5.1 * t), 0.20e-3 * math.sin(3.7 * t + 0.4), 0.10e-3 * math.sin(6.3 * t + 1.1))
    position = tuple(p + wobble * s for p, s in zip(position, shake))
    turn = multiply(about((1, 0, 0), -90.0), about((0, 0, 1), tip_deg - 180.0))
    turn = multiply(about((0, 1, 0), wobble * 0.8 * math.sin(2.9 * t)), turn)
    return position, turn


def main():
    print("time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw")
    total = APPROACH_S + CLOSE_S + DRIVE_S + HOLD_S + OPEN_S + LEAVE_S
    for i in range(int(round(total / STEP_S)) + 1):
        t = i * STEP_S
        drive = smooth((t - APPROACH_S - CLOSE_S) / DRIVE_S)
        wobble = smooth((t - APPROACH_S - CLOSE_S) / 0.5)
        position, turn = pose(START_DEG + (END_DEG - START_DEG) * drive, wobble, t)
        away = 1 - smooth(t / APPROACH_S) + smooth((t - total + LEAVE_S) / LEAVE_S)
        position = (position[0] + 0.02 * away, position[1] + 0.01 * away, position[2])
        opening = total - LEAVE_S - OPEN_S
        jaw = smooth((t - APPROACH_S) / CLOSE_S) * (1 - smooth((t - opening) / OPEN_S))
        print("%.2f,driver,%.7f,%.7f,%.7f,%.8f,%.8f,%.8f,%.8f,%.3f" % ((t,) + position + turn + (jaw,)))


main()
