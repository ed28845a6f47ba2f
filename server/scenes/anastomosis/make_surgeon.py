#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes surgeon.csv: two hands that sew both vessels together with a running suture all around.

The needle is an arc of 180 degrees. In the frame of a stitch its circle lies in the plane y = 0
around (11, 0, 0) mm with radius 8 mm; the frame of stitch k is turned about z by k times the step.
Angles on the circle grow towards the tip: a point at angle a is at (11 + 8 cos a, 0, -8 sin a) mm,
so that the circle meets the proximal outer wall at 128.7 degrees, its lumen at 144.3, the distal
lumen at 200.3 and the distal outer wall at 221.4. A stitch is

    drive      the driver, near the tail, turns the needle about its own centre through both walls
    hand over  the assistant closes near the tip, then the driver opens and leaves
    draw       the assistant turns the needle on along its circle until the tail is out
    carry      and out, round and to the start of the next stitch
    regrasp    the driver closes near the tail, then the assistant opens and leaves

After the last stitch the assistant pulls the thread tight: straight away from the last exit, by
what is left of the thread and `--pull` more.

The hands are not perfect: stitches are placed by fractions of a millimetre and a few degrees off,
and hands wobble as they move, smoothly and from a fixed seed. Where both hold the needle they
steady each other and do not wobble.

    python3 make_surgeon.py > surgeon.csv             the running suture
    python3 make_surgeon.py --one-bite > one_bite.csv  the driver alone, one bite, slowly
    python3 make_surgeon.py --check                   clearances, speeds, thread; writes no file
"""
import argparse
import math
import random
import sys
from collections import namedtuple

# --- the scene, in metres: see scene.toml and vessels.geo -------------------------------------
RADIUS = 0.008               # of the needle's circle
ARC_DEG = 180.0
NEEDLE_RADIUS = 0.0003       # half its diameter
CENTRE_X = 0.011             # of a stitch's circle, in the frame of the stitch
# name, inner and outer radius, z from and to
PROXIMAL = ("proximal", 0.0045, 0.006, -0.02075, -0.00075)
DISTAL = ("distal", 0.0035, 0.005, 0.00075, 0.02075)

# --- the plan: angles of the tip in degrees, times in seconds ---------------------------------
START_DEG = 115.0            # before the proximal wall; the scene puts the needle there
PASSED_DEG = 262.0           # 40 degrees out of the distal wall: enough to take it by the tip
DRAWN_DEG = 422.0            # the tail is out, and clear of the wall
NEXT_DEG = START_DEG + 360.0
DRIVER_BEHIND_DEG = 160.0    # how far behind the tip each jaw holds
ASSISTANT_BEHIND_DEG = 20.0
APPROACH_S, CLOSE_S, OPEN_S, LEAVE_S = 1.0, 0.2, 0.2, 0.5
BOTH_S = 0.2                 # both jaws on the needle
FREE_S = 0.1                 # from the one's opening to the other's first motion
DRIVE_S, DRAW_S, CARRY_S = 2.3, 2.4, 0.9
PULL_S, TIGHT_S = 2.5, 0.5
LIFT = 0.003                 # further outward, half way of a carry
PULL_DIRECTION = (1.0, 0.0, 0.0)  # in the frame of the last stitch: straight out
# A free hand goes round by this much outward and to its own side of the needle's plane.
ROUND_OUTWARD, ROUND_ASIDE = 0.012, 0.012
AWAY = (0.020, 0.010)        # where hands come from at first and go to at last

ROWS_PER_S = 50

# --- what --check asks for ---------------------------------------------------------------------
CLEARANCE = 0.001
OFF_COURSE = 0.0006          # a needle on its course is no farther than this from its circle
TISSUE_SPEED, AIR_SPEED = 0.020, 0.100
LONGEST_S = 60.0

Plan = namedtuple("Plan", "azimuth tip x y z")  # of the needle: degrees; its centre, in the stitch
Row = namedtuple("Row", "time tool position turn jaw")


# --- rotations: quaternions x, y, z, w ----------------------------------------------------------
def multiply(a, b):
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def conjugate(q):
    return (-q[0], -q[1], -q[2], q[3])


def about(axis, degrees):
    half = math.radians(degrees) / 2
    return tuple(math.sin(half) * c for c in axis) + (math.cos(half),)


def rotate(q, v):
    return multiply(multiply(q, (v[0], v[1], v[2], 0.0)), conjugate(q))[:3]


def add(a, b):
    return tuple(x + y for x, y in zip(a, b))


def minus(a, b):
    return tuple(x - y for x, y in zip(a, b))


def times(s, a):
    return tuple(s * x for x in a)


def mix(a, b, u):
    return tuple(x + u * (y - x) for x, y in zip(a, b))


def smooth(x):
    """From 0 to 1 without a jerk; its speed is 15/8 of the mean at most."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (10 - 15 * x + 6 * x * x)


