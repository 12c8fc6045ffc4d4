"""Seconds and memory of `generate`: cold from the start of the process to the last file, warm as the second of a batch.

python -m benchmarks.bench_generate [VIEWS] [--threads N]
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("views", type=Path, nargs="?", help="a folder of views; the committed example by default")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    views = args.views or next(path.parent for path in sorted(ROOT.glob("arm_blender/examples/*/transforms.json")))
    words = [sys.executable, "-m", "arm_blender"]
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        start = time.perf_counter()
        generate = ["generate", str(views), "--output", str(scratch / "cold"), "--threads", str(args.threads)]
        subprocess.run(words + generate, check=True, cwd=ROOT)
        cold = time.perf_counter() - start
        items = scratch / "items.txt"
        items.write_text(f"{views.resolve()}\n" * 2)
        batch = ["batch", str(items), "--output", str(scratch / "batch"), "--threads", str(args.threads)]
        warm = _seconds_between_items(words + batch)
        report = json.loads(next((scratch / "cold").rglob("report.json")).read_text())
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20  # Linux counts KiB.
    print(f"cold {cold:.1f} s, warm {warm:.1f} s, peak {peak:.2f} GiB, {args.threads} threads")
    for stage, seconds in report["seconds"].items():
        print(f"  {stage:<20} {seconds:6.2f} s")
    return 0


def _seconds_between_items(command: list[str]) -> float:
    """From the first item's line on stdout to the second's: one whole item in a warm process."""
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        times = [time.perf_counter() for line in process.stdout if line.startswith("{")]
    if process.returncode or len(times) != 2:
        raise SystemExit(f"batch ended with status {process.returncode} after {len(times)} of 2 items")
    return times[1] - times[0]


if __name__ == "__main__":
    sys.exit(main())
