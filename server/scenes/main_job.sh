#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# The main job: a server with a scene, and in a process of its own the devices that play a recorded surgeon's
# tools over DDS and feel the forces. Leaves plot, log and summary in $OUT, and ends with 0 if everything did.
#
#   BIN=build/release SCENE=…/scene.toml SURGEON=…/surgeon.csv OUT=out/run server/scenes/main_job.sh
set -euo pipefail
: "${BIN:?folder of the binaries}" "${SCENE:?}" "${SURGEON:?}" "${OUT:?}"
domain=${DOMAIN:-0}
mkdir -p "$OUT"

"$BIN/server/sutured" serve "$SCENE" --domain "$domain" >"$OUT/server.log" 2>&1 &
server=$!
trap 'kill -INT $server 2>/dev/null || true; wait $server 2>/dev/null || true' EXIT

echo "viewers and recorders join on DDS domain $((domain + 1)); rates and latencies: suture top --domain $domain"
# It waits for the server by itself, and says why if none comes.
"$BIN/client-sdk/cli/suture" device --surgeon "$SURGEON" --domain "$domain" --timeout 20 \
  --log "$OUT/forces.csv" --plot "$OUT/force.svg" --summary "$OUT/summary.json" || {
  echo "--- server log:"; cat "$OUT/server.log"; exit 1; }

trap - EXIT
kill -INT $server
wait $server || { echo "the server ended with $?:"; cat "$OUT/server.log"; exit 1; }
echo "  server log            $OUT/server.log"
echo "  every force           $OUT/forces.csv"
