# make demo | shell | test | matrix | lint | docs | bench | torture | mutants | release | clean. Needs
# python3 (3.11 or 3.12) with venv, and make.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.complete

MACHINE ?= $(shell uname -m)
JAZZY ?= /opt/ros/jazzy

ifeq ($(MACHINE),x86_64)
# A sourced ROS must not put its own packages before those of .venv.
unexport PYTHONPATH AMENT_PREFIX_PATH
PACKAGES := -c constraints.txt -e '.[all,ros,test]'
else
# There are wheels of ROS for x86-64 only. Each command gets the ROS that is sourced, or else that
# in JAZZY; its messages were compiled for numpy 1.
SHELL := /bin/bash
ifndef AMENT_PREFIX_PATH
export BASH_ENV := $(JAZZY)/setup.bash
endif
PACKAGES := -e '.[all]' 'numpy<2'
endif

.PHONY: demo shell test matrix lint docs bench torture mutants release clean

demo: $(STAMP)
	$(BIN)/flexx2 demo

# With the user's own shell: what it reads at start stays as it is.
shell: $(STAMP)
	@echo "flexx2, flexx2_camera and go1_cameras are commands here; exit ends this shell."
	@VIRTUAL_ENV='$(abspath .venv)' PATH='$(abspath $(BIN))':"$$PATH" $${SHELL:-/bin/sh}

# Two at a time: much of it waits for messages. A file stays with one of them, so that what its
# tests share is made once, and those of few long tests do not come last. A test that hangs for 15
# minutes fails, and says where it hangs.
test: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 0 \
		-o faulthandler_timeout=900 -o faulthandler_exit_on_timeout=true

# Clean environments in build/matrix, also beside mjlab, mujoco_playground and torch; needs uv.
# FLEXX2_MATRIX is set for the tests that otherwise skip.
matrix: $(STAMP)
	FLEXX2_MATRIX=1 $(BIN)/python -m pytest -q test/test_matrix.py
	@cat build/matrix/table.md

# ament_pep257 treats properties as any other method: hence the empty list.
lint: $(STAMP)
	$(BIN)/flake8
	$(BIN)/pydocstyle --property-decorators= flexx2_sim_ros study test bench setup.py
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

docs: JOBS ?= auto
docs: $(STAMP)
	$(BIN)/python -m sphinx -q -j $(JOBS) -W --keep-going -b html docs build/docs
	@echo "Made build/docs/index.html."

bench: $(STAMP)
	$(BIN)/python -m bench

# The sdist and the wheel, made from the sdist, in dist/. CONTRIBUTING.md says how to publish them.
release: $(STAMP)
	rm -rf dist
	$(BIN)/python -m build --no-isolation
	$(BIN)/twine check --strict dist/*
	@! grep -q 'FILL IN' package.xml || \
		echo 'Before you upload these: fill in the maintainer and the repository in package.xml.'

# Two hours: hostile messages and files, kills, a soak. See CONTRIBUTING.md.
torture: $(STAMP)
	$(BIN)/python -m bench torture

# An hour: 40 small changes of the code, and which of them the tests of their modules notice.
mutants: $(STAMP)
	$(BIN)/python -m bench.mutants

clean:
	rm -rf .venv build install log dist demo_output docs/api *.egg-info
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

# Touched last: a .venv that was interrupted half-way has no stamp and is made anew.
$(STAMP): setup.py constraints.txt
	@$(PYTHON) -c 'import sys; sys.version_info[:2] in ((3, 11), (3, 12)) or sys.exit("needs \
	Python 3.11 or 3.12, found %d.%d: try make PYTHON=python3.12" % sys.version_info[:2])'
ifneq ($(MACHINE),x86_64)
	@$(PYTHON) -c 'import rclpy' 2> /dev/null || { echo "There are no wheels of ROS 2 for $(MACHINE):" \
	"install ROS 2 Jazzy in $(JAZZY), or source your own, and run make again." >&2; exit 1; }
	@echo "There are no wheels of ROS 2 for $(MACHINE): uses the one in $${AMENT_PREFIX_PATH%%:*}."
endif
	@echo "Making .venv with $$($(PYTHON) --version): downloads about 650 MB, needs 2.2 GB" \
	"of disk and takes two to four minutes ..."
	$(PYTHON) -m venv --clear .venv
	@touch .venv/COLCON_IGNORE
	$(BIN)/pip install --disable-pip-version-check $(PACKAGES)
	$(BIN)/flexx2 compile
	@touch $@
	@echo "Made .venv."
