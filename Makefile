# SPDX-License-Identifier: Apache-2.0
# One command an intent. `make run` and `make test` work on a fresh Debian 12.
SHELL := /bin/bash
.DEFAULT_GOAL := help

BUILD_PACKAGES := build-essential cmake ninja-build ccache git pkg-config \
  libopenblas-serial-dev libsuitesparse-dev libeigen3-dev \
  cyclonedds-dev cyclonedds-tools libboost1.81-dev libboost-url1.81-dev libssl-dev libspdlog-dev \
  libtomlplusplus-dev libgmsh-dev libcli11-dev nlohmann-json3-dev libzstd-dev libsystemd-dev
PICTURE_PACKAGES := python3-matplotlib python3-numpy
TEST_PACKAGES := libgtest-dev libgmock-dev libbenchmark-dev libpng-dev calculix-ccx iproute2 openssl systemd \
  help2man zsh clang libclang-rt-14-dev $(PICTURE_PACKAGES)
BROWSER_PACKAGES := chromium
BENCH_PACKAGES := rt-tests
COVERAGE_PACKAGES := gcovr
MESH_PACKAGES := gmsh
DEB_PACKAGES := debhelper help2man lintian
CLEAN_ROOT_PACKAGES := mmdebstrap systemd-container curl
CHECK_PACKAGES := clang-format clang-tidy
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)

# install-packages LIST: asks apt only for what is missing.
define install-packages
	@missing=""; for p in $(1); do \
	  dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then echo "installing:$$missing"; \
	  $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq --no-install-recommends $$missing >/dev/null; fi
endef

.PHONY: help
help: ## List the commands
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 16

.PHONY: deps-build deps-test deps-check
deps-build:
	$(call install-packages,$(BUILD_PACKAGES))
deps-test: deps-build
	$(call install-packages,$(TEST_PACKAGES))
deps-check: deps-test
	$(call install-packages,$(CHECK_PACKAGES))

.PHONY: build
build: deps-build ## Build the release binaries
	@cmake --preset release -DSUTURED_TESTS=OFF -DSUTURED_BENCH=OFF >/dev/null
	@cmake --build --preset release

# The page of the gateway, into build/viewer. Debian's Node.js serves where none is installed.
.PHONY: viewer
viewer: ## Build the web page that `sutured serve --http` shows
	@command -v npm >/dev/null || { $(SUDO) apt-get update -qq && \
	  DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq --no-install-recommends nodejs npm >/dev/null; }
	@cd client-sdk/viewer && npm ci --no-audit --no-fund --silent && npm run --silent build

# What the tests in JavaScript need besides: with a browser, and with others' packages.
.PHONY: deps-node
deps-node: viewer
	$(call install-packages,$(BROWSER_PACKAGES))
	@for tests in browser interop; do (cd tests/$$tests && npm ci --no-audit --no-fund --silent) || exit; done

.PHONY: viewer-picture
viewer-picture: build deps-node ## Draw the page in a browser: docs/guide/viewer.png
	@node tests/browser/picture.mjs docs/guide/viewer.png

.PHONY: snapshot-picture
snapshot-picture: build viewer ## Draw a paused scene by `suture snapshot`: docs/guide/snapshot.png
	$(call install-packages,$(BROWSER_PACKAGES))
	@BIN=build/release OUT=docs/guide/snapshot.png DOMAIN=$(or $(DOMAIN),0) server/scenes/snapshot.sh

RUN_DIR := out/run
SCENE := server/scenes/anastomosis/scene.toml
SURGEON := server/scenes/anastomosis/surgeon.csv
BIN := build/release
DOMAIN ?= 0
HTTP ?= 127.0.0.1:8080
PREFIX ?= /usr/local

.PHONY: run
run: build viewer ## Run the main job: server, devices that play a surgeon's hands over DDS, plot and summary
	@BIN=$(BIN) SCENE=$(SCENE) SURGEON=$(SURGEON) OUT=$(RUN_DIR) DOMAIN=$(DOMAIN) server/scenes/main_job.sh

