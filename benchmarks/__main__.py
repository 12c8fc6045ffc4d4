"""All benchmarks in one run: `python -m benchmarks` writes docs/benchmarks.md, its plot and a block of results.md."""

import argparse
import sys
from pathlib import Path

import torch

from training.documents import fill_block, markdown_table, paragraphs, write_text
from training.studies.figures import panels

from . import bench_backproject, bench_isosurface, bench_rasterize, bench_unwrap
from .measure import machine

PARTS = (bench_rasterize, bench_isosurface, bench_unwrap, bench_backproject)
ROOT = Path(__file__).parents[1]


def main() -> int:
    """Run every part and write the documents."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.partition("\n")[0])
    parser.add_argument("--threads", type=int, default=2, help="of torch (default 2)")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    sections = {}
    for part in PARTS:
        sections[part] = part.section()
        print(sections[part].text, end="\n\n", flush=True)
    made = f"Made by `make bench`, in one run. Machine: {machine()}."
    texts = [section.text for section in sections.values()]
    picture = "![What is sampled, and how long unwrapping takes](images/benchmarks.png)"
    plot(sections[bench_isosurface].curves, sections[bench_unwrap].curves, ROOT / "docs/images/benchmarks.png")
    write_text(ROOT / "docs/benchmarks.md", paragraphs("# Benchmarks", made, picture, *texts))
    highlights = [line for section in sections.values() for line in section.highlights]
    summary = paragraphs(markdown_table(["what", "measured"], highlights), made)
    fill_block(ROOT / "docs/results.md", "benchmarks", summary)
    return 0


def plot(samples: dict, seconds: dict, path: Path) -> None:
    """Two panels: samples of the density against the resolution, and seconds of unwrapping against faces."""
    with panels(path, 2, 10.0, 3.8) as axes:
        for panel, curves, title, x, y in (
            (axes[0], samples, "Samples of the density", "samples a side", "samples"),
            (axes[1], seconds, "Unwrapping a wavy ball", "faces", "seconds"),
        ):
            for name, points in curves.items():
                panel.loglog(*zip(*points, strict=True), "o-", label=name)
            panel.set(title=title, xlabel=x, ylabel=y)
            panel.grid(alpha=0.3, which="both")
            panel.legend()


if __name__ == "__main__":
    sys.exit(main())
