# Two commands do everything on a machine with Python 3.11: `make demo` and `make test`.
#
#   make test          what is run after every edit: needs no footage, no GPU, no torch, no network
#   make test-lengthy  the tests that take seconds of a processor each: whole graphs, evaluations
#   make test-hosts    the tests that deploy graphs over several hosts, on this one: two minutes
#   make test-slow     the tests that take minutes, and a search for inputs that break something
#   make test-footage  the tests on recordings and third-party weights, which are in SHARED; what is
#                      not there is skipped
#   make test-robot    the tests of the robot, with MuJoCo: needs libosmesa6
#   make test-guest    the drivers of USB boards and webcams over a real kernel in a virtual machine: needs
#                      QEMU, busybox-static and KERNEL, which `make guest-kernel` downloads (70 MB)
#   make check         style, types, import rules and the examples in docstrings

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

# rapidocr brings OpenCV with windows, which needs libGL; the one without takes its place again
HEADLESS = $(PIP) --force-reinstall --no-deps opencv-python-headless

.PHONY: demo test test-lengthy test-hosts test-slow test-footage test-robot guest-kernel test-guest guest-gadget guest-usbip check train clean

# where recordings (data/) and third-party weights (models/) are
SHARED ?= ../shared

# what `make demo` runs: make demo GRAPH=follow SOURCE=webcam SET=policy.target=dog
# or another task: make demo TASK=text reads a street, TASK=shirts the numbers of a whole pitch,
# TASK=manipulation inserts a peg
TASK ?= tracking
GRAPH ?= $(TASK)
SOURCE ?=
SET ?=

# an unpacked Debian kernel package for `make test-guest`
KERNEL ?= .guest

# where `make train` works, and what it is told beside the defaults
RUNS ?= runs
DETECTOR ?=
ENCODER ?=
POLICY ?=
DEVICE ?= auto
# where pip finds torch: PyPI's own needs 5 GB of CUDA on Linux; for a GPU …/whl/cu130
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

demo: $(VENV)/.installed $(patsubst %,$(VENV)/.installed-%,\
		$(subst shirts,text,$(filter text shirts manipulation,$(TASK) $(GRAPH))))
	$(BIN)/fovea run graphs/$(GRAPH).yaml --duration-s 20 --save demo.rrd \
		$(if $(SOURCE),--source $(SOURCE)) $(foreach change,$(SET),--set $(change))
	@echo "look at it: $(BIN)/rerun demo.rrd"

# twice as many processes as two cores: half of the time a test waits for those that it starts
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 4 --dist loadfile

test-lengthy: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 4 --dist loadfile \
		-m "lengthy and not (slow or hosts or hardware or footage)"

# two: agents are to answer within seconds
test-hosts: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "hosts and not (slow or hardware or footage)" \
		tests/pipeline/fleet

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "slow and not (hardware or footage)"
	$(BIN)/python -m pytest -n 2 -m "hypothesis and not (slow or hardware or footage)" \
		--hypothesis-profile search

# the robot's tests, which are skipped without its extra; MuJoCo draws by libosmesa6 of the system
test-robot: $(VENV)/.installed-dev $(VENV)/.installed-manipulation
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not (slow or hosts or hardware or footage)" \
		tests/drivers/scenes/test_insertion.py \
		tests/graphs/test_manipulation.py tests/operators/manipulation tests/bench/test_manipulation.py \
		tests/operators/saliency/objects

test-footage: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "footage and not hardware" -rs --shared="$(SHARED)"

guest-kernel: $(VENV)/.installed-dev
	$(BIN)/python -m tests.guest.kernel $(KERNEL)

# Two guests at the same time, each with one processor. They cannot write: what they import is
# compiled before, and pytest's other plugins are left out, since every import costs them much.
ON_BOARDS := tests/drivers/usb/test_attached.py
ON_WEBCAMS := tests/drivers/cameras/test_webcam.py
# in the guest that has less to do
FORMATS_OF_WEBCAMS := $(ON_WEBCAMS)::test_a_real_device_says_what_it_chose_and_delivers_it
IN_GUEST = $(BIN)/python -m tests.guest.boot $(KERNEL) \
	env PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 $(BIN)/python -m pytest -p no:cacheprovider -m hardware \
	--durations=5

test-guest: $(VENV)/.installed-dev
	PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 $(BIN)/python -m pytest -p no:cacheprovider --collect-only \
		$(ON_BOARDS) $(ON_WEBCAMS) >/dev/null
	$(MAKE) --jobs=2 --output-sync=target --no-print-directory guest-gadget guest-usbip

guest-gadget:
	$(IN_GUEST) --usb-board=gadget --camera=/dev/video0 $(ON_BOARDS) $(FORMATS_OF_WEBCAMS)

guest-usbip:
	$(IN_GUEST) --usb-board=usbip --camera=/dev/video0 $(ON_BOARDS) $(ON_WEBCAMS) \
		--deselect=$(FORMATS_OF_WEBCAMS)

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest --doctest-modules --doctest-ignore-import-errors pipeline drivers operators bench

# Detector, encoder and policies from nothing, one after the other; goes on where it was interrupted.
# With g++ the detector's training is compiled first.
train: $(VENV)/.installed-train
	$(BIN)/python -m operators.saliency.train --data $(RUNS)/detector/data --out $(RUNS)/detector \
		--device $(DEVICE) $(if $(shell command -v g++),--compiled) $(DETECTOR)
	$(BIN)/python -m operators.roi_features.train --data $(RUNS)/encoder/data --out $(RUNS)/encoder \
		--device $(DEVICE) $(ENCODER)
	$(BIN)/fovea train tracking --data $(RUNS)/policy/data --out $(RUNS)/policy \
		--device $(DEVICE) $(POLICY) \
		--set saliency.weights=$(RUNS)/detector/detector.onnx \
		--set roi_features.weights=$(RUNS)/encoder/roi_encoder.onnx

clean:
	rm -rf $(VENV) build *.egg-info demo.rrd

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "needs Python 3.11: make PYTHON=/path/to/python3.11"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "needs Python 3.11 or newer, got " + sys.version)'
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "needs Python's venv: apt-get install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	@echo "installing into $(VENV): about a minute and 1.3 GB, once"
	@$(PIP) --editable '.[view]'
	@touch $@

$(VENV)/.installed-train: pyproject.toml $(VENV)/.installed
	@echo "installing what training needs: torch"
	@$(PIP) --editable '.[train]' --extra-index-url $(TORCH_INDEX)
	@touch $@

$(VENV)/.installed-dev: pyproject.toml $(VENV)/.installed
	@echo "installing what the tests need"
	@$(PIP) --editable '.[dev]'
	@$(HEADLESS)
	@touch $@

$(VENV)/.installed-manipulation: pyproject.toml $(VENV)/.installed
	@echo "installing what simulates the robot: MuJoCo and gym-aloha"
	@$(PIP) --editable '.[robot]'
	@touch $@

$(VENV)/.installed-text: pyproject.toml $(VENV)/.installed
	@echo "installing what reads text: rapidocr and fonts"
	@$(PIP) --editable '.[text]'
	@$(HEADLESS)
	@touch $@
