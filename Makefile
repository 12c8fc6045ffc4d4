# make          the environment: .venv with everything pinned; a second run installs nothing
# make demo     six views of an object -> out/demo/
# make test     the tests
# make lint     ruff, its format and mypy; make bench
# make extension     the extension's zips with their libraries, and a repository's index -> out/extension/
# make test-blender  those zips in every supported Blender: install, generate, relight, export, uninstall
# make test-ui  the panel in a real Blender window, measured; needs a Debian and root -> docs/user-interface.md
# make test-train  follows docs/train-it-yourself.md: every stage of the training, with the objects of ARM_DATA or made-up ones
# make check-gpu  compares a GPU with the processor, trains and renders on it -> docs/training-cost.md; DEVICE=cpu tries the check itself
# make fuzz     10,000 damaged files of every format that is read -> docs/robustness.md; CASES=... MINUTES=...
# make test-photographs  solves the cameras of made-up photographs for real, good ones and spoilt ones
# PYTHON=...    the Python 3.11 to make .venv with; EXAMPLE=... the views of the demo
# PLATFORMS=... TORCH_INDEX=...  of `make extension`; PYTHON_313=... TORCH_313=...  of `make test-blender`

PYTHON ?= python3.11
EXAMPLE ?= $(patsubst %/,%,$(firstword $(dir $(wildcard arm_blender/examples/*/transforms.json))))

BIN := .venv/bin
READY := .venv/.installed

.PHONY: all demo test lint bench extension test-blender test-ui test-train test-photographs check-gpu fuzz clean

all: $(READY)

# torch goes first and on its own: pip then takes the CPU wheel where one is configured.
$(READY): requirements.txt requirements-dev.txt tools/system_libraries.py
	@command -v $(PYTHON) > /dev/null || { echo "$(PYTHON): not found; install Python 3.11, or name one: make PYTHON=..." >&2; exit 1; }
	$(PYTHON) tools/system_libraries.py
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(shell grep '^torch==' requirements.txt)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-dev.txt
	@touch $@

demo: $(READY)
	@test -n "$(EXAMPLE)" || { echo "arm_blender/examples/: no views with transforms.json; name some: make demo EXAMPLE=..." >&2; exit 1; }
	$(BIN)/python -m arm_blender generate $(EXAMPLE) --output out/demo --preview --progress always

test: $(READY)
	$(BIN)/python -m pytest -q

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.bench_generate

extension: $(READY)
	$(BIN)/python tools/build_extension.py $(if $(PLATFORMS),--platform $(PLATFORMS)) \
		$(if $(TORCH_INDEX),--torch-index $(TORCH_INDEX))

test-blender: extension
	$(BIN)/python tools/blender_matrix.py --views $(EXAMPLE) $(if $(PYTHON_313),--python-313 $(PYTHON_313)) \
		$(if $(TORCH_313),--torch-313 $(TORCH_313))

test-ui: $(READY)
	$(BIN)/python tools/window_run.py --write

test-train: $(READY)
	$(BIN)/python -m pytest -q -m long tests/training

test-photographs: $(READY)
	$(BIN)/python -m pytest -q -m long tests/photographs

check-gpu: $(READY)
	$(BIN)/python -m training check-gpu --update $(if $(DEVICE),--device $(DEVICE))

fuzz: $(READY)
	$(BIN)/python tools/fuzz.py --write $(if $(CASES),--cases $(CASES)) $(if $(MINUTES),--minutes $(MINUTES))

clean:
	rm -rf out .mypy_cache .pytest_cache .ruff_cache
