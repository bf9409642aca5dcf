# Two commands do all set-up on a machine that has only Python >= 3.11, make and a C compiler:
#   make demo    recorded contours to meshes, canonical shapes and names
#   make test    the whole test suite, the way a ROS user runs it: colcon build, colcon test

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
BUILT_FROM := setup.py pyproject.toml $(wildcard momrec_core/*.c momrec_core/*.h)

.PHONY: demo test lint colcon bench clean

demo: $(VENV)/runtime
	$(BIN)/momrec demo --output demo

test: colcon
	. $(BIN)/activate && colcon test --return-code-on-test-failure \
		--event-handlers console_direct+ --pytest-args --numprocesses auto

lint: $(VENV)/development
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# What a ROS user types after sourcing ROS, here with ROS from wheels.
colcon: $(VENV)/development
	. $(BIN)/activate && test "$$(colcon list)" = "$$(printf 'momrec_ros\t.\t(ros.ament_python)')"
	. $(BIN)/activate && colcon build --event-handlers console_cohesion+
	. install/setup.sh && install/momrec_ros/lib/momrec_ros/momrec --version

# Open3D wants libusb-1.0, libGL and libX11 of the system.
bench: colcon $(VENV)/peers
	$(BIN)/python benchmarks/growth.py --figure benchmarks/growth.png
	. $(BIN)/activate && . install/setup.sh && python benchmarks/speed.py --output benchmarks

clean:
	rm -rf $(VENV) demo build install log

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/runtime: $(BUILT_FROM) | $(BIN)/python
	$(PIP) --editable .
	touch $@

$(VENV)/development: $(BUILT_FROM) | $(BIN)/python
	$(PIP) --editable '.[ros,test]'
	touch $@ $(VENV)/runtime

$(VENV)/peers: $(VENV)/development
	$(PIP) --editable '.[ros,test,bench]'
	touch $@
