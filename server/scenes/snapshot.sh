#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Draws docs/guide/snapshot.png: a recorded hand leads the needle through both vessels, the scene is paused there, and
# `suture snapshot` takes its picture.
#
#   BIN=build/release OUT=docs/guide/snapshot.png server/scenes/snapshot.sh
set -euo pipefail
: "${BIN:?folder of the binaries}" "${OUT:?}"
domain=${DOMAIN:-0}
scenes=$(dirname "$0")/anastomosis
session=snapshot-$$
folder=$(mktemp -d)
"$BIN/server/sutured" serve "$scenes/scene.toml" --domain "$domain" --session $session --http 127.0.0.1:0 >"$folder/log" 2>&1 &
server=$!
trap 'kill -INT $server 2>/dev/null || true; wait $server 2>/dev/null || true; rm -r "$folder"' EXIT

until url=$(grep -o 'http://127.*' "$folder/log"); do
  kill -0 $server 2>/dev/null || { cat "$folder/log"; exit 1; }
  sleep 0.1
done
# In the recording's fourth second the needle is in both.
awk -F, 'NR == 1 || $1 <= 3.9' "$scenes/one_bite.csv" >"$folder/hand.csv"
"$BIN/client-sdk/cli/suture" device --surgeon "$folder/hand.csv" --domain "$domain" --session $session --timeout 20 --pause-at-end --quiet
"$BIN/client-sdk/cli/suture" snapshot "$OUT" --url "$url" --view needle --size 1200x720
