#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Runs one fuzzer from its seeds: tests/fuzz/run.sh FUZZER SEEDS -runs=N | -max_total_time=SECONDS
# What it finds lies in the folder that it names, and stays.
set -euo pipefail
fuzzer=$(realpath "$1")
seeds=$(realpath "$(dirname "$0")")/seeds/$2
work=$(mktemp -d)
cd "$work"
mkdir corpus
# libgmsh and Cyclone keep some memory for good: their leaks are not ours to find.
if ASAN_OPTIONS=detect_leaks=0:allocator_may_return_null=0 "$fuzzer" -seed=1 "$3" -timeout=20 \
  -rss_limit_mb=4096 -print_final_stats=1 corpus "$seeds" >log 2>&1; then
  grep 'stat::number_of_executed' log
  rm -rf "$work"
else
  tail -60 log
  echo "found by $(basename "$fuzzer"): $work"
  exit 1
fi
