# SPDX-License-Identifier: GPL-3.0-or-later
"""Prints coverage by folder from gcovr's summary: folders.py summary.json"""
import collections
import json
import sys

folders = collections.defaultdict(lambda: [0, 0, 0, 0])
for file in json.load(open(sys.argv[1]))["files"]:
    name = file["filename"].rsplit("/", 1)[0]
    for key in (name, "all"):
        for i, field in enumerate(("line_covered", "line_total", "branch_covered", "branch_total")):
            folders[key][i] += file[field]
print("| Folder | Lines | Covered | Branches taken |\n|---|---|---|---|")
for name in sorted(folders, key=lambda n: (n == "all", n)):
    lines, of, branches, of_branches = folders[name]
    taken = f"{100 * branches / of_branches:.0f} %" if of_branches else ""
    print(f"| {name} | {of} | {100 * lines / max(of, 1):.0f} % | {taken} |")
