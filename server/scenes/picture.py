#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the end of a run: the tissue as it lies, coloured by stress, with needles and threads.

    /usr/bin/python3 picture.py out/run            # writes out/run/picture.png; needs no display

Reads final.vtk of `sutured run`, and from summary.json, where there is one, `needles` and `threads`:
{name: {"course_m": [[x, y, z], ...], "diameter_m": d}}. The upper view shows everything, the lower ones
the gap between the first two tissues from both sides, the first of them where the sewing is.
"""
import argparse
import json
import os
import sys

try:
    import numpy as np
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib import colors, pyplot
except ImportError as error:
    sys.exit(f"picture: {error}; install python3-matplotlib and python3-numpy (`make picture` does)")

FIELDS = {"von_mises": ("von_mises_pa", "von Mises stress, kPa"),
          "principal": ("principal_pa", "largest principal stress, kPa")}
COLOURS = colors.LinearSegmentedColormap.from_list(
    "stress", ["#f0dcd0", "#f2c2a2", "#f08e62", "#d9483b", "#9c1b45", "#4c0d4f"])
NEEDLE, THREAD = "#8b95a1", "#1f4fa3"
NEEDLE_DIAMETER_M, THREAD_DIAMETER_M = 0.6e-3, 0.2e-3
TEXT = "#333333"
WHOLE_WIDE, CLOSE_UP = 1800, (890, 760)    # pixels; the whole is as high as it needs
BAR = 50                                   # pixels for the scale bar
SAMPLES = 2                                # per pixel and axis
CREASE_COS = 0.77                          # sharper edges are not smoothed over


class Fault(Exception):
    """What is wrong with the input, where, and the mend; one line."""


# ---------------------------------------------------------------- what is read

def read_vtk(path):
    """Returns title, rest positions (n, 3), tets (m, 4) and {name: values} of the points."""
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise Fault(f"{path}: not a regular file; name the folder of a `sutured run`")
        with open(path, encoding="utf-8") as file:
            head = [file.readline(256).strip() for _ in range(3)]
            words = file.read().split() if head[0].startswith("# vtk") else []
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise Fault(f"{path}: {reason}; name the folder of a `sutured run`") from error
    if not head[0].startswith("# vtk DataFile") or head[2] != "ASCII":
        raise Fault(f"{path}: not a legacy VTK text file; `sutured run` writes one")
    at = 0

    def take(count, kind):
        nonlocal at
        values = words[at:at + max(count, 0)]
        if len(values) != count:
            raise Fault(f"{path}: ends in the middle of a list; run it again")
        at += count
        try:
            return np.array(values, dtype=kind)
        except ValueError as error:
            raise Fault(f"{path}: {error}; run it again") from error

    points, tets, fields, size, of_points = None, None, {}, 0, False
    while at < len(words):
        word = words[at]
        at += 1
        if word == "POINTS":
            count = int(take(1, int)[0])
            at += 1
            points = take(3 * count, float).reshape(-1, 3)
        elif word == "CELLS":
            count, total = take(2, int)
            cells = take(total, int)
            if total != 5 * count or (cells[::5] != 4).any():
                raise Fault(f"{path}: has cells other than tets; `sutured run` writes tets only")
            tets = cells.reshape(-1, 5)[:, 1:]
        elif word == "CELL_TYPES":
            take(int(take(1, int)[0]), int)
        elif word in ("POINT_DATA", "CELL_DATA"):
            of_points, size = word == "POINT_DATA", int(take(1, int)[0])
        elif word == "VECTORS":
            name, _ = take(2, str)
            values = take(3 * size, float).reshape(-1, 3)
            if of_points:
                fields[name] = values
        elif word == "SCALARS":
            name = take(5, str)[0]    # then its type, number of components, LOOKUP_TABLE default
            values = take(size, float)
            if of_points:
                fields[name] = values
        elif word not in ("DATASET", "UNSTRUCTURED_GRID"):
            raise Fault(f"{path}: \"{word}\" is unknown here; `sutured run` writes no such section")
    if points is None or tets is None or len(tets) == 0:
        raise Fault(f"{path}: holds no tets; name the folder of a `sutured run`")
    if tets.min() < 0 or tets.max() >= len(points):
        raise Fault(f"{path}: a tet names a point that is not there; run it again")
    if not np.isfinite(points).all():
        raise Fault(f"{path}: a point is not finite; run it again")
    return head[1], points, tets, fields


def read_courses(path, key, diameter_m):
    """Returns [(course (n, 3), diameter)] of a summary's needles or threads; none without them."""
    if not os.path.exists(path):
        return []
    try:
        with open(path, encoding="utf-8") as file:
            things = json.load(file).get(key, {})
        courses = [(np.array(thing["course_m"], dtype=float).reshape(-1, 3),
                    float(thing.get("diameter_m", diameter_m)))
                   for thing in things.values() if thing.get("course_m")]
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise Fault(f"{path}: \"{key}\" cannot be read ({error}); run it again") from error
    return [(course, diameter) for course, diameter in courses
            if len(course) > 1 and np.isfinite(course).all()]


