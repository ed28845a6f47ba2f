#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Man pages of both programs and each of their commands, out of what `--help` says:
#
#   docs/man/make.sh DIR path/to/sutured path/to/suture
#
# help2man makes the page; what stands below the options in the help (examples, notes, exit codes) becomes its sections. A
# command that has commands of its own tells of each of them, with its options, on its page.
set -euo pipefail
out=$1
shift
mkdir -p "$out"
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT

# The part of a help text from "Exit code" on.
exit_codes() {
  awk '/^ *Exit codes?:/ { on = 1; sub(/^ *Exit codes?: */, "") } on && NF' "$1" | sed 's/^ *//; s/ · /, /g'
}
# Text of a man page, line by line as it is.
as_it_is() { sed -e 's/\\/\\e/g' -e 's/-/\\-/g' -e "s/^\([.']\)/\\\\\&\1/" -e '1i .nf' -e '$a .fi'; }

# The commands that a help text lists.
commands_in() { awk '/^Subcommands:/ { on = 1; next } /^$/ { on = 0 } on && /^  [a-z]/ { print $1 }' "$1"; }

# nested COMMAND…: what the commands of COMMAND take, each below a heading of its own, as help2man knows one.
nested() {
  local command help
  help=$(mktemp -p "$work")
  "$@" --help >"$help"
  for command in $(commands_in "$help"); do
    "$@" "$command" --help | awk '
      NR == 1 { title = $0; next }
      /^Usage:/ { sub(/^Usage: */, ""); print "\n" $0 ":\n  " title "\n"; next }
      /^(Examples?|Subcommands):/ || /^ *Exit codes?:/ { exit }
      /^[^ ]/ || /^  -h,--help / { next }
      NF'
    nested "$@" "$command"
  done
}

# page NAME TITLE COMMAND…: NAME is the page's, COMMAND what it is about.
page() {
  local name=$1 title=$2
  shift 2
  "$@" --help >"$work/help"
  {
    if grep -q '^Examples\?:' "$work/help"; then
      echo '[EXAMPLES]'
      awk '/^Examples?:/ { on = 1; sub(/^Examples?: */, "  "); if (!NF) next } on && /^[^ ]/ { exit } on' "$work/help" | sed 's/^  //' | as_it_is
      awk '/^Examples?:/ { on = 1; next } /^ *Exit codes?:/ { exit } on && /^[^ ]/ { rest = 1 } rest' "$work/help" >"$work/notes"
      if [ -s "$work/notes" ]; then echo '[NOTES]'; as_it_is <"$work/notes"; fi
    fi
    echo '[EXIT STATUS]'
    { exit_codes "$work/help"; [ -n "$(exit_codes "$work/help")" ] || exit_codes "$work/program"; } | as_it_is
    echo '[SEE ALSO]'
    echo "$pages" | tr ' ' '\n' | grep -vx "$name" | sed 's/-/\\-/g; s/.*/\\fB&\\fR(1),/; $s/,$//'
  } >"$work/include"
  # help2man asks a program; this one says what of the help is its business, and its name for the title.
  awk '/^Examples?:/ || /^ *Exit codes?:/ { exit } { print }' "$work/help" >"$work/head"
  [ $# = 1 ] || nested "$@" >>"$work/head"
  printf '#!/bin/sh\ncat %q\n' "$work/head" >"$work/$name"
  chmod +x "$work/$name"
  help2man --no-info --version-string="$version" --source="sutured $version" --name="$title" \
    --include="$work/include" --output="$out/$name.1" "$work/$name"
}

for program in "$@"; do
  name=$(basename "$program")
  version=$("$program" --version)
  "$program" --help >"$work/program"
  commands=$(commands_in "$work/program")
  pages="$name $(printf "$name-%s " $commands)"
  pages=${pages% }
  page "$name" "$(sed -n '1s/^[a-z]*: //p' "$work/program")" "$program"
  for command in $commands; do
    title=$("$program" "$command" --help | sed -n 1p)
    page "$name-$command" "${title,}" "$program" "$command"
  done
done
