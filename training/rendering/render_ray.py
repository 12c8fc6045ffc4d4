"""Tasks on the machines of a Ray cluster; nothing else of the program needs Ray.

A task whose machine is gone is handed to another one by Ray itself. All machines have this package and its
requirements installed, and see the same folders under the same names.
"""

import importlib
import os
from collections.abc import Iterator, Sequence
from typing import Any

from arm_blender.commands.workers import Answer, search_path
from arm_blender.errors import ArmError

RETRIES = 2
"""How often a task is repeated when its process or its machine is gone."""


def over_machines(
    items: Sequence[Any], words: dict[str, Any], module: str, address: str, cpus: float, gpus: float
) -> Iterator[tuple[Any, Answer]]:
    """As `side_by_side`: each item with what `answer(item, words)` of `module` makes of it, None where it died.

    Args:
        address: of the cluster; "auto" where this machine is part of one.
        cpus, gpus: of the cluster, for each task.
    Raises:
        ArmError: Ray is not installed, or there is no such cluster.
    """
    try:
        import ray
    except ImportError as error:
        raise ArmError("--ray: Ray is not installed; pip install ray") from error
    try:
        # The driver's path: so are test modules and a checkout that is not installed found by the workers.
        paths = {"PYTHONPATH": os.pathsep.join(filter(None, search_path()))}
        ray.init(address=address, log_to_driver=False, ignore_reinit_error=True, runtime_env={"env_vars": paths})
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise ArmError(f"--ray {address}: no such cluster ({error}); start one with `ray start --head`") from error
    task = ray.remote(num_cpus=cpus, num_gpus=gpus, max_retries=RETRIES)(_answer)
    waiting = iter(items)
    running: dict[Any, Any] = {}  # Items by Ray's references to their answers.
    # Twice what runs at once: no machine waits, and a list of any length needs no memory.
    most = 2 * max(1, int(ray.cluster_resources().get("CPU", 1) / max(cpus, 1e-3)))
    try:
        while True:
            while len(running) < most and (item := next(waiting, None)) is not None:
                running[task.remote(module, item, words)] = item
            if not running:
                return
            for reference in ray.wait(list(running))[0]:
                item = running.pop(reference)
                try:
                    yield item, ray.get(reference)
                except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError):
                    yield item, None
    finally:
        for reference in running:
            ray.cancel(reference, force=True)


def _answer(module: str, item: Any, words: dict[str, Any]) -> Answer:
    return importlib.import_module(module).answer(item, words)