# Without RUN: the last `make run` where it left a final state, or else the same scene played offline.
.PHONY: picture
picture: $(if $(RUN),,build) ## Draw the tissue at the end of a run (RUN=DIR) coloured by stress, as a PNG
	$(call install-packages,$(PICTURE_PACKAGES))
	@run="$(or $(RUN),$(RUN_DIR)/scene)"; \
	if [ -z "$(RUN)" ] && [ ! -e "$$run/final.vtk" ]; then run=out/offline; \
	  $(BIN)/server/sutured run $(SCENE) --surgeon $(SURGEON) --out "$$run" || exit; fi; \
	/usr/bin/python3 server/scenes/picture.py "$$run"

.PHONY: serve
serve: build viewer ## Serve the anastomosis scene, with the page at HTTP, until Ctrl-C
	@$(BIN)/server/sutured serve $(SCENE) --domain $(DOMAIN) --http $(HTTP)

.PHONY: install
install: build ## Install commands, SDK and licences below PREFIX
	@cmake --install build/release --prefix $(PREFIX) >/dev/null && echo "installed below $(PREFIX)"

# debhelper's own commands, without dpkg-buildpackage, which would leave its files beside this folder.
.PHONY: deb
deb: deps-build viewer ## Build the Debian packages: build/packages
	$(call install-packages,$(DEB_PACKAGES))
	@export DEB_RULES_REQUIRES_ROOT=no DEB_BUILD_OPTIONS="parallel=$$(nproc)" CCACHE_DIR="$$(ccache --get-config cache_dir)"; \
	  debian/rules clean >/dev/null && rm -rf build/packages && mkdir -p build/packages && debian/rules binary >build/packages.log 2>&1 || \
	  { tail -n 30 build/packages.log; echo "all of it: build/packages.log"; exit 1; }
	@lintian --fail-on error build/packages/*.deb
	@ls build/packages

.PHONY: test-packages
test-packages: deb ## Install the packages into a clean Debian, run the main job there, build an outside project
	$(call install-packages,$(CLEAN_ROOT_PACKAGES))
	@tests/packages/run.sh build/packages

.PHONY: test
test: deps-test deps-node ## Build and run every test
	@cmake --preset dev >/dev/null
	@cmake --build --preset dev
	@ctest --preset dev --progress
	@cmake --preset tsan >/dev/null
	@cmake --build --preset threads
	@ctest --preset threads --progress
	@cmake --preset fuzz >/dev/null
	@cmake --build --preset fuzz --target fuzzers
	@ctest --preset fuzz --progress

# HOURS=24, or MINUTES=10: an hour if not said.
MINUTES ?= $(if $(HOURS),$(shell echo $$(($(HOURS) * 60))),60)
.PHONY: soak
soak: deps-test ## Let everything run long, HOURS or MINUTES: a report in out/soak/soak.md
	@cmake --preset dev >/dev/null
	@cmake --build --preset dev --target sutured_campaign sutured_surgeons sutured_long_run sutured_packet_attack \
	  sutured_web_attack
	@cmake --preset fuzz >/dev/null
	@cmake --build --preset fuzz --target fuzzers
	@tests/soak/soak.sh $(MINUTES) out/soak build/dev build/fuzz/tests/fuzz

# In a build folder of its own, at -O1 so that lines stay where they are. TESTS limits it, as ctest -R does.
COVERAGE := build/coverage
TESTS ?= .
.PHONY: coverage
coverage: deps-test ## Print how much of the sources the tests run: all, or those that match TESTS
	$(call install-packages,$(COVERAGE_PACKAGES))
	@cmake --preset coverage >/dev/null
	@cmake --build --preset coverage $(if $(TARGETS),--target $(TARGETS))
	@find $(COVERAGE) -name '*.gcda' -delete
	@ctest --test-dir $(COVERAGE) -R '$(TESTS)' -LE '$(or $(WITHOUT),none)' --output-on-failure --progress; result=$$?; \
	gcovr --root . --object-directory $(COVERAGE) --filter server/ --filter protocol/ --filter client-sdk/ \
	  --exclude '.*/examples/' --exclude-throw-branches --exclude-unreachable-branches --print-summary \
	  --json-summary $(COVERAGE)/summary.json --txt $(COVERAGE)/files.txt && \
	/usr/bin/python3 tests/coverage/folders.py $(COVERAGE)/summary.json && exit $$result

