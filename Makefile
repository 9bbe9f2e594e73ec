# Sets up, runs, checks and measures altd; `make` alone says what there is.
# Each target works in a bare clone: .ci/venv makes .venv first, and again when requirements.lock or pyproject.toml
# changed. PYTHON=python3.12 chooses another interpreter, with a .venv-python3.12 of its own.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.DEFAULT_GOAL := help
.PHONY: $(shell awk -F ':' '/^[a-z-]+:/ { print $$1 }' Makefile)

export PYTHON ?= python3
unexport PYTHONDONTWRITEBYTECODE # tests start hundreds of processes: each would compile altd and its libraries again
export VENV := .venv$(patsubst %,-%,$(notdir $(filter-out python3,$(PYTHON))))
python := $(VENV)/bin/python
LIVE_S ?= 60
CAMPAIGN_S ?= 180
FAULT_RUNS ?= 120
SOAK_H ?= 100
FUZZ_S ?= 600
FLEET ?= 1000
WORKSHOP ?= tests/workshop
HOSTILE ?= 100000
SPRAY_S ?= 600
LANES ?= workshop package python simulator
cores := $(shell nproc)
side_by_side := --numprocesses $(shell expr $(cores) '*' 3 / 2) --dist loadfile # more than cores: some tests wait
pytest := $(python) -m pytest

# What `make check` runs side by side, all of it whatever fails.
checks := $(addprefix check-,pages types style format layers licences markdown wording)

help:
	@awk -F ':.*## ' '/^## / { printf "\n%s\n", substr($$0, 4) } /^[a-z-]+:.*## / { printf "make %-15s %s\n", $$1, $$2 }' Makefile

## Try

demo: venv ## a simulated unit, measured: values and truth in the terminal; Ctrl-C ends it; MQTT=HOST[:PORT] publishes, too
	@exec $(python) -m hw_sim demo $(if $(MQTT),--mqtt '$(MQTT)')

demo-gige: programs venv ## the same with its cameras on the network, by GigE Vision
	@exec $(python) -m hw_sim demo --gige

demo-chain: venv ## a simulated row of switched glass targets along a tunnel, one of which moves; Ctrl-C ends it
	@exec $(python) -m hw_sim chain-demo

demo-planar: venv ## a simulated plate that a machine moves, measured by one camera: values and errors; Ctrl-C ends it
	@exec $(python) -m hw_sim planar

demo-fleet: venv ## twenty simulated units, a broker, PostgreSQL and the ingest; two units fail; Ctrl-C ends it
	@.ci/programs must mosquitto '/usr/lib/postgresql/*/bin/initdb=postgresql'
	exec $(python) -m benchmarks.demo_fleet

## Check and test

check: venv ## generated pages, style, types, layers, licences, width and wording of pages: all faults at once
	@$(MAKE) --no-print-directory --keep-going --jobs=$(cores) --output-sync $(checks)
check-pages:
	@$(python) -m tools.pages --check
check-types:
	@$(python) -m mypy
check-style:
	@$(python) -m ruff check
check-format:
	@$(python) -m ruff format --check
check-layers:
	@$(VENV)/bin/lint-imports --no-logo
check-licences:
	@$(python) -m tools.licences
check-markdown:
	@$(python) -m tools.markdown README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md docs/*.md docs/decisions/*.md docs/studies/*.md
check-wording:
	@$(python) -m tools.plain README.md CONTRIBUTING.md SECURITY.md docs/*.md docs/decisions/*.md docs/studies/*.md altd hw_sim tools examples tests benchmarks studies

test: venv ## the tests that need Python alone: three to six minutes on two cores, set-up included
	@$(pytest) $(side_by_side) -m 'not long' tests/unit
	echo "make test-all adds: real kernel drivers, Aravis, Chromium, systemd, foreign clients, real time, and the longer tests."

test-all: programs venv kernel ## all tests, with real parts: installs Debian packages, builds a Linux kernel
	@exec .ci/tests $(LANES)

test-workshop: programs venv ## the tests of benchmarks, studies and tools, to be run when one of these changes
	@exec $(pytest) $(side_by_side) $(WORKSHOP)

fuzz: programs venv ## new inputs on every interface and file format; FUZZ_S=60 for a minute each, TARGET=name for one
	@$(if $(TARGET),,$(pytest) -m hypothesis --hypothesis-profile explore $(side_by_side) tests/unit)
	$(if $(TARGET),,ALTD_BENCH_MEASUREMENTS=5000 $(pytest) tests/system/publish/test_one_meaning.py)
	PYTHONPATH=tests OPENCV_LOG_LEVEL=OFF exec $(python) -m fuzz --seconds $(FUZZ_S) $(if $(TARGET),--target $(TARGET))

defects: venv ## a defect at a time in each room of altd: do the tests catch it? takes an hour
	@exec $(python) -m tools.defects

## Write the documentation

pages: venv ## write the generated pages and drawings of docs/ that changed: seconds
	@exec $(python) -m tools.pages

pictures: venv ## take the pictures of docs/ again: minutes; those that show the same stay; PICTURE=page for one
	@.ci/programs must tmux chromium pdftoppm=poppler-utils
	exec $(python) -m tools.pictures $(PICTURE)

studies: venv ## the thesis' experiments on simulated parts: docs/studies/, takes minutes
	@exec $(python) -m studies -o docs/studies

studies-check: venv ## the same, compared with docs/studies to the last digit; TURN=3/4: the cheap ones, and one turn of four
	@exec $(python) -m studies --check $(if $(TURN),--turn $(TURN))

site: venv ## the documentation as a site in build/site, with search; opens from disk without a network
	@mkdir -p build # --quiet would not count the warnings that a strict build fails for
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build 2>build/site.log || { grep -v ^INFO build/site.log >&2; exit 1; }
	echo "the documentation: file://$(CURDIR)/build/site/index.html"

## Measure

bench: venv ## time per stage, highest rate, latency
	@exec $(python) -m benchmarks.measure

bench-area: venv ## beams anywhere on 140 × 110 mm against their truth; takes minutes
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 exec $(python) -m benchmarks.area

bench-fleet: venv ## many units, one broker, one ingest, one PostgreSQL: ages, rows lost, a week's backlog; FLEET=100 for a hundred units
	@.ci/programs must mosquitto '/usr/lib/postgresql/*/bin/initdb=postgresql'
	exec $(python) -m benchmarks.fleet --units $(FLEET)

