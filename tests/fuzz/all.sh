#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Runs every fuzzer for a while, one after the other: tests/fuzz/all.sh FOLDER_OF_FUZZERS SECONDS_EACH
set -uo pipefail
failed=0
while read -r fuzzer seeds; do
  echo "== $fuzzer, $2 s"
  "$(dirname "$0")/run.sh" "$1/$fuzzer" "$seeds" -max_total_time="$2" || failed=1
done < <(sed -nE 's/^sutured_fuzzer\((fuzz_[a-z_]+) SEEDS ([a-z]+) .*/\1 \2/p' "$(dirname "$0")/CMakeLists.txt")
exit $failed
