"""All benchmarks in one run: `python -m benchmarks` writes docs/benchmarks.md."""

import argparse
import sys
from pathlib import Path

import torch

from training.evaluation.results import paragraphs, write_text

from . import bench_backproject, bench_isosurface, bench_rasterize, bench_unwrap
from .measure import machine

PARTS = (bench_rasterize, bench_isosurface, bench_unwrap, bench_backproject)


def main() -> int:
    """Run every part and write the document."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.partition("\n")[0])
    parser.add_argument("--threads", type=int, default=2, help="of torch (default 2)")
    parser.add_argument("--output", type=Path, default=Path("docs/benchmarks.md"))
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    sections = []
    for part in PARTS:
        sections.append(part.document())
        print(sections[-1], end="\n\n", flush=True)
    text = paragraphs("# Benchmarks", f"Machine: {machine()}.", *sections, "Made by `make bench`, in one run.")
    write_text(args.output, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
