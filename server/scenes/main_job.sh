#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# The main job: a server with a scene, and in a process of its own the devices that play a recorded surgeon's
# tools over DDS and feel the forces. Leaves what the hands felt in $OUT (plot, log, summary), what became of the
# tissue in $OUT/scene (final.vtk, summary.json), and ends with 0 if everything did.
#
# The page is at HTTP, by default at any free port of this machine; HTTP=off: there is none.
#
#   BIN=build/release SCENE=…/scene.toml SURGEON=…/surgeon.csv OUT=out/run server/scenes/main_job.sh
#
# Without BIN the installed programs do it.
set -euo pipefail
: "${SCENE:?}" "${SURGEON:?}" "${OUT:?}"
sutured=${BIN:+$BIN/server/}sutured
suture=${BIN:+$BIN/client-sdk/cli/}suture
domain=${DOMAIN:-0}
mkdir -p "$OUT"

"$sutured" serve "$SCENE" --domain "$domain" --http "${HTTP:-127.0.0.1:0}" --out "$OUT/scene" >"$OUT/server.log" 2>&1 &
server=$!
trap 'kill -INT $server 2>/dev/null || true; wait $server 2>/dev/null || true' EXIT

[ "${HTTP:-}" = off ] && last_word='serving scene .*' || last_word='viewer at .*'
until says=$(grep -o "$last_word" "$OUT/server.log"); do
  kill -0 $server 2>/dev/null || { echo "the server did not start:"; cat "$OUT/server.log"; exit 1; }
  sleep 0.1
done
echo "$says"
echo "viewers and recorders join on DDS domain $((domain + 1)); rates and latencies: suture top --domain $domain"
# It waits for the server by itself, and says why if none comes. Before the last hand lets go the scene is paused: there is
# no knot yet, and the suture would open.
"$suture" device --surgeon "$SURGEON" --domain "$domain" --timeout 20 --pause-at-end \
  --log "$OUT/forces.csv" --plot "$OUT/force.svg" --summary "$OUT/summary.json" || {
  echo "--- server log:"; cat "$OUT/server.log"; exit 1; }

trap - EXIT
kill -INT $server
wait $server || { echo "the server ended with $?:"; cat "$OUT/server.log"; exit 1; }
python3 - "$OUT/scene/summary.json" <<'PY' 2>/dev/null || true
import json, sys
scene = json.load(open(sys.argv[1]))
for name, wound in scene["wound"].items():
    print("  gap %-17s %.2f mm before, %.2f mm after (largest %.2f)" % (
        name, 1e3 * wound["gap_at_rest"]["mean_m"], 1e3 * wound["gap"]["mean_m"], 1e3 * wound["gap"]["max_m"]))
for name, q in scene["quality"].items():
    print("  %-21s %d bites %.2f mm deep, %.2f mm apart (spread %.2f), tension left %.3f N, %d hand-overs" % (
        name, len(q["bites"]), 1e3 * q["bite_depth_m"]["mean"], 1e3 * q["bite_spacing_m"]["mean"],
        1e3 * q["bite_spacing_m"]["standard_deviation"], q["tension_n"], q["handovers"]))
print("  tissue                largest principal stress %.1f kPa, %d pairs in contact with %.2f N" % (
    1e-3 * scene["stress"]["principal_max_pa"], scene["contact"]["pairs_with_force"], scene["contact"]["force_sum_n"]))
PY
echo "  what became of it     $OUT/scene/summary.json, final.vtk; a picture: make picture"
echo "  server log            $OUT/server.log"
echo "  every force           $OUT/forces.csv"