# ---------------------------------------------------------------- surfaces

def boundary(tets, points):
    """Returns the faces that one tet uses, wound outward as seen at `points` (at rest)."""
    faces = np.concatenate([tets[:, [1, 2, 3]], tets[:, [0, 3, 2]], tets[:, [0, 1, 3]], tets[:, [0, 2, 1]]])
    behind = np.concatenate([tets[:, 0], tets[:, 1], tets[:, 2], tets[:, 3]])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    faces, behind = faces[first[count == 1]], behind[first[count == 1]]
    a, b, c = (points[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), points[behind] - a) > 0
    faces[inward] = faces[inward][:, [0, 2, 1]]
    return faces


def parts(tets, count):
    """Returns per vertex the smallest vertex that hangs together with it."""
    part = np.arange(count)
    while True:
        least = part[tets].min(axis=1)
        new = part.copy()
        np.minimum.at(new, tets.ravel(), np.repeat(least, 4))
        new = new[new]
        if (new == part).all():
            return part
        part = new


def unit(v):
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)


def corner_normals(points, faces):
    """Returns a normal per corner (m, 3, 3): the mean of the faces around it, up to a crease."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    weighted = np.cross(b - a, c - a)
    normal = unit(weighted)
    order = np.argsort(faces.ravel(), kind="stable")
    vertex, start = np.unique(faces.ravel()[order], return_index=True)
    result = np.empty((len(faces), 3, 3))
    for _, corners in zip(vertex, np.split(order, start[1:])):
        face = corners // 3
        smooth = (normal[face] @ normal[face].T > CREASE_COS).astype(float)
        result[face, corners % 3] = unit(smooth @ weighted[face])
    return result


def tube(course, radius, sides=14):
    """Returns points, faces and corner normals of a round tube along a course."""
    step = np.linalg.norm(np.diff(course, axis=0), axis=1)
    course = course[np.concatenate([[True], step > 1e-9])]
    if len(course) < 2:
        return np.empty((0, 3)), np.empty((0, 3), int), np.empty((0, 3, 3))
    along = unit(np.gradient(course, axis=0))
    side = unit(np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))]))
    rings, outward = [], []
    angles = 2 * np.pi * np.arange(sides) / sides
    for centre, tangent in zip(course, along):
        side = unit(side - tangent * (side @ tangent))
        out = np.outer(np.cos(angles), side) + np.outer(np.sin(angles), np.cross(tangent, side))
        rings.append(centre + radius * out)
        outward.append(out)
    points = np.concatenate(rings)
    normals = np.concatenate(outward)
    faces = []
    for ring in range(len(course) - 1):
        for i in range(sides):
            a, b = ring * sides + i, ring * sides + (i + 1) % sides
            faces += [(a, b, b + sides), (a, b + sides, a + sides)]
    for ring, turn in ((0, -1), (len(course) - 1, 1)):       # flat ends
        for i in range(1, sides - 1):
            faces.append(tuple(ring * sides + k for k in (0, i, i + 1)[::turn]))
    faces = np.array(faces)
    return points, faces, normals[faces]


# ---------------------------------------------------------------- drawing

class Canvas:
    """A depth buffer seen from afar along `towards`, with `right` and `up` in the picture."""

    def __init__(self, size, centre, right, up, width_m):
        self.size = size
        self.wide, self.high = (SAMPLES * n for n in size)
        self.axes = np.stack([right, up, np.cross(right, up)])      # the last one to the eye
        self.centre, self.scale = centre, self.wide / width_m
        self.depth = np.full((self.high, self.wide), -np.inf)
        self.normal = np.zeros((self.high, self.wide, 3))
        self.colour = np.ones((self.high, self.wide, 3))
        self.gloss = np.zeros((self.high, self.wide))

    def draw(self, points, faces, normals, colour, gloss, lines=0.0):
        """Draws triangles with a normal per corner and colour(values at pixels) of `points`."""
        seen = (points - self.centre) @ self.axes.T * self.scale
        seen[:, 0] += self.wide / 2
        seen[:, 1] = self.high / 2 - seen[:, 1]
        turned = normals @ self.axes.T
        for corners, normal in zip(faces, turned):
            (ax, ay, az), (bx, by, bz), (cx, cy, cz) = seen[corners]
            area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
            if area >= 0:      # turned away, or seen from its side
                continue
            x0, x1 = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 2, self.wide)
            y0, y1 = max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 2, self.high)
            if x0 >= x1 or y0 >= y1:
                continue
            x = np.arange(x0, x1) + 0.5
            y = (np.arange(y0, y1) + 0.5)[:, None]
            u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
            v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
            w = 1 - u - v
            depth = u * az + v * bz + w * cz
            hit = (u >= 0) & (v >= 0) & (w >= 0) & (depth > self.depth[y0:y1, x0:x1])
            if not hit.any():
                continue
            share = np.stack([u[hit], v[hit], w[hit]], axis=1)
            shade = colour(corners, share)
            if lines:
                sides = np.hypot([bx - cx, cx - ax, ax - bx], [by - cy, cy - ay, ay - by])
                near = (share * (-area / np.maximum(sides, 1e-9))).min(axis=1)   # pixels to a side
                shade = shade * (1 - lines * np.clip(1.3 - near / SAMPLES, 0, 1))[:, None]
            self.depth[y0:y1, x0:x1][hit] = depth[hit]
            self.normal[y0:y1, x0:x1][hit] = share @ normal
            self.colour[y0:y1, x0:x1][hit] = shade
            self.gloss[y0:y1, x0:x1][hit] = gloss

    def image(self):
        """Returns the lit picture, SAMPLES² samples to the pixel."""
        drawn = np.isfinite(self.depth)
        normal = unit(self.normal)
        key, fill = unit(np.array([-0.45, 0.65, 0.75])), unit(np.array([0.8, -0.1, 0.5]))
        light = (0.66 + 0.30 * np.clip(normal @ key, 0, 1) + 0.12 * np.clip(normal @ fill, 0, 1)
                 + 0.05 * normal[..., 1])
        light *= 1 - 0.45 * self.hidden(drawn)
        half = unit(key + np.array([0, 0, 1]))
        shine = self.gloss * np.clip(normal @ half, 0, 1) ** 40
        picture = np.clip(self.colour * np.clip(light, 0, 1.06)[..., None] + shine[..., None], 0, 1)
        picture *= (1 - 0.55 * self.outline(drawn))[..., None]
        picture[~drawn] = 1
        wide, high = self.size
        return picture.reshape(high, SAMPLES, wide, SAMPLES, 3).mean(axis=(1, 3))

    def hidden(self, drawn):
        """How far a pixel lies behind the mean around it: 0 ... 1, dark creases and gaps."""
        drawn = drawn[::SAMPLES, ::SAMPLES]
        depth = np.where(drawn, self.depth[::SAMPLES, ::SAMPLES], 0) / SAMPLES
        result = np.zeros_like(depth)
        for reach in (5, 14):
            weight, total = drawn.astype(float), depth
            for _ in range(2):
                weight, total = box_mean(weight, reach), box_mean(total, reach)
            behind = total / np.maximum(weight, 1e-9) - depth
            result += 0.5 * np.clip(behind / (3 * reach), 0, 1)
        return result.repeat(SAMPLES, axis=0).repeat(SAMPLES, axis=1)

    def outline(self, drawn):
        """1 at pixels next to something much farther away."""
        depth = np.where(drawn, self.depth, -1e6)
        result = np.zeros(depth.shape, bool)
        jump = 8 * SAMPLES
        for axis in (0, 1):
            for step in (-1, 1):
                result |= depth - np.roll(depth, step, axis) > jump
        return result & drawn


def box_mean(values, reach):
    """Returns the mean over a square of 2 reach + 1, edges repeated."""
    for _ in range(2):
        padded = np.pad(values, [(reach + 1, reach), (0, 0)], mode="edge")
        total = np.cumsum(padded, axis=0)
        values = (total[2 * reach + 1:] - total[:-2 * reach - 1]).T / (2 * reach + 1)
    return values


def facing(points, part):
    """Returns the unit vector from the first tissue to the next, and a point midway between their
    facing ends; of one tissue its longest axis, and its middle."""
    names = np.unique(part)
    centre = points.mean(axis=0)
    if len(names) < 2:
        along = np.linalg.svd(points - centre, full_matrices=False)[2][0]
        return along * np.sign(along[np.argmax(np.abs(along))]), centre
    first, second = points[part == names[0]], points[part == names[1]]
    along = unit(second.mean(axis=0) - first.mean(axis=0))
    end, begin = np.percentile(first @ along, 98), np.percentile(second @ along, 2)
    near = (np.abs(points @ along - (end + begin) / 2) < abs(begin - end) + 0.1 * np.ptp(points @ along))
    middle = points[near].mean(axis=0) if near.any() else centre
    return along, middle + along * ((end + begin) / 2 - middle @ along)


def looking(along, towards, behind=False):
    """Returns right and up of a view with `along` from left to right that faces `towards`, from a
    little above and aside; or the same from behind."""
    towards = towards - along * (towards @ along)
    if np.linalg.norm(towards) < 1e-9:
        towards = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    towards = unit(towards)
    up = np.cross(towards, along)
    if behind:
        towards, along = -towards, -along
    lift, turn = np.radians(20), np.radians(-20 if behind else 20)
    towards, up = (np.cos(lift) * towards + np.sin(lift) * up, np.cos(lift) * up - np.sin(lift) * towards)
    towards, right = (np.cos(turn) * towards - np.sin(turn) * along,
                      np.cos(turn) * along + np.sin(turn) * towards)
    return right, np.cross(towards, right)


def frame(points, right, up):
    """Returns the middle of `points` in a view, and how wide and high they are."""
    seen = points @ np.stack([right, up]).T
    low, high = seen.min(axis=0), seen.max(axis=0)
    return (low + high) / 2 @ np.stack([right, up]), high - low


def scale_bar(axes, size, width_m):
    length_m = max(m * 10.0 ** e for e in range(-6, 2) for m in (1, 2, 5) if m * 10.0 ** e <= 0.2 * width_m)
    pixels = length_m / width_m * size[0]
    x, y = 30, size[1] - 22
    axes.plot([x, x + pixels], [y, y], color=TEXT, linewidth=2.5, solid_capstyle="butt")
    axes.text(x + pixels / 2, y - 7, f"{1e3 * length_m:g} mm", ha="center", va="bottom", color=TEXT)


def draw(run, out, field, max_kpa):
    path = run if run.endswith(".vtk") else os.path.join(run, "final.vtk")
    title, rest, tets, fields = read_vtk(path)
    name, label = FIELDS[field]
    for needed in ("displacement_m", name):
        if needed not in fields:
            raise Fault(f"{path}: holds no {needed} per vertex; run it again with this `sutured`")
        if not np.isfinite(fields[needed]).all():
            raise Fault(f"{path}: {needed} is not finite everywhere; see its summary.json")
    summary = os.path.join(os.path.dirname(path), "summary.json")
    needles = read_courses(summary, "needles", NEEDLE_DIAMETER_M)
    threads = read_courses(summary, "threads", THREAD_DIAMETER_M)
    now = rest + fields["displacement_m"]
    stress_kpa = 1e-3 * (fields[name] if fields[name].ndim == 1 else fields[name][:, 0])

    faces = boundary(tets, rest)
    outside = np.unique(faces)
    part = parts(tets, len(rest))
    top_kpa = max_kpa or np.percentile(stress_kpa[outside], 99.7)
    norm = colors.Normalize(0, top_kpa if top_kpa > 0 else 1, clip=True)
    table, shade = COLOURS(np.linspace(0, 1, 1024))[:, :3], 1024 * stress_kpa / norm.vmax
    normals = corner_normals(now, faces)
    things = [(tube(course, diameter / 2), colors.to_rgb(colour), gloss)
              for courses, colour, gloss in ((needles, NEEDLE, 0.6), (threads, THREAD, 0.25))
              for course, diameter in courses]

    # The first view faces what was sewn: needles and threads at the gap, or else the largest stress.
    skin, courses = now[outside], [course for course, _ in needles + threads]
    along, gap = facing(skin, part[outside])
    across_m = np.linalg.norm((skin - gap) - np.outer((skin - gap) @ along, along), axis=1).max()
    near = np.abs((skin - gap) @ along) < across_m
    stressed = skin[near][np.argmax(stress_kpa[outside][near])] if near.any() else skin[0]
    sewn = np.concatenate(courses) if courses else np.empty((0, 3))
    sewn = sewn[np.linalg.norm(sewn - gap, axis=1) < 1.3 * across_m]
    towards = sewn.mean(axis=0) - gap if len(sewn) else np.zeros(3)
    if np.linalg.norm(towards - along * (towards @ along)) < 0.2 * across_m:    # none, or all around
        towards = stressed - gap
    front, back = looking(along, towards), looking(along, towards, behind=True)
    middle, (width_m, height_m) = frame(skin, *front)
    whole = (WHOLE_WIDE, int(np.clip(WHOLE_WIDE * height_m / (1.06 * width_m) + 2 * BAR, 380, 1000)))
    whole_m = max(1.06 * width_m, height_m * whole[0] / (whole[1] - 2 * BAR))
    close_m = min(2.3 * across_m * CLOSE_UP[0] / (CLOSE_UP[1] - BAR), whole_m)
    views = (("", whole, middle, front, whole_m), ("the gap, from the front", CLOSE_UP, gap, front, close_m),
             ("the gap, from behind", CLOSE_UP, gap, back, close_m))

    dpi, margin, heading = 130, 20, 50
    size = (2 * margin + WHOLE_WIDE + 170, 2 * heading + margin + whole[1] + CLOSE_UP[1])
    figure = pyplot.figure(figsize=(size[0] / dpi, size[1] / dpi), dpi=dpi, facecolor="white")

    def place(x, y, wide, high):
        """Axes at pixels from the upper left."""
        return figure.add_axes((x / size[0], 1 - (y + high) / size[1], wide / size[0], high / size[1]))

    corners = ((margin, heading), (margin, 2 * heading + whole[1]),
               (margin + WHOLE_WIDE - CLOSE_UP[0], 2 * heading + whole[1]))
    for (caption, pixels, centre, axes_m, width_m), corner in zip(views, corners):
        canvas = Canvas(pixels, centre, *axes_m, width_m)
        canvas.draw(now, faces, normals,
                    lambda at, share: table[np.clip(share @ shade[at], 0, 1023).astype(int)], 0.10, lines=0.13)
        for (points, triangles, around), colour, gloss in things:
            canvas.draw(points, triangles, around,
                        lambda at, share, c=colour: np.tile(c, (len(share), 1)), gloss)
        axes = place(*corner, *pixels)
        axes.imshow(canvas.image(), interpolation="antialiased")
        scale_bar(axes, pixels, width_m)
        axes.set_title(caption, fontsize=11, color=TEXT)
        axes.axis("off")
    legend = figure.colorbar(matplotlib.cm.ScalarMappable(norm, COLOURS),
                             cax=place(margin + WHOLE_WIDE + 50, heading + 60, 26, size[1] - 3 * heading - 120),
                             extend="max" if stress_kpa[outside].max() > norm.vmax else "neither")
    legend.set_label(label, fontsize=12, color=TEXT)
    legend.outline.set_visible(False)
    figure.text(margin / size[0], 1 - 14 / size[1], title, va="top", fontsize=14, color=TEXT)
    try:
        figure.savefig(out)
    except (OSError, ValueError) as error:
        raise Fault(f"{out}: cannot be written: {error}; choose another --out") from error
    print(f"picture: {out}: {len(faces)} faces, up to {stress_kpa[outside].max():.3g} kPa, "
          f"{len(needles)} needles, {len(threads)} threads")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("run", help="folder that `sutured run --out` filled, or its final.vtk")
    parser.add_argument("--out", help="PNG to write; RUN/picture.png by default")
    parser.add_argument("--field", choices=FIELDS, default="von_mises",
                        help="stress that colours (default: %(default)s)")
    parser.add_argument("--max-kpa", type=float, help="end of the colour scale; nearly the largest by default")
    options = parser.parse_args()
    if options.max_kpa is not None and not 0 < options.max_kpa < float("inf"):
        parser.error("--max-kpa: must be above zero")
    folder = options.run if not options.run.endswith(".vtk") else os.path.dirname(options.run)
    try:
        draw(options.run, options.out or os.path.join(folder, "picture.png"), options.field, options.max_kpa)
    except Fault as fault:
        sys.exit(f"picture: {fault}")


if __name__ == "__main__":
    main()