def bump(u):
    """0, 1, 0 at the beginning, the middle and the end."""
    return 16 * u * u * (1 - u) * (1 - u)


# --- the needle in its plan ------------------------------------------------------------------------
def on_circle(plan, degrees):
    """The point of the needle's circle at that angle, in the world."""
    a = math.radians(degrees)
    local = (plan.x + RADIUS * math.cos(a), plan.y, plan.z - RADIUS * math.sin(a))
    return rotate(about((0, 0, 1), plan.azimuth), local)


def needle_turn(plan):
    """The orientation of the needle's frame, whose x axis points at the tail."""
    turn = multiply(about((0, 1, 0), plan.tip - ARC_DEG), about((1, 0, 0), -90.0))
    return multiply(about((0, 0, 1), plan.azimuth), turn)


def between(a, b, u, lift=0.0):
    plan = Plan(*mix(a, b, smooth(u)))
    return plan._replace(x=plan.x + lift * bump(smooth(u)))


def crossings(plan):
    """Where the circle passes proximal outer wall, its lumen, distal lumen and outer wall, degrees.

    Radii are met in the plane of the circle, so y = 0 and |x| is the radius.
    """
    def meets(radius, distal):
        angle = math.degrees(math.acos((radius - plan.x) / RADIUS))
        return 360.0 - angle if distal else angle
    return (meets(PROXIMAL[2], False), meets(PROXIMAL[1], False),
            meets(DISTAL[1], True), meets(DISTAL[2], True))


class Thread:
    """What of the thread lies where, by plan: straight between the holes, no friction."""

    def __init__(self, stitches):
        self.bites = [[on_circle(plan, angle) for angle in crossings(plan)] for plan in stitches]

    def used(self, k, holes=4):
        """Length from the knot at the first puncture to that hole of stitch k."""
        course = [hole for bite in self.bites[:k] for hole in bite] + self.bites[k][:holes]
        return sum(math.dist(a, b) for a, b in zip(course, course[1:]))

    def closing(self, gap):
        """What it gets shorter, about, when the gap closes: all that crosses the gap, along z."""
        total = 0.0
        course = [hole for bite in self.bites for hole in bite]
        for a, b in zip(course, course[1:]):
            if a[2] * b[2] < 0:
                closed = math.dist(a, (b[0], b[1], b[2] + math.copysign(gap, a[2] - b[2])))
                total += math.dist(a, b) - closed
        return total


