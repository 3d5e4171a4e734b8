# tilefab: `make demo` and `make test` are all that a newcomer needs; both make the environment they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: install demo demo-line test check docs bench soak profiles clean
.DEFAULT_GOAL := demo

install: $(STAMP)

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("tilefab needs Python 3.11 or later: make PYTHON=/path/to/python3.11") if sys.version_info < (3, 11) else None'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo 'Installing tilefab and its tools into $(VENV): half a minute to a few, without output ...'
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $(STAMP)

# The main job on a real photograph: faces, proofs, manifest and report under out/demo.
demo: install
	$(BIN)/tilefab run jobs/demo.toml
	@echo "Look at out/demo/report.pdf, out/demo/proofs and out/demo/faces."

# The loop, live: a simulated line at sixty times its pace, a kiln that drifts, tiles that tell. Five minutes.
demo-line: install
	$(BIN)/python -m sim.demo_line
	@echo "Look at out/demo_line/report.pdf."

# One thread of linear algebra for each of the two workers: more would only wait for each other.
test: install
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist loadgroup

# Everything that reads the code without running it.
check: install
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: install
	$(BIN)/python benchmarks/distinct_faces.py
	$(BIN)/python benchmarks/sampler.py
	$(BIN)/python benchmarks/sampler.py --design tile
	$(BIN)/python benchmarks/walls.py
	$(BIN)/python benchmarks/large_slab.py
	$(BIN)/python benchmarks/demo_profile.py
	$(BIN)/python benchmarks/press_profiles.py
	$(BIN)/python benchmarks/smoothness.py
	$(BIN)/python benchmarks/drift.py
	$(BIN)/python benchmarks/ink_saving.py
	$(BIN)/python benchmarks/fuzz_readers.py
	$(BIN)/python benchmarks/line_throughput.py
	$(BIN)/python benchmarks/line_journal.py
	$(BIN)/python benchmarks/registration.py
	$(BIN)/python benchmarks/recognition.py
	$(BIN)/python benchmarks/defects.py
	$(BIN)/python benchmarks/run_lengths.py
	$(BIN)/python benchmarks/drift_control.py
	$(BIN)/python benchmarks/closed_loop.py
	$(BIN)/python benchmarks/synthesis_speed.py
	$(BIN)/python benchmarks/synthesis_panel.py --large

# What the line stands: hours. Each prints a table of what it went through and ends with 1 if anything was wrong.
soak: install
	$(BIN)/python benchmarks/line_machine.py
	$(BIN)/python benchmarks/line_wire.py
	$(BIN)/python benchmarks/line_reconnect.py
	$(BIN)/python benchmarks/line_power.py
	$(BIN)/python benchmarks/line_power_cuts.py
	$(BIN)/python benchmarks/line_kills.py
	$(BIN)/python benchmarks/line_faults.py
	$(BIN)/python benchmarks/line_month.py

# Pages that are made from the code.
docs: install
	$(BIN)/python -m tilefab.config.reference > docs/job_files.md
	$(BIN)/python -m tilefab.config.reference line > docs/line_files.md
	$(BIN)/python -m tilefab.devices.reference > docs/line_protocols.md

# The shipped press profiles, from simulated presses: chart, measurement file, profile.
profiles: install
	$(BIN)/python -m sim.chart -o profiles/demo_ceramic.ti3
	$(BIN)/tilefab profile build profiles/demo_ceramic.ti3 -o profiles/demo_ceramic.icc
	$(BIN)/tilefab profile chart -o out/demo_line --ink-names Blue,Brown,Yellow,Black --patches 800 --ink-limit 320
	$(BIN)/python -m sim.print_chart out/demo_line.cgats -o profiles/demo_line.ti3 --press ceramic4
	$(BIN)/tilefab profile build profiles/demo_line.ti3 -o profiles/demo_line.icc

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