.PHONY: bench
bench: deps-test ## Measure the budgets: a table, and build/bench/results.json
	$(call install-packages,$(BENCH_PACKAGES))
	@cmake --preset release -DSUTURED_TESTS=OFF -DSUTURED_BENCH=ON >/dev/null
	@cmake --build --preset release
	@mkdir -p build/bench
	@$(BIN)/tests/bench/sutured_bench --out build/bench/results.json \
	  --commit "$$(git describe --always --dirty 2>/dev/null || echo unknown)"

.PHONY: faults
faults: deps-test ## Inject every fault into servers and devices over DDS: docs/results/faults.md
	@cmake --preset release -DSUTURED_TESTS=ON -DSUTURED_BENCH=OFF >/dev/null
	@cmake --build --preset release --target sutured_faults
	@mkdir -p out/faults
	@$(BIN)/tests/faults/sutured_faults --table docs/results/faults.md --curves out/faults/faults.csv \
	  --commit "$$(git describe --always --dirty 2>/dev/null || echo unknown)"; result=$$?; \
	/usr/bin/python3 tests/faults/plot.py out/faults/faults.csv docs/images/faults.png && exit $$result

.PHONY: attacks
attacks: deps-test ## Set every attacker on a secured server: docs/results/security.md
	@cmake --preset release -DSUTURED_TESTS=ON -DSUTURED_BENCH=OFF >/dev/null
	@cmake --build --preset release --target sutured_attacks
	@$(BIN)/tests/attacks/sutured_attacks --table docs/results/security.md \
	  --commit "$$(git describe --always --dirty 2>/dev/null || echo unknown)"

.PHONY: fidelity
fidelity: deps-test ## Compare rendered forces with a full re-solve; renews docs/results/haptic-fidelity.md
	@cmake --preset release -DSUTURED_TESTS=OFF -DSUTURED_BENCH=ON >/dev/null
	@cmake --build --preset release --target sutured_bench
	@mkdir -p build/fidelity
	@$(BIN)/tests/bench/sutured_bench --fidelity build/fidelity
	@/usr/bin/python3 tests/bench/fidelity_plot.py build/fidelity docs/results/haptic-fidelity.md \
	  docs/images/haptic-fidelity.svg

.PHONY: distance
distance: deps-test ## Study what distance does to the force: docs/results/distance.md and its plot
	@cmake --preset release -DSUTURED_TESTS=OFF -DSUTURED_BENCH=ON >/dev/null
	@cmake --build --preset release
	@/usr/bin/python3 tests/distance/study.py --build build/release --docs docs

.PHONY: format
format: deps-check ## Rewrite the sources in the house style
	@git ls-files '*.cpp' '*.hpp' | xargs -r clang-format -i

.PHONY: check-format
check-format: deps-check ## Say which sources are not in the house style
	@git ls-files '*.cpp' '*.hpp' | xargs -r clang-format --dry-run -Werror

.PHONY: check
check: check-format ## The format, clang-tidy, and the unit tests under the sanitizers
	@cmake --preset dev >/dev/null && cmake --build --preset dev
	@git ls-files 'server/*.cpp' 'protocol/*.cpp' 'client-sdk/*.cpp' | grep -v examples/ | \
	  xargs -P "$$(nproc)" -n 4 clang-tidy --quiet -p build/dev
	@for preset in asan-ubsan tsan; do \
	  cmake --preset $$preset >/dev/null && cmake --build --preset $$preset && \
	  ctest --preset $$preset -LE validation || exit 1; done

.PHONY: meshes
meshes: ## Make the meshes of the scenes anew, with Gmsh
	$(call install-packages,$(MESH_PACKAGES))
	@for geo in server/scenes/*/*.geo; do \
	  gmsh -3 -v 2 -format msh41 $$geo -o $${geo%.geo}.msh && echo "made $${geo%.geo}.msh"; done

.PHONY: fuzz
fuzz: deps-test ## Fuzz whatever reads strangers' bytes: SECONDS each (60)
	@cmake --preset fuzz >/dev/null
	@cmake --build --preset fuzz --target fuzzers
	@tests/fuzz/all.sh build/fuzz/tests/fuzz $(or $(SECONDS),60)