# --- hands ------------------------------------------------------------------------------------------
class Hand:
    """The motions of one tool, one after the other."""

    def __init__(self, tool, behind_deg, side, wobble, seed):
        self.tool, self.behind_deg, self.side = tool, behind_deg, side
        self.wobble = wobble
        self.phases = [random.Random(f"{seed} {tool}").uniform(0, 2 * math.pi)
                       for _ in range(4)] if seed is not None else (0.0, 0.4, 1.1, 0.0)
        self.motions = []  # (begin, end, pose of u, jaw before and after, wobbles)
        self.time, self.jaw = 0.0, 0.0

    def do(self, duration, pose, jaw=None, wobbles=False):
        """For `duration`, the pose goes through pose(0 … 1), which is (position, turn, azimuth)."""
        jaw = self.jaw if jaw is None else jaw
        self.motions.append((self.time, self.time + duration, pose, self.jaw, jaw, wobbles))
        self.time += duration
        self.jaw = jaw

    def on(self, plan):
        """The pose of the jaw on the needle."""
        turn = needle_turn(plan)
        if self.side < 0:
            turn = multiply(turn, (1.0, 0.0, 0.0, 0.0))  # from the other side
        return on_circle(plan, plan.tip - self.behind_deg), turn, plan.azimuth

    def stay(self, duration, plan, jaw=None):
        self.do(duration, lambda u: self.on(plan), jaw)

    def lead(self, duration, a, b, lift=0.0):
        """Leads the needle from `a` to `b`."""
        self.do(duration, lambda u: self.on(between(a, b, u, lift)), wobbles=True)

    def go(self, duration, a, b):
        """From its place on the needle at `a` round to its place on it at `b`, jaw open."""
        def polar(plan):
            p = rotate(about((0, 0, 1), -plan.azimuth), self.on(plan)[0])
            return math.hypot(p[0], p[1]), math.degrees(math.atan2(p[1], p[0])), p[2]
        ends = polar(a), polar(b)

        def pose(u):
            plan = between(a, b, u)
            radius, angle, z = mix(ends[0], ends[1], smooth(u))
            out = bump(smooth(u))
            place = (radius * math.cos(math.radians(angle)) + out * ROUND_OUTWARD,
                     radius * math.sin(math.radians(angle)) + out * self.side * ROUND_ASIDE, z)
            return rotate(about((0, 0, 1), plan.azimuth), place), self.on(plan)[1], plan.azimuth
        self.do(duration, pose, wobbles=True)

    def far(self, duration, plan, leaves):
        """Comes to its place on the needle from far away, or leaves it so."""
        def pose(u):
            position, turn, azimuth = self.on(plan)
            away = smooth(u) if leaves else 1 - smooth(u)
            off = (away * AWAY[0], away * AWAY[1] * self.side, 0.0)
            return add(position, rotate(about((0, 0, 1), azimuth), off)), turn, azimuth
        self.do(duration, pose)

    def at(self, time):
        """Position, turn and jaw."""
        for begin, end, pose, before, after, wobbles in self.motions:
            if time <= end:
                break
        u = min(max((time - begin) / (end - begin), 0.0), 1.0)
        position, turn, azimuth = pose(u)
        size = self.wobble if wobbles else 0.0
        size *= smooth((time - begin) / 0.4) * smooth((end - time) / 0.4)
        world = about((0, 0, 1), azimuth)
        shake = (0.12e-3 * math.sin(5.1 * time + self.phases[0]),
                 0.20e-3 * math.sin(3.7 * time + self.phases[1]),
                 0.10e-3 * math.sin(6.3 * time + self.phases[2]))
        tilt = about(rotate(world, (0, 1, 0)), size * 0.8 * math.sin(2.9 * time + self.phases[3]))
        return (add(position, rotate(world, times(size, shake))), multiply(tilt, turn),
                before + (after - before) * smooth(u))

    def rows(self, rate):
        """Rows for the file; none where nothing changes."""
        count = int(math.ceil(self.time * rate - 1e-9))
        rows = [Row(i / rate, self.tool, *self.at(i / rate)) for i in range(count + 1)]
        return [row for i, row in enumerate(rows)
                if i in (0, count) or not rows[i - 1][2:] == row[2:] == rows[i + 1][2:]]


# --- the job -----------------------------------------------------------------------------------------
def stitches_of(options):
    """The needle's circle of each stitch; the tip is where it starts."""
    stitches = []
    for k in range(options.stitches):
        chance = random.Random(f"{options.seed} {k}")
        off = [options.wobble * chance.uniform(-1, 1) for _ in range(3)] if k > 0 else [0, 0, 0]
        stitches.append(Plan(k * options.step + 1.5 * off[0], START_DEG,
                             CENTRE_X + 0.1e-3 * off[1], 0.0, 0.2e-3 * off[2]))
    return stitches


def running_suture(options):
    """Both hands, from the first grasp to the thread pulled tight."""
    driver = Hand("driver", DRIVER_BEHIND_DEG, 1, options.wobble, options.seed)
    assistant = Hand("assistant", ASSISTANT_BEHIND_DEG, -1, options.wobble, options.seed)
    stitches = stitches_of(options)
    first = stitches[0]
    driver.far(APPROACH_S, first, leaves=False)
    driver.stay(CLOSE_S + FREE_S, first, jaw=1.0)
    assistant.far(driver.time, first._replace(tip=NEXT_DEG), leaves=False)
    for k, start in enumerate(stitches):
        passed, drawn = start._replace(tip=PASSED_DEG), start._replace(tip=DRAWN_DEG)
        # drive; the assistant comes round to where the tip will be
        driver.lead(DRIVE_S, start, passed)
        assistant.go(DRIVE_S, start._replace(tip=NEXT_DEG), passed)
        # hand over
        assistant.stay(CLOSE_S, passed, jaw=1.0)
        driver.stay(CLOSE_S + BOTH_S, passed)
        driver.stay(OPEN_S, passed, jaw=0.0)
        assistant.stay(BOTH_S + OPEN_S + FREE_S, passed)
        if k + 1 == len(stitches):
            assistant.lead(DRAW_S, passed, drawn)
            driver.far(LEAVE_S, passed, leaves=True)
            break
        # draw and carry; the driver goes round to where the tail will be
        goal = stitches[k + 1]
        assistant.lead(DRAW_S, passed, drawn)
        assistant.lead(CARRY_S, drawn, goal._replace(tip=NEXT_DEG), LIFT)
        driver.go(assistant.time - driver.time, passed, goal)
        # regrasp
        driver.stay(CLOSE_S, goal, jaw=1.0)
        assistant.stay(CLOSE_S + BOTH_S, goal._replace(tip=NEXT_DEG))
        assistant.stay(OPEN_S, goal._replace(tip=NEXT_DEG), jaw=0.0)
        driver.stay(BOTH_S + OPEN_S + FREE_S, goal)
        assistant.stay(FREE_S, goal._replace(tip=NEXT_DEG))
    # pull tight: the tail goes to where the thread ends, and a little on
    thread = Thread(stitches)
    distance = options.thread - thread.used(len(stitches) - 1) + options.pull
    if distance < 2 * RADIUS:
        sys.exit("the thread is too short: --thread %.3f at least" % (
            options.thread - distance + 2 * RADIUS))
    tail, out = on_circle(drawn, DRAWN_DEG - ARC_DEG), about((0, 0, 1), drawn.azimuth)
    goal = add(thread.bites[-1][3], rotate(out, times(distance, PULL_DIRECTION)))
    way = rotate(conjugate(out), minus(goal, tail))
    tight = drawn._replace(x=drawn.x + way[0], y=drawn.y + way[1], z=drawn.z + way[2])
    assistant.lead(PULL_S, drawn, tight)
    assistant.stay(TIGHT_S, tight)
    return driver, assistant


