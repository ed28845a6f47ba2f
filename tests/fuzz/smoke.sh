#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Runs each fuzzer for a while from its seeds: tests/fuzz/smoke.sh FOLDER_OF_FUZZERS SECONDS_EACH
set -euo pipefail
fuzzers=$(realpath "$1")
seconds=$2
here=$(realpath "$(dirname "$0")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
for fuzzer in fuzz_mesh_header fuzz_mesh_reader fuzz_scene; do
  seeds=$here/seeds/mesh
  [ "$fuzzer" = fuzz_scene ] && seeds=$here/seeds/scene
  mkdir "$fuzzer"
  echo "== $fuzzer, $seconds s"
  # libgmsh keeps some memory for good: its leaks are not ours to find.
  ASAN_OPTIONS=detect_leaks=0 "$fuzzers/$fuzzer" -seed=1 -max_total_time="$seconds" -timeout=20 \
    -rss_limit_mb=4096 -print_final_stats=1 "$fuzzer" "$seeds" 2>&1 |
    grep -E 'ERROR|SUMMARY|Test unit|stat::number_of_executed|runtime error'
done
