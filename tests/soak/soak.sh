#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Everything that runs long, one after the other within a time, and a report of it:
# tests/soak/soak.sh MINUTES OUT BUILD [BUILD_OF_FUZZERS]
# WITH, where set, is put before each stage, as "taskset -c 1".
# Writes OUT/soak.md, OUT/campaign.json and a log a stage; fails where one of them does.
set -uo pipefail
minutes=$1
out=$2
build=$3
fuzzers=${4:-}
here=$(realpath "$(dirname "$0")")
seconds=$((minutes * 60))
mkdir -p "$out"
report=$out/soak.md
failed=0

# stage NAME COMMAND…: runs it, keeps what it said, and tells the report.
stage() {
  local name=$1 begun=$SECONDS result=passed
  shift
  echo "== $name: ${*##*/}"
  ${WITH:-} "$@" >"$out/$name.log" 2>&1 || { result=FAILED; failed=1; }
  cat "$out/$name.log"
  printf '\n## %s: %s, %d s\n\n' "$name" "$result" $((SECONDS - begun)) >>"$report"
  case $name in
    campaign) [ ! -e "$out/campaign.md" ] || cat "$out/campaign.md" >>"$report" ;;
    *) { echo '```'; sed "s|$here/||" "$out/$name.log"; echo '```'; } >>"$report" ;;
  esac
}

rm -f "$out/campaign.md"
cat >"$report" <<EOF
# Soak

\`make soak MINUTES=$minutes\`, $(date -u +%F), commit $(git -C "$here" describe --always --dirty), $(nproc) processors
($(sed -nE 's/^model name\s*: //p' /proc/cpuinfo | head -1)), preset \`dev\`. What each stage asks for: tests/soak/README.md.
Load of the machine when it began: $(cut -d' ' -f1 /proc/loadavg).
EOF
long_run=$((seconds / 6 > 60 ? seconds / 6 : 60))
stage campaign "$build/tests/soak/sutured_campaign" --seconds $((seconds / 2)) --out "$out"
stage long_run "$build/tests/soak/sutured_long_run" --seconds $long_run
# A thousand in an hour, for as long as they take: seconds are no measure of what was tried.
stage surgeons "$build/tests/soak/sutured_surgeons" --count $((minutes * 1000 / 60))
stage packets "$build/tests/soak/packet_attack/sutured_packet_attack" --packets $((seconds * 300))
stage web "$build/tests/soak/sutured_web_attack" --count $((seconds * 30 > 100000 ? seconds * 30 : 100000))
[ -z "$fuzzers" ] || stage fuzz "$here/../fuzz/all.sh" "$fuzzers" $((seconds / 90))
exit $failed