bench-guest: venv kernel ## a minute with two cameras of the kernel's test drivers: what is lost, jitter, errors
	@ALTD_BENCH_GUEST_S=60 exec $(python) -m pytest -q tests/system/test_guest_unit.py -k "pair or truth or figures"

bench-hostile: venv ## hostile inputs at every network interface and console beside a reader; HOSTILE=1000000 for a million each
	@PYTHONPATH=tests OPENBLAS_NUM_THREADS=1 exec $(python) -m fuzz.hostile --inputs $(HOSTILE)

bench-history: programs venv kernel ## what a history loses in 200 kills and 50 power cuts
	@PYTHONPATH=tests $(python) -m support.history_crash --times 200
	ALTD_BENCH_POWER_CUTS=50 exec $(python) -m pytest -q -s tests/system/history/test_power_cut.py

bench-live: programs venv ## the whole unit on GigE Vision, well and ill; LIVE_S=3600 for an hour, with the growth of memory
	@exec unshare -rn $(python) -m benchmarks.live.measure --seconds $(LIVE_S)

bench-spray: programs venv ## datagrams with forged sources at the unit on GigE Vision, ten minutes; SPRAY_S=60 for one
	@PYTHONPATH=tests exec unshare -rn $(python) -m fuzz.hostile.spray --seconds $(SPRAY_S)

bench-verify: venv ## 200 right and wrong units by `altd verify`: false alarms and detected ones
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 exec $(python) -m benchmarks.verification

campaign: venv ## measurements spoilt in many ways, judged by truth; CAMPAIGN_S=36000 for ten hours
	@exec $(python) -m benchmarks.campaign --seconds $(CAMPAIGN_S)

faults: venv ## faults into the whole daemon, all interfaces judged by truth; FAULT_RUNS=1000 for half an hour
	@.ci/programs may mosquitto
	exec $(python) -m benchmarks.faults --runs $(FAULT_RUNS) --real 1

soak: venv ## the daemon for a hundred hours of a clock that is set: memory, descriptors, threads, exposures; SOAK_H=2
	@.ci/programs may mosquitto
	exec env OPENBLAS_NUM_THREADS=1 $(python) -m benchmarks.soak --hours $(SOAK_H)

## Release

lock: ## write the three locks with today's newest packages
	@.ci/lock

audit: venv ## the locks against the stored list of advisories, without a network
	@$(python) -m tools.audit

sbom: venv ## the parts of a unit's software with licences, CycloneDX: build/altd.cdx.json
	@mkdir -p build
	$(python) -m tools.sbom >build/altd.cdx.json.new
	mv build/altd.cdx.json.new build/altd.cdx.json

deb: venv ## the Debian package of a unit in dist/, for the Python of PYTHON; EXTRAS="opcua report" adds these
	@.ci/programs must dpkg-deb=dpkg gcc strip=binutils
	exec $(python) -m tools.deb $(EXTRAS)

## Remove

clean: ## remove .venv and all that tools leave behind
	@rm -rf .venv .venv-* build dist node_modules .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find altd hw_sim studies tests benchmarks tools -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

venv:
	@.ci/venv

programs: # foreign programs that tests use
	@.ci/programs may chromium curl debootstrap lintian ssh-keygen=openssh-client unzip mbpoll mosquitto mosquitto_sub=mosquitto-clients nginx=nginx-light '/usr/lib/postgresql/*/bin/initdb=postgresql' socat node=nodejs picocom tmux systemd-analyze=systemd /usr/sbin/mkfs.ext4=e2fsprogs pdftotext=poppler-utils v4l2-ctl=v4l-utils
	@.ci/npm node-opcua-client@2.186.0 sparkplug-payload@1.0.3
	header=$$($(PYTHON) -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
	.ci/programs may arv-fake-gv-camera-0.8=aravis-tools arv-tool-0.8=aravis-tools-cli \
	    '/usr/lib/*/girepository-1.0/Aravis-0.8.typelib=gir1.2-aravis-0.8' \
	    gcc /usr/include/linux/videodev2.h=libc6-dev pkg-config ip=iproute2 unshare=util-linux "$$header=python3-dev" \
	    /usr/include/gobject-introspection-1.0/girepository.h=libgirepository1.0-dev /usr/include/cairo/cairo.h=libcairo2-dev /usr/include/modbus/modbus.h=libmodbus-dev

kernel: # the kernel that drivers are tested in
	@.ci/kernel >/dev/null
