#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# The main job: a server with a scene, and for each tool of a recorded surgeon a device in a process of its own that
# plays it over DDS and feels the forces. Leaves plot, log and summary of $TOOL in $OUT, what the other devices said in
# $OUT/device-NAME.log, and ends with 0 if everything did.
#
#   BIN=build/release SCENE=…/scene.toml SURGEON=…/surgeon.csv OUT=out/run server/scenes/main_job.sh
set -euo pipefail
: "${BIN:?folder of the binaries}" "${SCENE:?}" "${SURGEON:?}" "${OUT:?}"
domain=${DOMAIN:-0}
tool=${TOOL:-driver}
mkdir -p "$OUT"

"$BIN/server/sutured" serve "$SCENE" --domain "$domain" >"$OUT/server.log" 2>&1 &
server=$!
others=()
finish() {
  for pid in "${others[@]}" $server; do kill -INT "$pid" 2>/dev/null || true; done
  wait || true
}
trap finish EXIT

echo "viewers and recorders join on DDS domain $((domain + 1)); rates and latencies: suture top --domain $domain"
# Devices wait for the server by themselves, and say why if none comes. All begin to play within a few hundredths of a
# second of one another, as soon as it is there.
for other in $(sed -e 1d -e '/^#/d' "$SURGEON" | cut -d, -f2 | sort -u); do
  [ "$other" = "$tool" ] && continue
  "$BIN/client-sdk/cli/suture" device --tool "$other" --surgeon "$SURGEON" --domain "$domain" --timeout 20 --quiet \
    >"$OUT/device-$other.log" 2>&1 &
  others+=($!)
done
"$BIN/client-sdk/cli/suture" device --tool "$tool" --surgeon "$SURGEON" --domain "$domain" --timeout 20 \
  --log "$OUT/forces.csv" --plot "$OUT/force.svg" --summary "$OUT/summary.json" || {
  echo "--- server log:"; cat "$OUT/server.log"; exit 1; }
for pid in "${others[@]}"; do
  wait "$pid" || { echo "a device ended with $?:"; cat "$OUT"/device-*.log; exit 1; }
done

trap - EXIT
kill -INT $server
wait $server || { echo "the server ended with $?:"; cat "$OUT/server.log"; exit 1; }
echo "  server log            $OUT/server.log"
echo "  every force           $OUT/forces.csv"