def one_bite():
    """The driver alone: grasps, drives through both walls, holds, opens and leaves."""
    driver = Hand("driver", 150.0, 1, 1.0, None)
    start = Plan(0.0, START_DEG, CENTRE_X, 0.0, 0.0)
    passed = start._replace(tip=246.0)
    driver.far(1.0, start, leaves=False)
    driver.stay(0.4, start, jaw=1.0)
    driver.lead(5.0, start, passed)
    driver.stay(0.5, passed)
    driver.stay(0.3, passed, jaw=0.0)
    driver.far(0.5, passed, leaves=True)
    return (driver,)


# --- the check ----------------------------------------------------------------------------------------
def distance_to_tube(tube, p):
    _, inner, outer, z0, z1 = tube
    r = math.hypot(p[0], p[1])
    dr = max(inner - r, r - outer)
    dz = max(z0 - p[2], p[2] - z1)
    if dr <= 0 and dz <= 0:
        return max(dr, dz)
    return math.hypot(max(dr, 0.0), max(dz, 0.0))


def replay(tracks, start):
    """Yields time, the needle's position and turn, who holds it: rigid grips, nothing else.

    As the simulation has it: a jaw closes above 0.6 and opens below 0.4, and where two hold the
    needle it follows the mean of both; here the one that closed first.
    """
    needle = (on_centre(start), needle_turn(start))
    held = {}  # tool: the needle in its frame
    for rows in zip(*tracks):
        for row in rows:
            if row.jaw > 0.6 and row.tool not in held:
                back = conjugate(row.turn)
                held[row.tool] = (rotate(back, minus(needle[0], row.position)),
                                  multiply(back, needle[1]))
            if row.jaw < 0.4:
                held.pop(row.tool, None)
        for row in rows:
            if held and row.tool == next(iter(held)):
                place, turn = held[row.tool]
                needle = (add(row.position, rotate(row.turn, place)), multiply(row.turn, turn))
        yield rows[0].time, needle, list(held)


def on_centre(plan):
    return rotate(about((0, 0, 1), plan.azimuth), (plan.x, plan.y, plan.z))


