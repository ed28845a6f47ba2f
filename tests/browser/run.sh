#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# run.sh FOLDER COMMAND…: runs it there; 77 and a word where Node or the folder's packages are missing.
command -v node >/dev/null || { echo "skipped: node is not installed"; exit 77; }
cd "$1" || exit 1
[ -d node_modules ] || { echo "skipped: $1 has no packages: \`make deps-node\`"; exit 77; }
shift
exec "$@"
