#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Installs the packages in DIR into a clean Debian 12, and there, from what is installed alone: runs the main job, shows
# the page, completes commands, builds and runs an outside CMake project, and takes everything away again.
#
#   tests/packages/run.sh build/packages
#
# Needs root and a Debian mirror (MIRROR); says so and ends with 77 where one is missing.
set -euo pipefail
packages=$(realpath "$1")
here=$(dirname "$(realpath "$0")")
source=$(realpath "$here/../..")
mirror=${MIRROR:-http://deb.debian.org/debian}

skip() { echo "SKIPPED: $1"; exit 77; }
fail() { echo "FAILED: $1"; exit 1; }
[ "$(id -u)" = 0 ] || skip "a clean folder to install into needs root"
curl -sfIm 20 "$mirror/dists/bookworm/Release" >/dev/null || skip "$mirror does not answer"

root=$(mktemp -d)
leader= server=
finish() {
  [ -z "$server" ] || kill "$server" 2>/dev/null || true
  [ -z "$leader" ] || kill -KILL "$leader" 2>/dev/null || true
  umount "$root/proc" 2>/dev/null || true
  rm -rf --one-file-system "$root"
}
trap finish EXIT

echo "== a clean Debian"
mmdebstrap --quiet --variant=apt --skip=cleanup/apt bookworm "$root" "$mirror"
mount -t proc proc "$root/proc"
mkdir "$root/packages" "$root/job"
cp "$packages"/*.deb "$root/packages/"
cp "$source/server/scenes/main_job.sh" "$root/job/"
cp -r "$source/tests/integration/find_package/outside" "$root/job/outside"
in_root=(chroot "$root" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive)
inside() { "${in_root[@]}" "$@"; }
install() { inside apt-get install -y -qq --no-install-recommends "$@" >"$root/job/apt.log" 2>&1 || { tail -n 20 "$root/job/apt.log"; fail "apt-get install $*"; }; }

echo "== server, tools, page and documentation"
cd "$root"
install $(ls packages/{sutured_,suture-tools_,libsuture0.1_,sutured-viewer_,sutured-doc_}*.deb | sed 's|^|./|')
for program in sutured suture; do
  ! inside ldd "/usr/bin/$program" | grep 'not found' || fail "$program lacks a library"
done
[ -s "$root/lib/systemd/system/sutured@.service" ] || fail "no unit"
inside sutured check anastomosis >/dev/null || fail "the installed scene"

echo "== the main job"
domain=$((2 * ($$ % 100)))
inside env SCENE=anastomosis SURGEON=/usr/share/sutured/scenes/anastomosis/surgeon.csv OUT=/job/out DOMAIN=$domain \
  bash /job/main_job.sh || { cat "$root/job/out/server.log"; fail "the main job"; }
python3 - "$root/job/out" <<'PY' || fail "what became of the wound"
import json, sys
scene = json.load(open(sys.argv[1] + "/scene/summary.json"))
hands = json.load(open(sys.argv[1] + "/summary.json"))
assert not hands["interrupted"] and all(tool["peak_force_n"] > 0.01 for tool in hands["tools"].values()), hands
for name, wound in scene["wound"].items():
    before, after = wound["gap_at_rest"]["mean_m"], wound["gap"]["mean_m"]
    assert after < 0.5 * before, (name, before, after)
PY

echo "== the service's command line, and the page"
"${in_root[@]}" sutured serve --config /etc/sutured/sutured.toml --session anastomosis --checkpoints /job/checkpoints \
  --domain $domain --http 127.0.0.1:0 >"$root/job/service.log" 2>&1 &
server=$!
until grep -q 'viewer at' "$root/job/service.log"; do
  kill -0 $server 2>/dev/null || { cat "$root/job/service.log"; fail "the service's command line"; }
  sleep 0.1
done
page=$(curl -sf "$(grep -o 'http://[^ ]*' "$root/job/service.log")")
inside suture sessions --domain $domain | tee "$root/job/sessions"
kill -TERM $server
wait $server || { cat "$root/job/service.log"; fail "the end of the server"; }
server=
grep -q '<script' <<<"$page" || fail "the page that the server shows is not the viewer"
grep -q '^anastomosis ' "$root/job/sessions" || fail "the session is not listed"

echo "== completion and manuals"
install bash-completion zsh man-db
complete_words() {
  inside bash -c ". /usr/share/bash-completion/bash_completion; _completion_loader $1; COMP_WORDS=($*${partial+ \"$partial\"}); COMP_CWORD=\$((\${#COMP_WORDS[@]} - 1)); COMP_LINE=\"\${COMP_WORDS[*]}\"; COMP_POINT=\${#COMP_LINE}; _$1 $1; echo \"\${COMPREPLY[@]}\""
}
[ "$(partial=ser complete_words sutured)" = serve ] || fail "completion of a command"
[ "$(partial=--dom complete_words suture sessions)" = --domain ] || fail "completion of an option"
[ "$(partial=rew complete_words suture command)" = rewind ] || fail "completion of a value"
[ "$(partial=re complete_words suture keys)" = "renew revoke" ] || fail "completion of a command's command"
[ "$(partial=--ro complete_words suture keys add)" = --role ] || fail "completion of an option of a command's command"
for shell_file in _sutured _suture; do inside zsh -n "/usr/share/zsh/vendor-completions/$shell_file" || fail "zsh"; done
for page in $(inside sh -c "sutured --help; suture --help" | awk '/^Usage: / { p = $2; print p } /^Subcommands:/ { on = 1 } /^$/ { on = 0 } on && /^  [a-z]/ { print p "-" $1 }'); do
  [ -s "$root/usr/share/man/man1/$page.1.gz" ] || fail "no manual of $page"
  zcat "$root/usr/share/man/man1/$page.1.gz" | grep -q 'EXIT STATUS' || fail "the manual of $page tells no exit codes"
done
for option in $(for of in init add renew revoke list; do inside suture keys $of --help; done | awk '/^  --/ { print $1 }'); do
  zcat "$root/usr/share/man/man1/suture-keys.1.gz" | grep -qF "\\fB${option//-/\\-}\\fR" || fail "the manual of suture-keys lacks $option"
done

echo "== the service, under a systemd of its own"
install systemd-sysv dbus
umount "$root/proc"
systemd-nspawn --quiet --register=no --keep-unit --directory="$root" --boot --console=pipe </dev/null >"$root/job/boot.log" 2>&1 &
nspawn=$!
booted() { nsenter --target "$leader" --mount --uts --ipc --pid env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 "$@"; }
for _ in $(seq 100); do
  leader=$(pgrep -P $nspawn || true)
  [ -n "$leader" ] && booted systemctl is-active --quiet multi-user.target 2>/dev/null && break
  kill -0 $nspawn 2>/dev/null || break
  sleep 0.2
done
if [ -n "$leader" ] && booted systemctl is-active --quiet multi-user.target; then
  unit=sutured@anastomosis
  property() { booted systemctl show --value --property "$1" $unit; }
  # until CONDITION…, at most a minute
  await() { for _ in $(seq 300); do "$@" && return; sleep 0.2; done; booted journalctl --no-pager -u $unit; fail "$*"; }
  printf 'domain = %s\nhttp = "0"\n' $domain | cat - "$root/etc/sutured/sutured.toml" >"$root/job/sutured.toml"
  cp "$root/etc/sutured/sutured.toml" "$root/job/shipped.toml"
  cp "$root/job/sutured.toml" "$root/etc/sutured/sutured.toml"
  booted systemctl start $unit || { booted journalctl --no-pager -u $unit; fail "the service does not start"; }
  # It returned when the server was ready: no waiting here.
  booted suture sessions --domain $domain | tee "$root/job/sessions"
  grep -q '^anastomosis .* running ' "$root/job/sessions" || fail "a service that is ready is not listed"
  property StatusText | grep -q 'serving scene' || fail "no status"
  booted suture top --once --session anastomosis --domain $domain | grep 'real time\|CAP_'
  # Real time and locked memory for the forces.
  [ "$(property LimitRTPRIO)" = 80 ] || fail "real time is limited to $(property LimitRTPRIO)"
  [ "$(property LimitMEMLOCK)" = infinity ] || fail "locked memory is limited to $(property LimitMEMLOCK)"
  # The sandbox: nobody's user, and nothing to write but its own state.
  [ "$(booted stat -c %U "/proc/$(property MainPID)")" != root ] || fail "the service runs as root"
  await booted sh -c 'ls /var/lib/sutured/anastomosis/* >/dev/null 2>&1'
  # A crash, and a process that hangs: both come back, and the simulation goes on.
  booted systemctl kill --kill-who=main --signal=KILL $unit
  came_back() { [ "$(property NRestarts)" = "$1" ] && [ "$(property ActiveState)" = active ]; }
  await came_back 1
  booted journalctl --no-pager -u $unit | grep -q 'resumed' || fail "it did not resume"
  booted systemctl kill --kill-who=main --signal=STOP $unit
  await came_back 2
  booted journalctl --no-pager -u $unit | grep -qi 'watchdog timeout' || fail "the watchdog was silent"
  booted systemctl stop $unit
  [ "$(property ActiveState)" = inactive ] || fail "it ended with a fault: $(property Result)"
  # A bad option is told with its place, and not tried again.
  echo 'rate = 5000' | cat - "$root/job/sutured.toml" >"$root/etc/sutured/sutured.toml"
  ! booted systemctl start $unit 2>/dev/null || fail "a bad option is taken"
  booted journalctl --no-pager -p err -u $unit | grep -q 'sutured.toml:1:8: ' || fail "no place of a bad option"
  [ "$(property ActiveState)" = failed ] || fail "a bad option is tried again"
  booted systemd-analyze security --no-pager $unit | tail -n 1
  # Keys that only root may read, handed in to a second service.
  unit=sutured@secured
  booted suture keys init /job/site --title packages >/dev/null
  booted suture keys add /job/site server --role server >/dev/null
  booted suture keys add /job/site viewer --role viewer >/dev/null
  mkdir "$root/etc/systemd/system/$unit.service.d"
  (echo "[Service]" && cd "$root/job/site/identities/server" && for file in *; do
    echo "LoadCredential=$file:/job/site/identities/server/$file"; done) >"$root/etc/systemd/system/$unit.service.d/keys.conf"
  cat "$root/job/sutured.toml" - >"$root/etc/sutured/sutured.toml" <<TOML
[server.secured]
scene = "anastomosis"
security = "/run/credentials/$unit.service"
TOML
  booted systemctl daemon-reload
  booted systemctl start $unit || { booted journalctl --no-pager -u $unit; fail "a service with keys does not start"; }
  await booted sh -c "suture sessions --domain $domain --security /job/site/identities/viewer 2>/dev/null | grep -q '^secured .* running '"
  booted systemctl stop $unit
  cp "$root/job/shipped.toml" "$root/etc/sutured/sutured.toml"
  kill -KILL "$leader"
else
  echo "NOT TRIED: no systemd can be booted here:"
  tail -n 3 "$root/job/boot.log"
  kill $nspawn 2>/dev/null || true
fi
wait $nspawn 2>/dev/null || true
leader=
mount -t proc proc "$root/proc"

echo "== an outside project"
install ./packages/libsuture-dev_*.deb g++ cmake ninja-build
inside sh -c 'cmake -S /job/outside -B /job/build -G Ninja && cmake --build /job/build' >"$root/job/outside.log" 2>&1 || {
  cat "$root/job/outside.log"; fail "the outside project's build"; }
code=0
said=$(inside /job/build/outside) || code=$?
[ $code = 3 ] && grep -q 'no server answers in domain 198' <<<"$said" || fail "the outside project: $code, $said"

echo "== away again"
inside apt-get purge -y -qq sutured suture-tools libsuture0.1 libsuture-dev sutured-viewer sutured-doc >"$root/job/apt.log" 2>&1 || { cat "$root/job/apt.log"; fail "purge"; }
left=$(find "$root/etc" "$root/usr" "$root/var/lib" \( -name 'sutured*' -o -name 'libsuture*' \) -not -path '*/dpkg/*' -not -path '*/systemd/*')
[ -z "$left" ] || fail "left behind: $left"
echo "passed"
