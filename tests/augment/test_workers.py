"""Draws in worker processes: the same ones, and on one thread each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.children import SOURCE

# Run as a script: a spawned child imports it again.
PROGRAM = """
import multiprocessing, os, sys
import numpy as np
from supple.augment import RandomElastic

AUGMENT, BEFORE = RandomElastic(9, (20, 40), 9), {}

def threads():
    return len(os.listdir("/proc/self/task"))

def bent(seed):
    before = BEFORE.setdefault(os.getpid(), threads())  # those of other libraries
    made = AUGMENT(np.arange(300 * 400.0).reshape(300, 400), seed=seed)
    return made.image.tobytes(), threads() - before, os.environ.get("SUPPLE_THREADS")

if __name__ == "__main__":
    import hashlib, json
    here = [bent(seed) for seed in range(4)]  # on all threads, in a pool that a fork does not have
    with multiprocessing.get_context(sys.argv[1]).Pool(2) as pool:
        there = pool.map(bent, range(4), chunksize=1)
    told = [[(hashlib.sha256(pixels).hexdigest(), *rest) for pixels, *rest in each] for each in (here, there)]
    print(json.dumps(told))
"""
LOADED = """
import os, sys
import numpy as np, torch
from torch.utils.data import DataLoader, Dataset
from supple.augment import RandomElastic

class Pictures(Dataset):
    def __len__(self):
        return 4
    def __getitem__(self, k):
        before = len(os.listdir("/proc/self/task"))
        made = RandomElastic(9, (20, 40), 50)(np.zeros((300, 400), np.float32), points=[(200, 150)])
        return made.points[0], len(os.listdir("/proc/self/task")) - before

if __name__ == "__main__":
    import json
    for start, count in (("fork", 2), ("spawn", 1)):  # one batch each: what sends it starts threads of its own
        loader = DataLoader(Pictures(), batch_size=4 // count, num_workers=count, multiprocessing_context=start)
        print(json.dumps([[points.tolist(), more.tolist()] for points, more in loader]))
"""


def told(program: str, start: str, folder: Path, **more: str) -> list[Any]:
    path = folder / "program.py"
    path.write_text(program, encoding="utf-8")
    around = {**os.environ, "PYTHONPATH": SOURCE, **more}
    if not more:
        around.pop("SUPPLE_THREADS", None)
    result = subprocess.run(
        [sys.executable, str(path), start], env=around, capture_output=True, encoding="utf-8", check=False
    )
    assert result.returncode == 0, result.stderr
    return [json.loads(line) for line in result.stdout.splitlines()]


needs_tasks = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted in /proc")


@needs_tasks
@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_workers_use_one_thread_each_and_draw_the_same(start: str, tmp_path: Path) -> None:
    ((here, there),) = told(PROGRAM, start, tmp_path)
    assert [pixels for pixels, *_ in here] == [pixels for pixels, *_ in there]
    assert {(more, asked) for _, more, asked in there} == {(0, "1")}
    assert {asked for *_, asked in here} == {None}


@needs_tasks
def test_another_number_of_threads_can_be_asked_for(tmp_path: Path) -> None:
    ((_, there),) = told(PROGRAM, "fork", tmp_path, SUPPLE_THREADS="3")
    assert {(more, asked) for _, more, asked in there} == {(2, "3")}


@needs_tasks
def test_workers_of_a_data_loader_differ_and_start_no_threads(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    loaders = told(LOADED, "", tmp_path)
    assert len(loaders) == 2
    for batches in loaders:
        points = [tuple(point) for batch, _ in batches for point in batch]
        assert len(set(points)) == 4
        assert {more for _, some in batches for more in some} == {0}