def check(options):
    """Replays the hands and says what they ask of needle and thread; returns the faults."""
    hands, stitches = running_suture(options), stitches_of(options)
    thread = Thread(stitches)
    rate, end = 100, hands[1].time
    tracks = [[Row(i / rate, hand.tool, *hand.at(min(i / rate, hand.time)))
               for i in range(int(end * rate) + 1)] for hand in hands]
    back = [about((0, 0, 1), -plan.azimuth) for plan in stitches]
    holes = [crossings(plan) for plan in stitches]
    local = [(RADIUS * math.cos(a), RADIUS * math.sin(a), 0.0)
             for a in (math.radians(s) for s in range(0, int(ARC_DEG) + 1, 2))]

    def on_stitch(p, k):
        """How far that is from the stitch's circle, and the angle on it."""
        x, y, z = minus(rotate(back[k], p), (stitches[k].x, stitches[k].y, stitches[k].z))
        return math.hypot(math.hypot(x, z) - RADIUS, y), math.degrees(math.atan2(-z, x)) % 360.0

    k, passed, before, driver_held, dropped = -1, 0, None, False, False
    clearance, astray, tissue_speed, reach = math.inf, 0.0, 0.0, 0.0
    spare = [math.inf] * len(stitches)
    for time, (centre, turn), held in replay(tracks, stitches[0]):
        if "driver" in held and not driver_held:
            k, passed = k + 1, 0
        driver_held = "driver" in held
        dropped = dropped or (k >= 0 and not held)
        points = [add(centre, rotate(turn, p)) for p in local]
        inside = False
        for p in points:
            gap = min(distance_to_tube(tube, p) for tube in (PROXIMAL, DISTAL)) - NEEDLE_RADIUS
            off, angle = on_stitch(p, max(k, 0))
            if off < OFF_COURSE and holes[k][0] - 20 < angle < holes[k][3] + 20:
                if gap < 0:
                    inside, astray = True, max(astray, off)
            else:
                clearance = min(clearance, gap)
        if before and inside:
            tissue_speed = max(tissue_speed, rate * max(map(math.dist, points, before)))
        before = points
        if k < 0 or time > end - PULL_S - TIGHT_S:
            continue
        # the thread goes from the last hole that the tail has passed to the tail
        off, angle = on_stitch(points[0], k)
        if passed < 4 and off < OFF_COURSE and holes[k][passed] < angle < holes[k][passed] + 20:
            passed += 1
        if passed:
            hole, used = thread.bites[k][passed - 1], thread.used(k, passed)
        elif k > 0:
            hole, used = thread.bites[k - 1][3], thread.used(k - 1)
        else:
            hole, used = thread.bites[0][0], 0.0
        reach = max(reach, math.dist(hole, points[0]))
        spare[k] = min(spare[k], options.thread - used - math.dist(hole, points[0]))
    air_speed = max(rate * math.dist(a.position, b.position)
                    for track in tracks for a, b in zip(track, track[1:]))
    closing = thread.closing(DISTAL[3] - PROXIMAL[4])
    last = len(stitches) - 1

    faults = []

    def say(what, text, holds=True):
        print("%-42s %s%s" % (what, text, "" if holds else "   <- fault"))
        if not holds:
            faults.append(what)

    say("stitches", "%d, %g degrees apart" % (len(stitches), options.step), k == last)
    say("duration", "%.1f s" % end, end <= LONGEST_S)
    say("needle held throughout", "no" if dropped else "yes", not dropped)
    say("needle and vessels apart, off its course", "%.2f mm" % (1e3 * clearance),
        clearance >= CLEARANCE)
    say("in tissue, off its circle", "%.2f mm" % (1e3 * astray), astray < OFF_COURSE)
    say("fastest point of it while in tissue", "%.1f mm/s" % (1e3 * tissue_speed),
        tissue_speed <= TISSUE_SPEED)
    say("fastest hand", "%.1f mm/s" % (1e3 * air_speed), air_speed <= AIR_SPEED)
    for j in range(len(stitches)):
        lies = thread.used(j) - (thread.used(j - 1) if j else 0.0)
        say("thread, stitch %d" % j, "takes %.1f mm, leaves %.1f, to spare at least %.1f" % (
            1e3 * lies, 1e3 * (options.thread - thread.used(j)), 1e3 * spare[j]), spare[j] > 0)
    say("thread, farthest from a hole to the needle", "%.1f mm" % (1e3 * reach))
    say("thread, final pull", "taut at %.1f mm from the last exit, %.1f mm beyond" % (
        1e3 * (options.thread - thread.used(last)), 1e3 * options.pull))
    say("thread, freed by closing the gap", "%.1f mm" % (1e3 * closing))
    return faults


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--stitches", type=int, default=8)
    parser.add_argument("--step", type=float, default=45.0, help="degrees from stitch to stitch")
    parser.add_argument("--thread", type=float, default=0.24, help="length of the thread, m")
    parser.add_argument("--pull", type=float, default=0.02, help="the final pull beyond taut, m")
    parser.add_argument("--wobble", type=float, default=1.0, help="0: hands without fault")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--one-bite", action="store_true", help="the driver alone, one bite")
    parser.add_argument("--check", action="store_true", help="say what the plan asks; no rows")
    options = parser.parse_args()
    if options.check:
        return 1 if check(options) else 0
    hands = one_bite() if options.one_bite else running_suture(options)
    print("time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw")
    rows = [row for hand in hands for row in hand.rows(100 if options.one_bite else ROWS_PER_S)]
    for row in sorted(rows, key=lambda row: row.time):  # stable: hands in their order
        print("%.2f,%s,%.7f,%.7f,%.7f,%.8f,%.8f,%.8f,%.8f,%.3f" % (
            (row.time, row.tool) + row.position + row.turn + (row.jaw,)))
    return 0


sys.exit(main())
